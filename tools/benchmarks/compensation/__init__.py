"""Reduction of the following error by compensation, for a grid of simulated servos.

Every combination of plant, drive, motion and condition of a grid file (YAML) is simulated without bus or clock, once
without compensation and once with each of the compared methods. The result is the factor by which RMS and peak of the
following error are lower. It is deterministic: the same numbers in each run on a machine.
"""

from pathlib import Path

import click

from friction_hil.cli.options import option_json
from friction_hil.cli.output import print_json
from tools.benchmarks.compensation.grid import Grid, load
from tools.benchmarks.compensation.report import as_json as to_json
from tools.benchmarks.compensation.report import show
from tools.benchmarks.compensation.simulation import CaseResult, simulate

__all__ = ["REFERENCE", "CaseResult", "Grid", "command", "load", "run"]

REFERENCE = Path(__file__).with_name("reference.yaml")


def run(path: Path = REFERENCE) -> tuple[Grid, list[CaseResult]]:
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
    help="Grid file (YAML) with plants, drives, motions and conditions.  "
    f"[default: reference.yaml; {REFERENCE.parent.name}/ also has others.yaml and slow.yaml]",
)
@option_json
def command(path: Path, as_json: bool) -> None:
    """Print by how much compensation reduces the following error of simulated servos."""
    grid, results = run(path)
    if as_json:
        print_json(to_json(grid, path.name, results))
    else:
        show(grid, path.name, results)
