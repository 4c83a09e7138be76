"""The front of the benchmarks: ``tools/bench NAME [--json]``."""

import importlib
import sys
from pathlib import Path

import click

from friction_hil.cli.output import option_json
from friction_hil.errors import FrictionHilError, UsageError, choices
from tools.benchmarks.report import show

_FOLDER = Path(__file__).parent
NAMES = sorted(
    {path.stem for path in _FOLDER.glob("*.py")} - {"__init__", "__main__", "report"}
    | {path.parent.name for path in _FOLDER.glob("*/__init__.py")}
)


class Benchmarks(click.Group):
    """One subcommand a module or package: its own ``command``, or one that prints the rows of its ``run``."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Names of all benchmarks."""
        return NAMES

    def get_command(self, ctx: click.Context, name: str) -> click.Command:
        """Return the command of a benchmark, which is imported for that."""
        if name not in NAMES:
            raise UsageError(f"no benchmark is called {name!r}; {choices(name, NAMES)}")
        module = importlib.import_module(f"tools.benchmarks.{name}")
        if hasattr(module, "command"):
            own: click.Command = module.command
            return own

        @click.command(name, help=module.__doc__)
        @option_json
        def print_rows(as_json: bool) -> None:
            show(module.run(), as_json=as_json)

        return print_rows


@click.command(cls=Benchmarks)
def command() -> None:
    """Run one of the benchmarks and print what it measured; --json for scripts."""


def main() -> int:
    """Run the command line; return its exit status."""
    try:
        command.main(prog_name="tools/bench", standalone_mode=False)
    except FrictionHilError as error:
        click.echo(f"Error: {error}", err=True)
        return error.exit_status
    except click.ClickException as error:
        error.show()
        return error.exit_code
    except (click.Abort, KeyboardInterrupt):
        return 130
    return 0


sys.exit(main())
