"""What is drawn of one axis of a run, in units that can be read; the picture and the page both draw it."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from friction_hil.analysis import following
from friction_hil.analysis.baseline import Phase, without_and_with
from friction_hil.config import AxisConfig, Configuration
from friction_hil.daemon.assembly import ramp_s
from friction_hil.errors import RecordingError, UsageError, choices
from friction_hil.numerics.jit import Array
from friction_hil.recordings import Recording
from friction_hil.recordings.columns import CYCLE, TIME
from friction_hil.recordings.quality import time_facts
from friction_hil.recordings.recording import CHANGE
from friction_hil.reports.numbers import comparison_rows, readable
from friction_hil.reports.run.friction import FrictionOverVelocity, friction_over_velocity
from friction_hil.reports.run.panels import Panel, following_error, largest, motion, per_second, timing, torques

FAULTS = ("fault", "abandoned")
_LARGEST = 1e30  # of a value: neither picture nor page can draw much larger ones
_UNITS = {"rotary": ("rad", "N m"), "linear": ("m", "N"), None: ("rad or m", "N m or N")}


@dataclass(frozen=True, slots=True)
class Mark:
    """Event at a time: a fault, a warning, a notice, a new state."""

    time_s: float
    kind: str
    text: str

    @property
    def is_fault(self) -> bool:
        """True if it ended the run, or the recording."""
        return self.kind in FAULTS


@dataclass(frozen=True, slots=True, eq=False)
class RunView:
    """One axis of a run, or a part of it."""

    title: str  # file and axis
    facts: str  # what ran, and what went wrong
    time_s: Array  # (n,)
    panels: tuple[Panel, ...]
    missed_s: Array  # (k,), of the first cycle after each gap
    missed: Array  # (k,), periods that were missed there
    marks: tuple[Mark, ...]
    phases: tuple[Phase | None, Phase | None]  # without and with compensation, of the whole run
    is_periodic: bool  # the motion has a period
    rows: tuple[tuple[str, ...], ...]  # figures of the phases: name with unit, without, with, times lower
    friction: FrictionOverVelocity | None
    units: tuple[str, str]  # of position and torque
    notes: tuple[str, ...]  # what is not drawn, and why

    @property
    def speed_unit(self) -> str:
        """Unit of the velocity."""
        return per_second(self.units[0])

    @property
    def comparison_label(self) -> str:
        """Label of the time of both phases."""
        return f"time within {'a period of the motion' if self.is_periodic else 'each part'} [s]"

    @property
    def error_unit(self) -> tuple[float, str]:
        """Factor and unit in which the following error of both phases can be read."""
        figures = [each.figures.rms for each in self.phases if each is not None]
        return readable(self.units[0], figures)


def make_view(
    recording: Recording, configuration: Configuration | None, window: tuple[float, float] | None = None
) -> RunView:
    """Collect what is drawn of a recording.

    Without the ``configuration`` of the run there are neither a model nor a comparison. ``window``: begin and end of
    the part to draw, s; figures are of the whole run. Raises `RecordingError`: there is nothing to draw in it, or a
    value is too large to be drawn; `UsageError`: the configuration has several axes, and none of this name.
    """
    notes: list[str] = []
    config = None if configuration is None else _config_of(recording, configuration)
    recording = _in_order(recording)
    phases = _phases(recording, configuration, config, notes)
    part = recording if window is None else _cut(recording, window)
    _refuse_huge(part)
    units = _UNITS[_kind(recording, config)]
    time = part[TIME]
    period_s = None if configuration is None else configuration.period_s
    panels = [*motion(part, units[0], notes), *following_error(part, units[0], period_s, phases, notes)]
    panels += [*torques(part, units[1], notes), *timing(part, notes)]
    friction = friction_over_velocity(part, config, notes)
    if not panels and friction is None:
        raise RecordingError(
            f"{recording.path}: nothing to draw: no column position, velocity, torque, compensation or late_us. "
            f"There are: {', '.join([*recording.columns, *recording.others])}. A column of another name is mapped with "
            "--column torque=NAME"
        )
    missed_s, missed = _missed(part)
    marks = _marks(part, recording)
    figures = tuple(comparison_rows(units[0], *(None if each is None else each.figures for each in phases)))
    return RunView(
        title=f"{Path(recording.path).name}, axis {recording.axis}",
        facts=_facts(recording, part, config, missed, marks),
        time_s=time,
        panels=tuple(panels),
        missed_s=missed_s,
        missed=missed,
        marks=marks,
        phases=phases,
        is_periodic=math.isfinite(_motion_s(config)),
        rows=figures,
        friction=friction,
        units=units,
        notes=tuple(notes),
    )


def _config_of(recording: Recording, configuration: Configuration) -> AxisConfig:
    """Return the configuration of the axis; a table of columns has no name, and gets the only axis there is.

    Raises `UsageError`: the configuration has several axes, and none of this name.
    """
    axes = configuration.axes
    if recording.axis not in axes and len(axes) > 1:
        raise UsageError(
            f"{recording.path}: the configuration has no axis {recording.axis!r}; choose one with --axis; "
            f"{choices(recording.axis, axes)}"
        )
    return axes.get(recording.axis) or next(iter(axes.values()))


def _kind(recording: Recording, config: AxisConfig | None) -> str | None:
    if config is not None:
        return config.model.axis
    unit = recording.units.get("position", recording.units.get("velocity", "")).partition("/")[0]
    return {"rad": "rotary", "m": "linear"}.get(unit)


def _in_order(recording: Recording) -> Recording:
    """Return the recording with its rows in order of time; `check` has reported it if they were not."""
    time = recording[TIME]
    if bool((time[1:] >= time[:-1]).all()):
        return recording
    return recording.at(np.argsort(time, kind="stable"))


def _cut(recording: Recording, window: tuple[float, float]) -> Recording:
    time = recording[TIME]
    rows = np.flatnonzero((time >= window[0]) & (time <= window[1]))
    if rows.size < 2:
        begin = f" from {window[0]:g} s on" if np.isfinite(window[0]) else ""
        end = f" up to {window[1]:g} s" if np.isfinite(window[1]) else ""
        raise RecordingError(
            f"{recording.path}: there are no two rows{begin}{end}: it reaches from {time[0]:g} s to {time[-1]:g} s"
        )
    return recording.at(rows)


def _refuse_huge(recording: Recording) -> None:
    for name, values in recording.columns.items():
        if (reached := largest(values)) > _LARGEST:
            at = float(recording[TIME][np.nanargmax(np.where(np.isfinite(values), np.abs(values), np.nan))])
            raise RecordingError(
                f"{recording.path}: {name} reaches {reached:.3g} at {at:g} s, too large to be drawn; --from and --to "
                "leave it out"
            )


def _phases(
    recording: Recording, configuration: Configuration | None, config: AxisConfig | None, notes: list[str]
) -> tuple[Phase | None, Phase | None]:
    missing = [name for name in (CYCLE, *following.COLUMNS) if name not in recording]
    if missing:
        notes.append(f"no figures of the following error: no column {', '.join(missing)}")
        return None, None
    if configuration is None or config is None:
        notes.append("no figures of the following error: they take the configuration; name one with --config")
        return None, None
    try:
        phases = without_and_with(
            recording,
            cycle_s=configuration.period_s,
            motion_s=_motion_s(config),
            start_s=ramp_s(configuration.axes.values()),
            fade_s=config.compensation.fade_s,
        )
    except RecordingError as error:
        notes.append(f"no figures of the following error: {error}")
        return None, None
    if phases == (None, None):
        notes.append("no figures of the following error: the run ended before the motion was steady")
    return phases


def _motion_s(config: AxisConfig | None) -> float:
    """Return the period of the configured motion, s; infinity if it has none, or another controller moves the axis."""
    frequency = None if config is None else getattr(config.trajectory, "frequency", None)
    return math.inf if frequency is None else 1.0 / float(frequency)


def _missed(recording: Recording) -> tuple[Array, Array]:
    time = recording[TIME]
    if CYCLE in recording:
        steps = np.diff(recording[CYCLE])
        rows = np.flatnonzero(steps > 1.0)
        return time[rows + 1], steps[rows] - 1.0
    facts = time_facts(time)
    steps = np.diff(time)[facts.gaps - 1] / facts.period_s if facts.gaps.size else np.empty(0)
    return time[facts.gaps], np.round(steps - 1.0)


def _marks(part: Recording, whole: Recording) -> tuple[Mark, ...]:
    if CYCLE not in whole or not whole.events:
        return ()
    cycle, time = whole[CYCLE], whole[TIME]
    first, last = part[TIME][0], part[TIME][-1]
    shown = [each for each in whole.events if each.name != CHANGE]
    marks = [Mark(float(np.interp(each.cycle, cycle, time)), each.name, each.text) for each in shown]
    return tuple(mark for mark in marks if first <= mark.time_s <= last)


def _facts(whole: Recording, part: Recording, config: AxisConfig | None, missed: Array, marks: Sequence[Mark]) -> str:
    words = [f"{whole.duration_s:.4g} s"]
    if len(part) < len(whole):
        words = [f"{part[TIME][0]:.6g} to {part[TIME][-1]:.6g} s of {words[0]}"]
    if config is not None:
        words += [f"mode {config.mode}", f"model {config.model.friction.model}, gain {config.compensation.gain:g}"]
    if missed.size:
        words.append(f"{int(missed.sum())} periods missed" if CYCLE in whole else f"{missed.size} gaps")
    faults = sum(mark.is_fault for mark in marks)
    if faults:
        words.append(f"{faults} fault{'s' * (faults > 1)}")
    return ", ".join(words)


def broken_at_gaps(view: RunView) -> tuple[Array, list[list[Array]]]:
    """Return the times and the values of all lines with a NaN in each long gap, so that no line crosses it."""
    time = view.time_s
    facts = time_facts(time) if len(time) > 1 else None
    at = np.empty(0, np.intp) if facts is None else facts.gaps
    lines = [[np.insert(line.values, at, np.nan) for line in panel.lines] for panel in view.panels]
    return np.insert(time, at, time[at]), lines
