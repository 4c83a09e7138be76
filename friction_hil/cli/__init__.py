"""The command ``friction-hil``.

Each command is a module of this package, which declares its options and is imported only when that command is used. Its
work is in the module of the same name in `friction_hil.cli.work`, which imports numpy, numba and the rest: neither
``friction-hil --help`` nor ``friction-hil run --help`` waits for these.

A command is a ``click`` command called ``command``. It returns its exit status (None or 0: done; 1: the work failed or
found a fault), and raises a ``FrictionHilError`` for mistakes that the user can correct.
"""

import atexit
import contextlib
import gc
import importlib
import io
import os
import sys
from collections.abc import Iterator, Sequence
from functools import cache

import click

from friction_hil import __version__
from friction_hil.cli.colour import echo_labelled, echo_problems
from friction_hil.cli.output import forget_printed, print_json_error
from friction_hil.cli.quick_imports import keep_asammdf_out_of_can
from friction_hil.errors import ConfigurationError, FrictionHilError, choices
from friction_hil.interrupts import interruptible
from friction_hil.numerics import compiling
from friction_hil.printable import PrintableStream

# The short help stands here, so that the overview imports no command.
COMMANDS = {
    "demo": "Show compensation with two simulated axes that draw a circle.",
    "run": "Run the daemon with the drives of a configuration.",
    "simulate": "Simulate the drives of a configuration on its bus.",
    "plot": "Draw a recording, as a picture or an interactive page.",
    "replay": "Compare recordings with friction models, or verify them.",
    "identify": "Identify friction model and mechanics from recordings.",
    "health": "Show what has changed in the friction of axes over months.",
    "fleet": "Identify, judge or verify the recordings of many machines.",
    "tune": "Identify friction on the machine, and test the compensation.",
    "train": "Train a network on the friction of recordings or of a model.",
    "convert": "Convert a recording, or describe its content.",
    "export": "Export a model for firmware, controllers, simulators or tables.",
    "import": "Make a model file from an MJCF, URDF or BAM file.",
    "study": "Show the effect of each friction model on a servo.",
    "models": "List the friction models, or describe one.",
    "doctor": "Check machine, configuration and connection before a run.",
    "explain": "Print cause and remedy of a message by its code.",
    "latency": "Measure how late this machine wakes up a loop.",
    "monitor": "Show a running daemon live.",
    "status": "Show the daemons that run, their axes and drives.",
    "live": "Serve live data of a daemon: page, metrics, Foxglove.",
    "set": "Change gain, model or other settings of a running daemon.",
    "start": "Enable the axes of a daemon that waits.",
    "stop": "Stop a running daemon, or drives that were left enabled.",
    "reset": "Reset the faults of a daemon or of drives, without power.",
    "service": "Install, remove or show the daemon as a service of systemd.",
    "drives": "Find, show or stop the drives on a CAN bus.",
    "config": "Make, check, show and describe configurations.",
}

# Commands that are not `command` in a module of their name; import is a keyword, set is built in.
_PLACES = {each: ("control", each) for each in ("status", "start", "stop", "reset")}
_PLACES |= {"set": ("control", "set_values"), "import": ("import_model", "command")}

# Commands that connect to drives or simulate them. Their loop relies on Linux: real-time priority, shared memory
# without a name, SocketCAN, pseudo-terminals. All others run wherever Python does.
NEED_LINUX = (
    *("demo", "run", "simulate", "tune", "latency", "monitor", "status", "live"),
    *("set", "start", "stop", "reset", "service", "drives"),
)


class Group(click.Group):
    """A group that answers an unknown command with a list of its commands."""

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Find the command; raise a usage error that lists the commands if there is none of this name."""
        name, known = args[0], self.list_commands(ctx)
        if name not in known and not ctx.resilient_parsing and not name.startswith("-"):
            raise click.UsageError(f"no command is called {name!r}; {choices(name, known)}", ctx)
        return super().resolve_command(ctx, args)


class LazyGroup(Group):
    """A group whose commands are modules of this package, imported on use."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the names in the order of the table."""
        return list(COMMANDS)

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Find the command; raise a usage error if it needs Linux and this is another system."""
        name, command, rest = super().resolve_command(ctx, args)
        is_help = bool({"-h", "--help"} & set(rest)) or ctx.resilient_parsing
        if name in NEED_LINUX and not sys.platform.startswith("linux") and not is_help:
            others = ", ".join(each for each in COMMANDS if each not in NEED_LINUX)
            raise click.UsageError(f"'{name}' needs Linux; on this system there are: {others}", ctx)
        return name, command, rest

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import one command; return None for an unknown name."""
        if cmd_name not in COMMANDS:
            return None
        module, name = _PLACES.get(cmd_name, (cmd_name, "command"))
        command = getattr(importlib.import_module(f"friction_hil.cli.{module}"), name)
        assert isinstance(command, click.Command)
        command.short_help = COMMANDS[cmd_name]
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the overview from the table."""
        with formatter.section("Commands"):
            formatter.write_dl(list(COMMANDS.items()))


@click.group(cls=LazyGroup, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.version_option(__version__, prog_name="friction-hil", message="%(prog)s %(version)s")
def application() -> None:
    """Compensate the friction of servo axes: real-time daemon, simulated drives, replay and identification.

    Exit status: 0 done, 1 the work failed or found a fault, 2 wrong use or configuration, 3 ``health`` found a change.
    """


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit status; errors are printed on stderr.

    ``arguments``: those after the program's name; those of the process if None.
    """
    _open_standard_streams()
    _write_utf8()
    # Matrices here are tall and thin: a second BLAS thread makes them a hundred times slower, or occupies the core of
    # the loop. OpenBLAS reads this when numpy is imported.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # Imports allocate many objects and free few: collecting after each 700 allocations, and once more at exit, takes a
    # fifth of a short command's time.
    gc.set_threshold(50_000, 20, 50)
    atexit.register(gc.freeze)
    keep_asammdf_out_of_can()
    if sys.stderr.isatty():
        compiling.listeners.append(_say_compiling)
    return exit_status(application, arguments, "friction-hil")


