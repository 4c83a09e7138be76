"""What compensation does to the following error of simulated servos, over a grid of them.

Every combination of plant, drive, motion and condition of a grid file (YAML) is simulated without bus or clock,
once without compensation and once with each of the compared methods. The result is how many times lower RMS and
peak of the following error are. Deterministic: the same numbers in each run on a machine.
"""

from pathlib import Path

import click

from friction_hil.cli.output import option_json, print_json
from tools.benchmarks.compensation.grid import Grid, load
from tools.benchmarks.compensation.report import as_json as to_json
from tools.benchmarks.compensation.report import show
from tools.benchmarks.compensation.simulation import Outcome, simulate

__all__ = ["REFERENCE", "Grid", "Outcome", "command", "load", "run"]

REFERENCE = Path(__file__).with_name("reference.yaml")


def run(path: Path = REFERENCE) -> tuple[Grid, list[Outcome]]:
    """Simulate a grid file.

    Raises
    ------
    ConfigurationError
        It cannot be read or has mistakes.
    """
    grid = load(path)
    return grid, simulate(grid)


@click.command()
@click.option(
    "--grid",
    "path",
    type=click.Path(path_type=Path),
    default=REFERENCE,
    help="Plants, drives, motions and conditions (YAML). Default: the grid of the reference; see also others.yaml "
    f"in {REFERENCE.parent.name}/.",
)
@option_json
def command(path: Path, as_json: bool) -> None:
    """Print how far compensation lowers the following error of simulated servos."""
    grid, outcomes = run(path)
    if as_json:
        print_json(to_json(grid, path.name, outcomes))
    else:
        show(grid, path.name, outcomes)
