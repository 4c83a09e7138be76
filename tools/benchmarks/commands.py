"""The command line ``tools/bench NAME [--json]``: one subcommand for each benchmark."""

import importlib
from pathlib import Path

import click

from friction_hil.cli.options import option_json
from friction_hil.errors import UsageError, choices
from tools.benchmarks.report import show

_FOLDER = Path(__file__).parent
_OTHERS = {"__init__", "__main__", "c_library", "commands", "processes", "report"}
NAMES = sorted(
    {path.stem for path in _FOLDER.glob("*.py")} - _OTHERS
    | {path.parent.name for path in _FOLDER.glob("*/__init__.py")}
)


class Benchmarks(click.Group):
    """A subcommand for each module or package: its own ``command``, or one that prints the rows of its ``run``."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the names of all benchmarks."""
        return NAMES

    def get_command(self, ctx: click.Context, name: str) -> click.Command:
        """Import a benchmark and return its command."""
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
    """Run one of the benchmarks and print the figures; --json for scripts."""
