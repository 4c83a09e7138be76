"""What the experiment of `tune` loses by ending early: axes identified from all of it, and from its first parts.

Each simulated axis makes both experiments without a bus. The models that tune would try compensate the simulated axis
on motions of other speeds and strokes. The best one is shown, by the figures with which a trial decides: own motion,
and with the same weight all others together.
"""

import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import click
import numpy as np
from friction_hil_drivers.canopen.simulated.drives import SimulatedCanopenDrives

from friction_hil.checked_yaml.text import dump
from friction_hil.cli.options import option_json
from friction_hil.cli.output import print_json
from friction_hil.cli.work.tables import new_table, number, print_table, prose
from friction_hil.config import Configuration, load
from friction_hil.daemon.assembly import make_path, ramp_s
from friction_hil.daemon.safety import LoopState
from friction_hil.drive import AxisFacts
from friction_hil.errors import RecordingError, UsageError
from friction_hil.models.model_file import ModelFile
from friction_hil.motion.trajectory import PathTime, Trajectory
from friction_hil.numerics.readable import digits
from friction_hil.recordings import Recording
from friction_hil.servo.config import ServoConfig
from friction_hil.servo.servo import Servo
from friction_hil.tuning.candidates import CandidateFit, ExperimentPart, candidates, identified
from friction_hil.tuning.choice import model_content
from friction_hil.tuning.motions import experiment_of, experiment_run
from friction_hil.tuning.rehearsed import rehearse, to_try
from friction_hil.tuning.sequential import Observer, Unknown, part_durations
from friction_hil.tuning.two_steps import label
from tools.benchmarks.report import machine
from tools.benchmarks.tune import OWN as AXES
from tools.benchmarks.tune.axes import read_axes
from tools.benchmarks.tune.judge import OWN, Reduction, Rehearsals

_MODES = {"csp": 8, "csv": 9}
_SHOWN = ("own", "fast", "small", "slow", "tiny")


@dataclass(frozen=True, slots=True)
class Row:
    """One experiment of one axis.

    Attributes
    ----------
    is_sequential : bool
        True if it was made in parts, and might end early.
    experiment_s : float
        How long it took.
    unknown : float or None
        Share of the friction along the own motion, when it ended; None if it was not sequential.
    identification_s : float
        CPU time of identification and rehearsal.
    estimates_s : float
        CPU time of the estimates between the parts.
    """

    axis: str
    is_sequential: bool
    experiment_s: float
    unknown: float | None
    model: str
    tried: tuple[str, ...]
    reductions: dict[str, Reduction]
    identification_s: float
    estimates_s: float


@click.command()
@click.argument("files", nargs=-1, type=click.Path(path_type=Path, exists=True))
@click.option("--only", help="Names of the axes, separated by commas.")
@click.option("--models", help="Families of friction models, separated by commas; all by default.")
@option_json
def command(files: tuple[Path, ...], only: str | None, models: str | None, as_json: bool) -> None:
    """Compare experiments that end early with those of the configured duration.

    FILES are configurations of one simulated axis each, in csp or csv; by default the axes are those of bench tune.
    """
    axes = read_axes(files or (AXES,), tuple(only.split(",")) if only else ())
    families = tuple(models.split(",")) if models else ()
    rows = []
    for name, content in axes.items():
        click.echo(f"{name} ...", err=True)
        rows += list(_compared(name, content, families))
    if as_json:
        print_json({"machine": machine(), "rows": [asdict(each) for each in rows]})
        return
    table = new_table(
        prose("axis"),
        *map(number, ("experiment s", "unknown %")),
        prose("model"),
        *map(number, _SHOWN),
        number("CPU s"),
    )
    for each in rows:
        cells = [f"{digits(one.rms, 2)}/{digits(one.peak, 2)}" for one in (each.reductions[name] for name in _SHOWN)]
        unknown = "-" if each.unknown is None else digits(100.0 * each.unknown, 2)
        cpu = f"{each.identification_s:.0f} + {each.estimates_s:.1f}"
        table.add_row(each.axis, f"{each.experiment_s:g}", unknown, each.model, *cells, cpu)
    print_table(table)
    click.echo("times lower, RMS/peak; CPU time of identification and rehearsal + of the estimates between the parts")
    click.echo(machine())


