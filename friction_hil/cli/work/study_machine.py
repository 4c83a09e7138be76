"""The work of ``friction-hil study MACHINE``."""

import math
from functools import partial
from pathlib import Path

import click

from friction_hil.cli.output import print_json
from friction_hil.cli.work.following import Compared, following_table
from friction_hil.cli.work.study import study_progress
from friction_hil.cli.work.tables import print_table, say
from friction_hil.config import load, located
from friction_hil.errors import OptionError
from friction_hil.rehearsal import Motion, Rehearsal, SimulatedAxis, simulated_axes
from friction_hil.reports.figures import require_matplotlib
from friction_hil.reports.study.machine import notes, write_machine_report
from friction_hil.reports.study.report import claim
from friction_hil.study.machine import Course, MachineStudy, Run, scored, study_machine
from friction_hil.tuning.rehearsal_motions import simulated_motions

MOTIONS = ("own", "slow", "fast", "small")
_SIMULATING = 0.9  # fraction of the time


def run_machine_study(*, machine: Path, output: Path, as_json: bool) -> int:
    """Simulate a machine, write the report and print the errors; return 1 if a simulation diverged."""
    axes = simulated_axes(load(machine))
    try:
        runs = {axis.name: _runs(axis) for axis in axes}
    except OptionError as error:
        raise located(machine, error) from None
    require_matplotlib()
    claim(output)
    with study_progress() as show:
        units = {axis.name: axis.unit for axis in axes}
        result = study_machine(units, runs, lambda text, done: show(text, _SIMULATING * done))
        show("drawing", _SIMULATING)
        report = write_machine_report(output, machine.name, result)
    if as_json:
        print_json(result.facts)
    else:
        _print(result, report)
    failures = [
        f"{axis}: {motion}: {side}"
        for axis, motion, side, motion_result in result.rows()
        if not math.isfinite(motion_result.reduction(side).rms)
    ]
    for each in failures:
        click.echo(f"not finite: {each}", err=True)
    return 1 if failures else 0


def _runs(axis: SimulatedAxis) -> dict[str, Run]:
    """Return what simulates the motions of an axis, with the model and the compensation of its configuration."""
    motions = simulated_motions(axis)
    rehearsal = Rehearsal(axis.config, axis.facts, axis.period_s)
    return {name: partial(_course, axis, rehearsal, motions[name]) for name in MOTIONS if name in motions}


def _course(axis: SimulatedAxis, rehearsal: Rehearsal, motion: Motion, is_compensated: bool) -> Course:
    trace = rehearsal.trace(axis.servo, axis.config.model, motion, is_compensated=is_compensated)
    return scored(trace, axis.period_s, motion.duration_s)


def _print(result: MachineStudy, report: Path) -> None:
    rows = [
        Compared(
            (axis, motion, side),
            result.units[axis],
            each.without.errors(side),
            each.compensated.errors(side),
            each.reduction(side),
        )
        for axis, motion, side, each in result.rows()
    ]
    print_table(following_table(("axis", "motion", "at"), rows))
    for note in notes(result):
        say(note, stderr=False)
    click.echo(f"report: {report}")
