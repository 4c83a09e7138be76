"""Segments of recordings for regression, and one filter for both sides of the equation."""

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace

import numpy as np
from numpy.typing import NDArray

from friction_hil.errors import RecordingError, UsageError, choices
from friction_hil.numerics import filtering
from friction_hil.numerics.jit import Array
from friction_hil.recordings import Recording
from friction_hil.recordings.quality import resolution
from friction_hil.recordings.segments import (
    LEAST_KNOWN_FRACTION,
    EvenSignals,
    Segment,
    even_signals,
    known_fraction,
)

Mask = NDArray[np.bool_]

LEAST_ROWS = 50  # after decimation: below, errors of parameters and folds of cross-validation mean nothing
_STEADY_RATIO = 0.02  # of the top speed: if the speed changes by less, the end of a segment is steady
_DEFAULT_DECIMATION = 10
_SLOW = ("load_torque", "temperature", "position_demand")  # used where they are known
_ROWS_TO_KEEP = 1000  # the default decimation leaves at least as many


@dataclass(frozen=True, slots=True, eq=False)
class RegressionSegment(Segment):
    """Segment of a recording that is ready for regression; arrays (n,) at the full rate, SI.

    Attributes
    ----------
    rows : int
        Rows of the recording.
    decimation : int
        Each ``decimation``-th row is kept for the regression.
    begin, end : int
        Rows between which the filters have settled.
    problems : tuple of str
        Messages about defects of the recording and their treatment.
    resolution : float or None
        Step in which the measured position comes; None if it is not quantised.
    group : str
        Recordings of one group are held out together; empty for a group of its own.
    is_moving : array of bool or None
        Rows of the regression that count, among those that the filters leave; None for all.
    """

    rows: int
    decimation: int
    begin: int
    end: int
    problems: tuple[str, ...]
    resolution: float | None
    group: str = field(default="", kw_only=True)
    is_moving: Mask | None = field(default=None, kw_only=True)

    def reduce(self, values: Array) -> Array:
        """Filter (n,) or (n, m) values at the full rate and return the rows of the regression.

        Acceleration comes from a low-passed position, so that everything else has to pass that low-pass too.
        It is skipped where the decimator, which all values pass, cuts off well below it: it would change 4 parts in
        10,000 at the highest frequency that is left, and takes as long as the model.
        """
        return self.reduce_smooth(values if self._is_lowpass_idle else self.lowpass(values))

    def reduce_smooth(self, values: Array) -> Array:
        """Return the rows of the regression of values that come from the low-passed position."""
        reduced = filtering.decimate(values[self.begin : self.end], self.decimation)
        return reduced if self.is_moving is None else reduced[self.is_moving]

    def reduced_torque(self) -> Array:
        """Return the measured torque in the rows of the regression."""
        return self.reduce(self.torque)

    def reduced_time(self) -> Array:
        """Return the time stamps of the rows of the regression, s."""
        time = self.time_s[self.begin : self.end]
        time = time if self.decimation == 1 else time[filtering.decimated_rows(len(time), self.decimation)]
        return time if self.is_moving is None else time[self.is_moving]

    @property
    def _is_lowpass_idle(self) -> bool:
        if self.lowpass_hz is None or self.decimation == 1:
            return False
        return filtering.DECIMATOR_SHARE * self.rate_hz / (2.0 * self.decimation) <= 0.5 * self.lowpass_hz