def _compared(name: str, content: dict[str, Any], families: Sequence[str]) -> Iterator[Row]:
    """Yield the row of the whole experiment, and that of the one in parts."""
    with TemporaryDirectory(prefix="friction-hil-") as folder:
        file = Path(folder) / f"{name}.yaml"
        file.write_text(dump(content), encoding="utf-8")
        configuration = load(file, needs_models=False)
    [(axis_name, axis)] = configuration.axes.items()
    longest_s = experiment_of(axis_name, axis).duration_s
    rehearsals = Rehearsals(axis, configuration.period_s, _SHOWN)
    for is_sequential in (False, True):
        drive = _Drive(configuration, axis_name)
        lengths = part_durations(longest_s) if is_sequential else (longest_s,)
        observer = Observer(configuration, axis_name)
        parts: list[ExperimentPart] = []
        unknown: Unknown | None = None
        estimates_s = 0.0
        for length_s in lengths:
            parts.append(drive.experiment(length_s))
            if is_sequential:
                begin = time.process_time()
                unknown = observer.take(parts[-1])
                estimates_s += time.process_time() - begin
                if unknown.is_negligible:
                    break
        begin = time.process_time()
        tried = _to_try(parts, configuration, families)
        identification_s = time.process_time() - begin
        found = {
            label(*each): rehearsals.reductions(ModelFile.model_validate(model_content(*each, axis))) for each in tried
        }
        best = max(found, key=lambda name: _score(found[name]))
        yield Row(
            name,
            is_sequential,
            sum(each.duration_s for each in parts),
            None if unknown is None else max(unknown.deviation, unknown.change),
            best,
            tuple(found),
            found[best],
            identification_s,
            estimates_s,
        )


def _score(reductions: dict[str, Reduction]) -> float:
    logs = {name: math.log(each.rms * each.peak) for name, each in reductions.items()}
    own = logs.pop(OWN)
    return own + sum(logs.values()) / len(logs)


def _to_try(
    parts: Sequence[ExperimentPart], configuration: Configuration, families: Sequence[str]
) -> list[CandidateFit]:
    found = identified(parts, configuration, families, on_fit=lambda _: None, on_problem=lambda _: None)
    try:
        return to_try(rehearse(parts[-1].recording, configuration, found))
    except RecordingError:
        return candidates(found)


class _Drive:
    """A simulated axis without a bus."""

    def __init__(self, configuration: Configuration, name: str) -> None:
        axis = configuration.axes[name]
        if axis.mode not in _MODES or not isinstance(axis.simulation, ServoConfig):
            raise UsageError(f"{name}: this benchmark simulates drives in {' and '.join(_MODES)} without a bus")
        self._configuration, self._name, self._axis = configuration, name, axis
        self._servo = Servo(axis.simulation)
        self._servo.set_period(configuration.period_s)
        self._facts: AxisFacts = SimulatedCanopenDrives.simulated_facts(name, axis, configuration.period_s)

    def experiment(self, length_s: float) -> ExperimentPart:
        """Make an experiment of this length, from where the axis stands."""
        period_s, name = self._configuration.period_s, self._name
        run, duration_s = experiment_run(self._configuration, name, length_s)
        clock = PathTime(ramp_s(run.axes.values()))
        motion = Trajectory(make_path(run.axes[name], self._facts.position_resolution, period_s), clock)
        motion.begin_at(self._servo.position)
        clock.start(0.0)
        time_s = np.arange(1, round(duration_s / period_s) + 1) * period_s
        steps = round(period_s * self._servo.steps_per_second)
        gain = self._axis.controller.position_gain if self._axis.controller is not None else 0.0
        rows = np.empty((len(time_s), 5))
        for k, now in enumerate(time_s.tolist()):
            goal = motion.at(now)
            is_position = self._axis.mode == "csp"
            own = goal.velocity + gain * (goal.position - self._servo.position)
            self._servo.command(_MODES[self._axis.mode], goal.position if is_position else own)
            self._servo.advance(steps)
            rows[k] = self._servo.position, self._servo.velocity, self._servo.torque, goal.position, goal.velocity
        names = ("position", "velocity", "torque", "position_demand", "velocity_demand")
        columns = dict(zip(names, np.ascontiguousarray(rows.T), strict=True))
        count = len(time_s)
        columns |= {"time_s": time_s, "cycle": np.arange(count, dtype=np.float64)}
        columns |= {"state": np.full(count, float(LoopState.RUNNING)), "temperature": np.full(count, np.nan)}
        facts = {**asdict(self._facts), "name": name}
        return ExperimentPart(Recording(f"{name}.mcap", name, columns, {"facts": [facts]}), length_s)
