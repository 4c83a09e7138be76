"""Circularity test of machine tools: a recorded circle, without and with compensation, and after learning. Pure."""

import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from friction_hil.analysis import following
from friction_hil.analysis.following import SETTLE_S, Figures
from friction_hil.config import AxisConfig, Circle, Configuration, from_dict
from friction_hil.daemon.assembly import ramp_s
from friction_hil.daemon.safety import LoopState
from friction_hil.errors import RecordingError
from friction_hil.numerics.readable import POSITION_UNITS
from friction_hil.recordings import columns as names
from friction_hil.recordings.recording import Array, Recording
from friction_hil.replay.changes import settings_after

FIGURES = ("rms", "peak")  # of a following error, in the order in which they are shown
RING_SHARE = 0.2  # distance between two rings of the scale, as a fraction of the drawn radius
_Columns = Mapping[str, Mapping[str, Array]]  # by axis and name
_RINGS = 3  # number of rings that the largest error reaches
_COLUMNS = (*following.COLUMNS, "velocity_estimate", "compensation")


@dataclass(frozen=True, slots=True)
class RingScale:
    """Scale of a picture of radius errors: rings about the nominal circle, which is drawn with radius 1."""

    ring: float  # error from ring to ring, rad or m; 1, 2 or 5 times a power of ten
    magnification: float  # by which an error is drawn larger than the circle
    inner: int  # rings inside of the nominal circle, at least 1
    outer: int  # rings outside of it, at least 1


@dataclass(frozen=True, slots=True)
class Laps:
    """Whole laps in steady motion with the same settings, either all without or all with compensation."""

    count: int
    interval_s: tuple[float, float]  # in the recording's time
    rows: int  # periods of the laps, used or not
    angle: Array  # (n,), of each used row on the circle, rad; -pi to pi, from the first axis towards the second
    radius_error: Array  # (n,), measured minus nominal radius, about the nominal centre, rad or m
    figures: dict[str, Figures]  # following error by axis

    @property
    def left_out(self) -> int:
        """Number of periods that are not used, because the computer was late in them or shortly before."""
        return self.rows - self.angle.size

    @property
    def circular_range(self) -> float:
        """Largest minus smallest radius error, rad or m."""
        return float(np.ptp(self.radius_error))


@dataclass(frozen=True, slots=True)
class Circularity:
    """Analysis of a circle without and with compensation, and with what was learned."""

    configuration: Configuration
    axes: tuple[str, str]  # the first is drawn to the right, the second upwards
    radius: float  # nominal, rad or m
    unit: str  # of the position: rad or m
    uncompensated: Laps
    compensated: Laps  # with the settings of the configuration
    # with the settings that learning has kept; None if it has kept none, or so late that there are not as many laps
    learned: Laps | None
    learned_axes: dict[str, AxisConfig]  # with these settings; empty without such laps
    # (n,) arrays of the recording by axis, in the rows that both axes have; in addition `time_s`, the following `error`
    # (NaN without fresh feedback), and `is_usable`: 0 where the computer was late
    columns: dict[str, dict[str, Array]]

    @property
    def laps(self) -> list[Laps]:
        """The laps that there are: without compensation, with it, with what was learned."""
        return [self.uncompensated, self.compensated, *([] if self.learned is None else [self.learned])]

    def factor(self, axis: str, figure: str, laps: Laps | None = None) -> float:
        """Return the ratio of ``figure`` (rms or peak) without compensation to that of ``laps``: the compensated."""
        return _ratio(self.uncompensated, laps or self.compensated, axis, figure)

    @property
    def not_helped(self) -> list[str]:
        """Axes and figures that compensation did not reduce; empty if it helped everywhere."""
        return self._not_lower(self.compensated, self.uncompensated)

    @property
    def learning_not_helped(self) -> list[str]:
        """Axes and figures that are not lower with what was learned than with the model as given."""
        return [] if self.learned is None else self._not_lower(self.learned, self.compensated)

    @property
    def learning_harmed(self) -> list[str]:
        """Axes and figures that are not lower with what was learned than without compensation."""
        return [] if self.learned is None else self._not_lower(self.learned, self.uncompensated)

    def _not_lower(self, laps: Laps, than: Laps) -> list[str]:
        pairs = itertools.product(self.axes, FIGURES)
        return [f"{axis} {name}" for axis, name in pairs if not _ratio(than, laps, axis, name) > 1.0]


def _ratio(before: Laps, after: Laps, axis: str, figure: str) -> float:
    return float(getattr(before.figures[axis].times(after.figures[axis]), figure))


def ring_scale(radius: float, lowest: float, highest: float) -> RingScale:
    """Return the scale for radius errors from ``lowest`` to ``highest`` of a circle of ``radius``, rad or m."""
    largest = max(highest, -lowest) or 1e-12 * radius  # of a perfect circle
    power = 10.0 ** math.floor(math.log10(largest / _RINGS))
    ring = next(power * step for step in (1.0, 2.0, 5.0, 10.0) if power * step * _RINGS >= largest * (1.0 - 1e-9))
    inner, outer = (max(math.ceil(reach / ring - 1e-9), 1) for reach in (-lowest, highest))
    return RingScale(ring, RING_SHARE * radius / ring, inner, outer)