def prepare(
    recording: Recording,
    *,
    lowpass_hz: float | None = None,
    decimation: int | None = None,
    least_speed: float = 0.0,
    group_by: str | None = None,
) -> list[RegressionSegment]:
    """Make a recording ready for regression.

    Parameters
    ----------
    recording : Recording
        With ``position`` and ``torque``.
    lowpass_hz : float, optional
        Cut-off of the zero-phase low-pass; velocity and acceleration then come from the position. Without it the
        recorded velocity is used, or where there is none, a tenth of the sampling rate.
    decimation : int, optional
        Keep each n-th row for the regression; the models run at the full rate. 10, or less in a short recording.
    least_speed : float
        Rows at which the axis is slower do not count: friction at rest is whatever holds the axis, which no map of
        the velocity describes, nor a spring in presliding if the position is too coarse to resolve it.
    group_by : str, optional
        Entry of the metadata whose value names the group of the recording.

    Returns
    -------
    list of RegressionSegment
        One for each part between gaps.

    Raises
    ------
    RecordingError
        A column is missing, or there are too few rows.
    UsageError
        A filter does not fit the sampling rate.
    """
    held = [name for name in _SLOW if name in recording and known_fraction(recording, name) >= LEAST_KNOWN_FRACTION]
    signals = even_signals(recording, held, lowpass_hz=lowpass_hz, is_torque_delay_removed=True)
    problems = [*recording.problems, *signals.problems]
    factor = _decimation(signals.longest, decimation)
    kept = _long_enough(signals, factor, problems)
    group = _group(recording, group_by)
    found = [_regression_segment(signals, rows, factor, tuple(problems), group) for rows in kept]
    return found if least_speed == 0.0 else _moving(found, least_speed)