@cache
def _say_compiling() -> None:
    click.echo("compiling, once on this machine: this takes some seconds", err=True)


def exit_status(command: click.Command, arguments: Sequence[str] | None, program: str) -> int:
    """Run a click command as ``program``, print its error on stderr, and return its exit status."""
    with _printable_streams():
        return _exit_status(command, arguments, program)


def _exit_status(command: click.Command, arguments: Sequence[str] | None, program: str) -> int:
    as_json = "--json" in (sys.argv[1:] if arguments is None else arguments)
    forget_printed()
    try:
        with interruptible(is_last=arguments is None):
            result = command.main(arguments, prog_name=program, standalone_mode=False)
        sys.stdout.flush()
    except ConfigurationError as error:
        echo_problems(error.problems)
        _echo_notes(error, as_json=as_json)
        return error.exit_status
    except FrictionHilError as error:
        echo_labelled("Error:", str(error))
        _echo_notes(error, as_json=as_json)
        return error.exit_status
    except click.ClickException as error:
        _show(error)
        if as_json:
            print_json_error(error.format_message())
        return error.exit_code
    except (click.Abort, KeyboardInterrupt) as error:
        return getattr(error.__cause__ or error, "exit_status", 130)
    except BrokenPipeError:
        # The reader of stdout has gone. Python flushes once more at exit, which must not fail.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except OSError as error:
        echo_labelled("Error:", str(error))
        _echo_notes(error, as_json=as_json)
        return 1
    except Exception:  # noqa: BLE001 - the last resort: a traceback, and where to report it
        import traceback  # imported here: --help must not wait for it

        click.echo(traceback.format_exc() + _REPORT, err=True)
        return 1
    return result if type(result) is int else 0


def _echo_notes(error: Exception, *, as_json: bool) -> None:
    """Print what an error has as notes, e.g. where the results so far are; a traceback has them itself."""
    for note in getattr(error, "__notes__", ()):
        click.echo(note, err=True)
    if as_json:
        print_json_error(str(error))


@contextlib.contextmanager
def _printable_streams() -> Iterator[None]:
    """Make everything that is printed meanwhile printable, whoever prints it."""
    before = sys.stdout, sys.stderr
    sys.stdout, sys.stderr = (PrintableStream(stream) for stream in before)
    try:
        yield
    finally:
        sys.stdout, sys.stderr = before


def _show(error: click.ClickException) -> None:
    """Print an error of click, with the usage of the command if it has any."""
    text = io.StringIO()
    error.show(text)
    usage, label, message = text.getvalue().partition("Error:")
    click.echo(usage, err=True, nl=False)
    echo_labelled(label, message.strip())


def _open_standard_streams() -> None:
    """Open the null device for each standard stream that the caller has closed.

    Otherwise the next file to be opened would get its number, and printed text would end up in that file.
    """
    for descriptor, (name, mode) in enumerate((("stdin", "r"), ("stdout", "w"), ("stderr", "w"))):
        try:
            os.fstat(descriptor)
        except OSError:
            os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)  # gets the lowest free number: this one
            setattr(sys, name, open(descriptor, mode, encoding="utf-8", closefd=False))  # noqa: SIM115


def _write_utf8() -> None:
    """Write UTF-8 into files and pipes where the system would choose an encoding without Greek letters (Windows)."""
    for stream in (sys.stdout, sys.stderr):
        if sys.platform == "win32" and isinstance(stream, io.TextIOWrapper) and not stream.isatty():
            stream.reconfigure(encoding="utf-8")


_REPORT = (
    f"This is an error in friction-hil {__version__}, not in your input. Please report it with the lines above"
    " and the command that caused it."
)