def is_circle(first: Any, second: Any) -> bool:
    """Return True if two trajectories are circles of one radius and frequency, a quarter of a turn apart."""
    if not (isinstance(first, Circle) and isinstance(second, Circle)):
        return False
    is_same = first.radius == second.radius and first.frequency == second.frequency
    return is_same and abs(math.cos(first.phase - second.phase)) <= 1e-6


def duration_s(configuration: Configuration, laps: int) -> float:
    """Compute the time of motion that `analyse` needs for ``laps`` with compensation, s."""
    axes = configuration.axes.values()
    before = max(axis.compensation.baseline_s + axis.compensation.fade_s for axis in axes)
    lap = max(1.0 / getattr(axis.trajectory, "frequency", 1.0) for axis in axes)
    return before + SETTLE_S + laps * lap + 0.1


def analyse(recordings: Mapping[str, Recording]) -> Circularity:
    """Analyse the whole laps in steady motion of a run with ``baseline_s``, as many without as with compensation.

    The laps without compensation end where it fades in, those with compensation where the settings change for the first
    time or the motion ends. Those with what was learned are the last ones with the settings of the end, when a change
    that was still on trial has been taken back. After a missed period or late feedback, rows are left out until the
    drives have recovered: their error is not due to friction.

    ``recordings``: the two axes of a run by name, with its configuration. Raises `RecordingError`: the run is not a
    circle of two axes, a lap is missing, or too few rows of the laps can be used.
    """
    configuration, circle = _circle(recordings)
    first, second = recordings
    path = recordings[first].path
    cycle, columns = _aligned(recordings)
    period_s = configuration.period_s
    lap = 1.0 / (circle.frequency * period_s)
    is_running = np.all([each["state"] == LoopState.RUNNING for each in columns.values()], axis=0)
    phases = _phases(configuration, cycle, columns, is_running)
    count = min(int((stop - start) / lap + 1e-6) for start, stop in phases.values())
    if count < 1:
        present = ", ".join(
            f"{max(stop - start, 0) * period_s:.3g} s {name} compensation" for name, (start, stop) in phases.items()
        )
        raise RecordingError(f"{path}: a lap takes {lap * period_s:g} s; in steady motion there are only {present}")

    is_usable = ~following.is_recovering(cycle, list(columns.values()), period_s)
    in_last_lap = is_running & (cycle > cycle[is_running][-1] - lap)
    offsets = [deviation(columns[name], 2.0 * np.pi * cycle / lap, in_last_lap) for name in recordings]
    angle, radius_error = np.arctan2(offsets[1], offsets[0]), np.hypot(*offsets) - circle.radius

    def laps(stop: float) -> Laps:
        start = stop - count * lap
        rows = (cycle >= start - 1e-6) & (cycle < stop - 1e-6)
        used = rows & is_usable
        wanted = round(count * lap)
        following.refuse_too_few(path, int(np.count_nonzero(used)), wanted)
        index = ((cycle[used] - start) % lap).astype(np.intp)
        figures = {name: _figures(columns[name]["error"][used], index) for name in recordings}
        return Laps(count, (start * period_s, stop * period_s), wanted, angle[used], radius_error[used], figures)

    without, with_compensation = (laps(stop) for _, stop in phases.values())
    kept = _settings_at_end(recordings, configuration, columns)
    stop = _learned_end(recordings, configuration, cycle, columns, is_running, kept, count * lap) if kept else None
    learned = None if stop is None else laps(stop)
    settings = {} if stop is None else kept
    for each in columns.values():
        each.update(time_s=cycle * period_s, is_usable=is_usable.astype(np.float64))
    unit = POSITION_UNITS[configuration.axes[first].model.axis]
    three = without, with_compensation, learned
    return Circularity(configuration, (first, second), circle.radius, unit, *three, settings, columns)


def _phases(
    configuration: Configuration, cycle: Array, columns: _Columns, is_running: Any
) -> dict[str, tuple[float, float]]:
    """Return the first cycle and the end of steady motion ``without`` and ``with`` compensation as configured."""
    starting = (ramp_s(configuration.axes.values()) + SETTLE_S) / configuration.period_s
    without = is_running & ~np.any([each["is_enabled"] for each in columns.values()], axis=0)
    as_given = is_running & _is_enabled(columns) & (_changes(columns) == 0.0)
    return {
        "without": following.settled(cycle, without, starting),
        "with": following.settled(cycle, as_given, _fading(configuration)),
    }


def _settings_at_end(
    recordings: Mapping[str, Recording], configuration: Configuration, columns: _Columns
) -> dict[str, AxisConfig]:
    """Return the settings of each axis at the end, where a trial was taken back; nothing if they are as given."""
    last = int(_changes(columns).max())
    settings = {name: settings_after(each, configuration, last) for name, each in recordings.items()}
    is_as_given = all(_is_same(each, configuration.axes[name]) for name, each in settings.items())
    return {} if is_as_given else settings


