"""Reduction of the following error by compensation, for a grid of simulated servos and for machine files.

Every combination of plant, drive, motion and condition of a grid file (YAML) is simulated without bus or clock, once
without compensation and once with each of the compared methods. The result is the factor by which RMS and peak of the
following error are lower. It is deterministic: the same numbers in each run on a machine.

Machine files are configurations whose axes have a simulation, as `friction-hil simulate` takes them. Each axis makes
its own motions, those of one mechanism together, compensated by the model of the file, by the true friction with the
conditions of the grid, and by the model that `tune` identifies on it. There the result is that of the motor and that of
the load.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from friction_hil.cli.options import option_json
from friction_hil.cli.output import print_json
from tools.benchmarks.compensation.grid import Grid, load, machine_files
from tools.benchmarks.compensation.identified import identified_models
from tools.benchmarks.compensation.machine_report import as_json as machines_to_json
from tools.benchmarks.compensation.machine_report import show_machines
from tools.benchmarks.compensation.machines import MachineResult, read_machines, simulate_machines
from tools.benchmarks.compensation.report import as_json as to_json
from tools.benchmarks.compensation.report import show
from tools.benchmarks.compensation.simulation import CaseResult, simulate
from tools.benchmarks.report import machine

__all__ = ["OTHERS", "REFERENCE", "CaseResult", "Grid", "command", "load", "run", "run_machines"]

REFERENCE = Path(__file__).with_name("reference.yaml")
OTHERS = Path(__file__).with_name("others.yaml")  # whose conditions are relative, so that they suit any machine


def run(path: Path = REFERENCE) -> tuple[Grid, list[CaseResult]]:
    """Simulate the plants of a grid file.

    Raises
    ------
    ConfigurationError
        It cannot be read or has mistakes.
    """
    grid = load(path)
    return grid, simulate(grid)


def run_machines(files: Sequence[Path], grid: Grid, identified: Path | None = None) -> list[MachineResult]:
    """Simulate machine files with the conditions of a grid.

    Parameters
    ----------
    files : sequence of Path
    grid : Grid
    identified : Path, optional
        Folder of the models that `tune` has found, or will; without it they are left out.

    Raises
    ------
    ConfigurationError, UsageError
        A file cannot be read, or has no simulated axis.
    """
    models = {} if identified is None else identified_models(files, identified)
    return simulate_machines(read_machines(files, grid.compensator, grid.conditions, models))


@click.command()
@click.argument("machines", nargs=-1, type=click.Path(path_type=Path, exists=True, dir_okay=False))
@click.option(
    "--grid",
    "path",
    type=click.Path(path_type=Path),
    help="Grid file (YAML) with plants, drives, motions and conditions.  "
    f"[default: reference.yaml; {REFERENCE.parent.name}/ also has others.yaml and slow.yaml]",
)
@click.option(
    "--identified",
    type=click.Path(path_type=Path, file_okay=False),
    metavar="DIR",
    help="Compensate each machine also by the model that tune finds on it: DIR/MACHINE/AXIS.yaml. Where there is none, "
    "tune makes it, which takes minutes; a gantry, which tune does not move, is then left without.",
)
@option_json
def command(machines: tuple[Path, ...], path: Path | None, identified: Path | None, as_json: bool) -> None:
    """Print by how much compensation reduces the following error of simulated servos.

    MACHINES are configuration files with simulated axes, e.g. config/machines/*.yaml. With them and without --grid,
    only they are simulated, with the conditions of others.yaml.
    """
    source = path or (OTHERS if machines else REFERENCE)
    grid = load(source)
    found: dict[str, Any] = {"machine": machine()}
    has_plants = path is not None or not machines
    files = [*(machine_files(grid, source) if has_plants else ()), *machines]
    if has_plants:
        results = simulate(grid)
        found |= to_json(grid, source.name, results)
        if not as_json:
            show(grid, source.name, results)
    if files:
        moved = run_machines(files, grid, identified)
        found["machines"] = machines_to_json(moved)
        if not as_json:
            show_machines(moved)
    if as_json:
        print_json(found)
    else:
        click.echo(machine())
