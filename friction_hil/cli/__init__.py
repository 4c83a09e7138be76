"""The command ``friction-hil``: one module a command, imported only when that command is used.

A command is a ``click`` command in the module of its name, under the name ``command``. It returns its exit
status (nothing: 0, done; 1: the work failed or found a fault), and raises a ``FrictionHilError`` for what is
the user's to mend.
"""

import atexit
import gc
import importlib
import os
import sys
from collections.abc import Sequence

import click

from friction_hil import __version__
from friction_hil.errors import ConfigurationError, FrictionHilError, choices

# The short help stands here, so that the overview imports no command.
COMMANDS = {
    "demo": "Show the whole thing without hardware: a circle, before and after.",
    "run": "Run the daemon against the drives of a configuration.",
    "simulate": "Simulate the drives of a configuration on its bus.",
    "replay": "Run recordings through friction models, or verify them.",
    "identify": "Find friction model and mechanics from recordings.",
    "tune": "Let the axes of a machine learn their friction, and try it.",
    "train": "Train a network on the friction of recordings, or of a model.",
    "convert": "Convert a recording, or say what is in it.",
    "study": "Show what each friction model does to a servo.",
    "models": "List the friction models, or describe one.",
    "doctor": "Tell what keeps the daemon from running, and what mends it.",
    "config": "Check, show and describe configurations.",
}


class Group(click.Group):
    """A group that answers an unknown command with what there is."""

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Find the command, or say which there are."""
        name, known = args[0], self.list_commands(ctx)
        if name not in known and not ctx.resilient_parsing and not name.startswith("-"):
            raise click.UsageError(f"no command is called {name!r}; {choices(name, known)}", ctx)
        return super().resolve_command(ctx, args)


class LazyGroup(Group):
    """A group whose commands are modules of this package, imported on use."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Names in the order of the table."""
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import one command; None for an unknown name."""
        if cmd_name not in COMMANDS:
            return None
        command = importlib.import_module(f"friction_hil.cli.{cmd_name}").command
        assert isinstance(command, click.Command)
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the overview from the table."""
        with formatter.section("Commands"):
            formatter.write_dl(list(COMMANDS.items()))


@click.group(cls=LazyGroup, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.version_option(__version__, prog_name="friction-hil", message="%(prog)s %(version)s")
def application() -> None:
    """Take the friction out of a servo axis: real-time compensation, replay and simulated drives.

    Exit status: 0 done, 1 the work failed or found a fault, 2 wrong use or configuration.
    """


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit status; what went wrong is on stderr.

    Parameters
    ----------
    arguments
        The words after the program's name; those of the process when not given.
    """
    _open_standard_streams()
    # Matrices here are tall and thin, on which a second thread of a BLAS takes a hundred times longer, or its core away
    # from the loop. It reads this when numpy is imported.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # Imports make many objects and no garbage: to look for it each 700 of them, and in all of them at the end, takes a
    # fifth of a short command's time.
    gc.set_threshold(50_000, 20, 50)
    atexit.register(gc.freeze)
    try:
        result = application.main(arguments, prog_name="friction-hil", standalone_mode=False)
        sys.stdout.flush()
    except ConfigurationError as error:
        click.echo(str(error), err=True)  # each line already begins with file:line
        return error.exit_status
    except FrictionHilError as error:
        click.echo(f"Error: {error}", err=True)
        return error.exit_status
    except click.ClickException as error:
        error.show()
        return error.exit_code
    except (click.Abort, KeyboardInterrupt):
        return 130
    except BrokenPipeError:
        # The reader has gone. Python flushes once more at exit; let it have somewhere to write.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except OSError as error:
        click.echo(f"Error: {error}", err=True)
        return 1
    except Exception:  # noqa: BLE001 - the last resort: say that it is not the user's mistake
        import traceback

        click.echo(traceback.format_exc() + _REPORT, err=True)
        return 1
    return result if type(result) is int else 0


def _open_standard_streams() -> None:
    """Put the null device where the caller has closed one of the standard streams.

    Otherwise the next file to be opened would take its number, and what is printed would end up in it.
    """
    for descriptor, (name, mode) in enumerate((("stdin", "r"), ("stdout", "w"), ("stderr", "w"))):
        try:
            os.fstat(descriptor)
        except OSError:
            os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)  # the lowest number that is free: this one
            setattr(sys, name, open(descriptor, mode, encoding="utf-8", closefd=False))  # noqa: SIM115


_REPORT = (
    f"This is a mistake in friction-hil {__version__}, not yours. Please report it with the lines above"
    " and the command that led to it."
)
