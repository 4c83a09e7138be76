"""The work of ``friction-hil study MACHINE``."""

import math
from collections.abc import Sequence
from functools import cache
from pathlib import Path

import click

from friction_hil.cli.output import print_json
from friction_hil.cli.work.following import Compared, following_table
from friction_hil.cli.work.study import study_progress
from friction_hil.cli.work.tables import print_table, say
from friction_hil.config import load, located
from friction_hil.config.simulation import Mechanism
from friction_hil.errors import OptionError
from friction_hil.rehearsal import AxisRun, Rehearsal, SimulatedMachine, rehearse, simulated_machines
from friction_hil.reports.figures import require_matplotlib
from friction_hil.reports.study.machine import notes, write_machine_report
from friction_hil.reports.study.report import claim
from friction_hil.study.machine import Course, MachineStudy, Run, scored, study_machine
from friction_hil.tuning.rehearsal_motions import simulated_motions

MOTIONS = ("own", "slow", "fast", "small")
_SIMULATING = 0.9  # fraction of the time


def run_machine_study(*, machine: Path, output: Path, as_json: bool) -> int:
    """Simulate a machine, write the report and print the errors; return 1 if a simulation diverged."""
    configuration = load(machine)
    machines = simulated_machines(configuration)
    if configuration.arm is not None:
        say("note: nothing of arm is fed forward here, as `run` does: the errors are those of the compensation alone")
    try:
        runs = {name: axis_runs for each in machines for name, axis_runs in _runs(each).items()}
    except OptionError as error:
        raise located(machine, error) from None
    require_matplotlib()
    claim(output)
    with study_progress() as show:
        units = {axis.name: axis.unit for each in machines for axis in each.axes}
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


def _runs(machine: SimulatedMachine) -> dict[str, dict[str, Run]]:
    """Return by axis what simulates its motions, with the models and the compensation of the configuration."""
    motions = simulated_motions(machine)
    loops = [Rehearsal(axis.config, axis.facts, axis.period_s) for axis in machine.axes]

    @cache  # axes of a mechanism move together
    def simulated(name: str, is_compensated: bool) -> tuple[Course, ...]:
        runs = [
            AxisRun(loop, axis.servo, axis.config.model, motion)
            for loop, axis, motion in zip(loops, machine.axes, motions[name], strict=True)
        ]
        return courses(machine.mechanism, runs, is_compensated=is_compensated)

    def run_of(index: int, name: str) -> Run:
        return lambda is_compensated: simulated(name, is_compensated)[index]

    return {
        axis.name: {name: run_of(index, name) for name in MOTIONS if name in motions}
        for index, axis in enumerate(machine.axes)
    }


def courses(mechanism: Mechanism | None, runs: Sequence[AxisRun], *, is_compensated: bool) -> tuple[Course, ...]:
    """Return the part of each axis's motion that is scored; the parameters are those of `rehearse`."""
    traces = rehearse(mechanism, runs, is_compensated=is_compensated)
    return tuple(
        scored(trace, run.rehearsal.period_s, run.motion.duration_s) for trace, run in zip(traces, runs, strict=True)
    )


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
