"""What learning makes of a wrong model: the following error of simulated servos before and after.

Rows: `off`, parameters 12 to 30 % off, after 60 s of the axis's own motion; `noisy`, the same with noise of 5 % of the
rated torque on the torque feedback; `exact`, the true parameters from the start; `drift`, a level that changes by 40 %
up and down over ten minutes, with half as much again from 400 s on;
`changing`, another motion every minute; `poor`, a 14-bit encoder, two cycles of delay, 1 % of noise on the torque and a
torque constant 10 % off; `residual`, the true parameters on an axis with more than the model file knows of (cogging,
Maxwell-slip elements instead of bristles, a hump over the speed, a pendulum whose weight loads the bearings), learned
without and with a residual layer; `wrong_layers`, wrong layers at their bound; `family`, a model file of another family
than the axis, or of the same, after 150 s without and with other families; `catastrophes`, an encoder that slips, a
load that is removed, a drive that is tuned anew and a torque that is no longer updated. All without bus or clock: the
same numbers in each run on a machine, but for the share of the processor.
"""

import sys
from dataclasses import asdict
from pathlib import Path

import click

from friction_hil.cli.options import option_json
from friction_hil.cli.output import print_json
from friction_hil.cli.work.tables import new_table, number, print_table
from tools.benchmarks.compensation import REFERENCE, load
from tools.benchmarks.compensation.grid import Grid
from tools.benchmarks.compensation.numbers import brief
from tools.benchmarks.learning.rows import Figure, cases_of, names, summary
from tools.benchmarks.report import machine

__all__ = ["command", "run"]


def run(grid: Grid, row: str, most: int | None = None) -> list[Figure]:
    """Simulate the cases of a row, at most so many, spread over all of them."""
    cases = cases_of(grid, row)
    if most is not None and most < len(cases):
        cases = [cases[k * len(cases) // most] for k in range(most)]
    with click.progressbar(cases, label=row, file=sys.stderr) as shown:
        return [work() for _, work in shown]


@click.command()
@click.option("--only", "rows", multiple=True, type=click.Choice(names()), help="Only this row; may be repeated.")
@click.option(
    "--grid",
    "path",
    type=click.Path(path_type=Path, exists=True, dir_okay=False),
    default=REFERENCE,
    help="Grid file of `bench compensation` with plants, drives and motions.  [default: its reference.yaml]",
)
@click.option("--most", type=click.IntRange(min=1), help="At most so many cases a row, spread over all of them.")
@option_json
def command(rows: tuple[str, ...], path: Path, most: int | None, as_json: bool) -> None:
    """Print what learning makes of wrong models."""
    grid = load(path)
    found = {row: run(grid, row, most) for row in rows or names()}
    if as_json:
        print_json(
            {
                "machine": machine(),
                "rows": {
                    row: {"summary": summary(row, figures), "cases": [asdict(each) for each in figures]}
                    for row, figures in found.items()
                },
            }
        )
        return
    for row, figures in found.items():
        columns = list(figures[0].values)
        table = new_table(row, *(number(name.replace("_", "\n")) for name in columns), keys=1)
        for each in figures:
            table.add_row(each.case, *(brief(each.values[name]) for name in columns))
        print_table(table)
        for name, value in summary(row, figures).items():
            click.echo(f"  {name}: {brief(value)}")
    click.echo(machine())
