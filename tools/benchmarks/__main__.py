"""The front of the benchmarks: ``tools/bench NAME [--json]``."""

import importlib
import sys
from pathlib import Path

import click

from friction_hil.cli.output import option_json
from friction_hil.errors import FrictionHilError, UsageError, choices
from tools.benchmarks.report import show

NAMES = sorted(
    path.stem for path in Path(__file__).parent.glob("*.py") if path.stem not in ("__init__", "__main__", "report")
)


@click.command(epilog=f"Benchmarks: {', '.join(NAMES)}.")
@click.argument("name")
@option_json
def command(name: str, as_json: bool) -> None:
    """Run the benchmark NAME and print what it measured."""
    if name not in NAMES:
        raise UsageError(f"no benchmark is called {name!r}; {choices(name, NAMES)}")
    show(importlib.import_module(f"tools.benchmarks.{name}").run(), as_json=as_json)


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