def _learned_end(
    recordings: Mapping[str, Recording],
    configuration: Configuration,
    cycle: Array,
    columns: _Columns,
    is_running: Any,
    kept: Mapping[str, AxisConfig],
    least: float,
) -> float | None:
    """Return the end of the last steady motion of ``least`` cycles with the settings ``kept``; None without one."""
    changes, is_on = _changes(columns), is_running & _is_enabled(columns)
    for number in np.unique(changes[is_on & (changes > 0.0)])[::-1]:
        start, stop = following.settled(cycle, is_on & (changes == number), _fading(configuration))
        if stop - start >= least - 1e-6 and all(
            _is_same(settings_after(each, configuration, int(number)), kept[name]) for name, each in recordings.items()
        ):
            return stop
    return None


def _is_same(settings: AxisConfig, given: AxisConfig) -> bool:
    """Return True if an axis has the friction model and the gain that it was given."""
    has_gain = settings.compensation.gain == given.compensation.gain
    return has_gain and settings.model.friction == given.model.friction


def _fading(configuration: Configuration) -> float:
    """Return the number of cycles after which a change of the compensation counts as steady."""
    fade_s = max(axis.compensation.fade_s for axis in configuration.axes.values())
    return (fade_s + SETTLE_S) / configuration.period_s


def _is_enabled(columns: _Columns) -> Any:
    return np.all([each["is_enabled"] for each in columns.values()], axis=0)


def _changes(columns: _Columns) -> Array:
    """Return the number of the change of settings that is in force in each row (n,); all axes have the same."""
    return np.asarray(np.max([each[names.CHANGE] for each in columns.values()], axis=0))


def _circle(recordings: Mapping[str, Recording]) -> tuple[Configuration, Circle]:
    """Return the configuration of a run and its circle, which both axes follow a quarter of a turn apart."""
    path = next((each.path for each in recordings.values()), "")
    if len(recordings) != 2:
        raise RecordingError(f"{path}: a circle takes two axes, here are {len(recordings)}")
    first, second = recordings.values()
    if "configuration" not in first.metadata:
        raise RecordingError(f"{path}: there is no configuration in it: it is no recording of 'friction-hil run'")
    configuration = from_dict(first.metadata["configuration"], f"{path} (configuration inside)", reads_files=False)
    paths = [configuration.axes[each.axis].trajectory for each in (first, second)]
    if not (isinstance(a := paths[0], Circle) and isinstance(b := paths[1], Circle)):
        kinds = ", ".join(f"{each.axis}: {p.kind}" for each, p in zip((first, second), paths, strict=True))
        raise RecordingError(f"{path}: the trajectories are no circle: {kinds}")
    if not is_circle(a, b):
        raise RecordingError(f"{path}: a circle needs one radius and frequency, and phases a quarter of a turn apart")
    return configuration, a


def _aligned(recordings: Mapping[str, Recording]) -> tuple[Array, dict[str, dict[str, Array]]]:
    """Return the cycles that both axes have, and the columns in them with the following error."""
    for each in recordings.values():
        each.require("cycle", *_COLUMNS)
    first, second = recordings.values()
    cycle, *rows = np.intersect1d(first["cycle"], second["cycle"], return_indices=True)
    columns: dict[str, dict[str, Array]] = {}
    for (name, each), common in zip(recordings.items(), rows, strict=True):
        columns[name] = following.columns_of(each, common, _COLUMNS)
        change = each.columns.get(names.CHANGE, np.zeros(len(each)))  # earlier versions had no changes
        columns[name][names.CHANGE] = np.nan_to_num(change[common])
        columns[name]["error"] = following.error(columns[name])
    return cycle, columns


def deviation(columns: Mapping[str, Array], turn: Array, in_steady_motion: Any) -> Array:
    """Compute the position relative to the centre of the demanded circle (n,).

    The centre is fitted to the demand, which is exact in steady motion whichever rows are missing.

    ``columns``: ``position`` and ``position_demand`` of an axis, (n,). ``turn``: angle that the path has turned, from
    any beginning, rad. ``in_steady_motion``: rows to which the centre is fitted.
    """
    angle = turn[in_steady_motion]
    design = np.stack([np.cos(angle), np.sin(angle), np.ones_like(angle)], axis=1)
    _, _, centre = np.linalg.lstsq(design, columns["position_demand"][in_steady_motion])[0]
    return np.asarray(columns["position"] - centre)


def _figures(error: Array, index: Any) -> Figures:
    """Compute the figures of an error (n,) from its cycles in the lap (n,); each cycle of the lap has equal weight."""
    known = np.bincount(index)
    square = np.bincount(index, error * error)[known > 0] / known[known > 0]
    return Figures(rms=float(np.sqrt(square.mean())), peak=float(np.abs(error).max()))