def _decimation(rows: int, wanted: int | None) -> int:
    """Return the decimation of segments of up to ``rows`` rows."""
    if wanted is None:
        return min(_DEFAULT_DECIMATION, max(1, rows // _ROWS_TO_KEEP))
    if wanted < 1:
        raise UsageError(f"decimate by a whole number from 1, not {wanted}")
    return wanted


def _long_enough(signals: EvenSignals, factor: int, problems: list[str]) -> list[slice]:
    """Return the segments that the filters leave enough rows of; report the others."""
    segments, settling = signals.grid.segments, signals.settling_rows
    padding = max(filtering.lowpass_padding(), filtering.decimation_padding())
    fewest = 2 * settling + padding + LEAST_ROWS * factor
    kept = [rows for rows in segments if rows.stop - rows.start >= fewest]
    if not kept:
        raise RecordingError(
            f"{signals.recording.path}: {signals.longest} rows without a gap are too few: the filters take "
            f"{2 * settling + padding} to settle, and {LEAST_ROWS} must be left where 1 in {factor} is kept; "
            "record for longer, or raise --lowpass"
        )
    if len(kept) < len(segments):
        lost = sum(rows.stop - rows.start for rows in segments if rows not in kept)
        problems.append(f"parts of fewer than {fewest} rows are too short for the filters: {lost} rows left out")
    return kept


def _group(recording: Recording, group_by: str | None) -> str:
    if group_by is None:
        return ""
    if group_by not in recording.metadata:
        there = choices(group_by, map(str, recording.metadata)) if recording.metadata else "it has none"
        raise UsageError(f"{recording.path}: the metadata has no entry {group_by!r} to group by; {there}")
    return f"{group_by} {recording.metadata[group_by]}"


def _moving(segments: Sequence[RegressionSegment], least_speed: float) -> list[RegressionSegment]:
    """Count only rows in which the axis moves; leave out a segment that has none."""
    if not (0.0 < least_speed < math.inf):
        raise UsageError(f"the least speed that counts is a number above 0, not {least_speed:g}")
    found = []
    masks = [np.abs(segment.reduce_smooth(segment.velocity)) >= least_speed for segment in segments]
    for segment, is_moving in zip(segments, masks, strict=True):
        note = f"slower than {least_speed:g}: {np.count_nonzero(~is_moving)} of {len(is_moving)} rows do not count"
        if is_moving.any():
            found.append(replace(segment, is_moving=is_moving, problems=(*segment.problems, note)))
    return found


def _regression_segment(
    signals: EvenSignals, rows: slice, decimation: int, problems: tuple[str, ...], group: str
) -> RegressionSegment:
    segment, settling = signals.segment(rows), signals.settling_rows
    velocity = segment.velocity
    end = len(velocity) - settling
    if settling and np.ptp(velocity[end:]) < _STEADY_RATIO * np.max(np.abs(velocity)):
        end = len(velocity)  # the filters continue a segment as it ended: for steady motion that is right
    return RegressionSegment(
        **{each.name: getattr(segment, each.name) for each in fields(Segment)},
        rows=len(signals.recording),
        decimation=decimation,
        begin=settling,
        end=end,
        problems=problems,
        resolution=resolution(segment.encoder),
        group=group,
    )


class Data:
    """Several segments stacked for one regression.

    Parameters
    ----------
    records : sequence of RegressionSegment
    known : mapping, optional
        Values of linear parameters that are known while the gain of the drive is not: their torque is the column
        ``drive.inverse_gain``.

    Attributes
    ----------
    records : tuple of RegressionSegment
    parts : tuple of slice
        Rows of each record in the stack.
    torque : (k,) array
        Measured torque, reduced.
    """

    def __init__(self, records: Sequence[RegressionSegment], known: Mapping[str, float] | None = None) -> None:
        self.records = tuple(records)
        self.known = dict(known or {})
        reduced = [record.reduced_torque() for record in self.records]
        ends = np.cumsum([0, *map(len, reduced)])
        self.parts = tuple(slice(int(a), int(b)) for a, b in itertools.pairwise(ends))
        self.torque: Array = np.concatenate([np.empty(0), *reduced])
        self._columns: dict[str, Array] = {}

    def __len__(self) -> int:
        return len(self.torque)

    def stack(self, values: Sequence[Array]) -> Array:
        """Reduce full-rate (n,) or (n, m) values of each record and stack them."""
        return np.concatenate([record.reduce(each) for record, each in zip(self.records, values, strict=True)])

    def column(self, name: str) -> Array:
        """Return the torque per unit of a linear parameter, reduced (k,); it is computed once."""
        if name == "drive.inverse_gain" and name not in self._columns:
            self._columns[name] = sum(
                (value * self.column(each) for each, value in self.known.items()), start=np.zeros(len(self))
            )
        elif name not in self._columns:
            parts = []
            for record in self.records:
                if name == "inertia":
                    parts.append(record.reduce_smooth(record.acceleration))
                else:
                    parts.append(record.reduce(linear_column(name, record)))
            self._columns[name] = np.concatenate(parts)
        return self._columns[name]

    def motion(self, name: str) -> Array:
        """Return position, velocity, acceleration, load_torque or temperature, reduced (k,)."""
        return np.concatenate([record.reduce_smooth(getattr(record, name)) for record in self.records])

    @property
    def time_s(self) -> Array:
        """Time stamps of the reduced rows (k,)."""
        return np.concatenate([record.reduced_time() for record in self.records])


def linear_column(key: str, record: RegressionSegment) -> Array:
    """Compute the torque (n,) at the full rate per unit of a parameter in which the torque is linear.

    Parameters
    ----------
    key : str
        ``offset``, ``gravity.constant``, ``gravity.sine``, ``gravity.cosine``, ``viscous``, ``viscous.positive`` and
        ``viscous.negative`` (in one direction alone), ``viscous.quadratic``, ``viscous.cubic``, ``drive.back_emf``, or
        ``ripple.cosine@K`` and ``ripple.sine@K`` with K the angle per position, rad/rad or rad/m.
    """
    v, q = record.velocity, record.position
    kind, _, angle = key.partition("@")
    match kind:
        case "offset" | "gravity.constant":
            return np.ones_like(v)
        case "gravity.sine":
            return np.sin(q)
        case "gravity.cosine":
            return np.cos(q)
        case "viscous" | "drive.back_emf":
            return v
        case "viscous.positive":
            return np.maximum(v, 0.0)
        case "viscous.negative":
            return np.minimum(v, 0.0)
        case "viscous.quadratic":
            return v * np.abs(v)
        case "viscous.cubic":
            return v * v * v
        case "ripple.cosine":
            return np.cos(float(angle) * q)
        case "ripple.sine":
            return np.sin(float(angle) * q)
    raise KeyError(key)
