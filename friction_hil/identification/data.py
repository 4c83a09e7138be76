"""Segments of recordings for regression, and one filter for both sides of the equation."""

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from friction_hil.errors import RecordingError, UsageError, choices
from friction_hil.identification import thresholds as th
from friction_hil.identification.motor_motion import derivatives
from friction_hil.numerics import filtering
from friction_hil.numerics.jit import Array
from friction_hil.recordings import Recording
from friction_hil.recordings.quality import acceleration_noise, resolution
from friction_hil.recordings.segments import (
    LEAST_KNOWN_FRACTION,
    NOISE_RATIO,
    EvenSignals,
    Segment,
    default_decimation,
    even_signals,
    is_position_integrated,
    known_fraction,
    stated_torque_delay_s,
)

Mask = NDArray[np.bool_]

LEAST_ROWS = 50  # after decimation: below, errors of parameters and folds of cross-validation mean nothing
_SLOW = ("load_torque", "temperature", "position_demand")  # used where they are known


@dataclass(frozen=True, slots=True, eq=False)
class RegressionSegment(Segment):
    """Segment of a recording that is ready for regression; arrays (n,) at the full rate, SI."""

    rows: int  # of the recording
    decimation: int  # each n-th row is kept for the regression
    begin: int  # the filters have settled from this row to ``end``
    end: int
    problems: tuple[str, ...]  # defects of the recording and their treatment
    resolution: float | None  # step in which the measured position comes; None: not quantised
    # recordings of one group are held out together; empty for a group of its own
    group: str = field(default="", kw_only=True)
    # rows of the regression that count, among those that the filters leave; None for all
    is_moving: Mask | None = field(default=None, kw_only=True)
    # the driver stated how old the torque is relative to the position: then it is no mean
    is_torque_age_stated: bool = field(default=False, kw_only=True)
    # Each ``decimation``-th row is kept as it is: a model is evaluated at the low-passed motion of that row alone, and
    # compared with the low-passed torque. Where the axis slides, both are the same to first order; a filter over the
    # model's torque would mix in its torque in rows that do not count, where it is wrong.
    is_thinned: bool = field(default=False, kw_only=True)
    # False: the position is integrated from the velocity, from an unknown start
    has_position: bool = field(default=True, kw_only=True)

    def reduce(self, values: Array) -> Array:
        """Filter (n,) or (n, m) values at the full rate and return the rows of the regression.

        Acceleration comes from a low-passed position, so that everything else has to pass that low-pass too.
        It is skipped where the decimator, which all values pass, cuts off well below it: it would change 4 parts in
        10,000 at the highest frequency that is left, and takes as long as the model.
        """
        is_kept = self.is_thinned or self._is_lowpass_idle
        return self.reduce_smooth(values if is_kept else self.lowpass(values))

    def reduce_smooth(self, values: Array) -> Array:
        """Return the rows of the regression of values that come from the low-passed position."""
        if self.is_thinned:
            reduced = np.ascontiguousarray(self.kept_rows(values))
        else:
            reduced = filtering.decimate(values[self.begin : self.end], self.decimation)
        return reduced if self.is_moving is None else reduced[self.is_moving]

    def reduced_torque(self) -> Array:
        """Return the measured torque in the rows of the regression."""
        return self.reduce(self.lowpass(self.torque) if self.is_thinned else self.torque)

    def reduced_time(self) -> Array:
        """Return the time stamps of the rows of the regression, s."""
        time = self.kept_rows(self.time_s)
        return time if self.is_moving is None else time[self.is_moving]

    def kept_rows(self, values: NDArray[Any]) -> NDArray[Any]:
        """Return values at the full rate in the rows that the filters leave, whether they count or not; no filter."""
        inner = values[self.begin : self.end]
        return inner if self.decimation == 1 else inner[filtering.decimated_rows(len(inner), self.decimation)]

    @property
    def _is_lowpass_idle(self) -> bool:
        if self.lowpass_hz is None or self.decimation == 1:
            return False
        return filtering.DECIMATOR_SHARE * self.rate_hz / (2.0 * self.decimation) <= 0.5 * self.lowpass_hz


def prepare(
    recording: Recording,
    *,
    # Cut-off of the zero-phase low-pass; velocity and acceleration then come from the position. None: the recorded
    # velocity is used, or where there is none, what `even_signals` takes.
    lowpass_hz: float | None = None,
    # keep each n-th row, the models run at the full rate; None: 10, or less in a short recording
    decimation: int | None = None,
    least_speed: float = 0.0,
    sliding_s: float = 0.0,
    sliding_distance: float = 0.0,  # rad or m
    group_by: str | None = None,  # entry of the metadata whose value names the group of the recording
) -> list[RegressionSegment]:
    """Make a recording with ``position`` and ``torque`` ready for regression: a segment for each part between gaps.

    Rows slower than ``least_speed`` do not count: friction at rest is whatever holds the axis, which no map of the
    velocity describes, nor a spring in presliding if the position is too coarse to resolve it. Nor may the axis be
    slower, or reverse, for ``sliding_s`` before and after a row: the filters mix the torque of a row with that of its
    neighbours, and of a break-away they make a slow rise of the velocity under a torque near zero, which looks like a
    low static friction and a large inertia. With ``sliding_s``, rows nearer to the last reversal than
    ``sliding_distance`` do not count either: a slow axis is in presliding for long, and its torque there is no friction
    of that speed.

    Raises `RecordingError`: a column is missing, or there are too few rows; `UsageError`: a filter does not fit the
    sampling rate.
    """
    held = [name for name in _SLOW if name in recording and known_fraction(recording, name) >= LEAST_KNOWN_FRACTION]
    signals = even_signals(recording, held, lowpass_hz=lowpass_hz, is_torque_delay_removed=True)
    problems = [*recording.problems, *signals.problems]
    factor = _decimation(signals.longest, decimation)
    kept = _long_enough(signals, factor, problems)
    group = _group(recording, group_by)
    found = [_regression_segment(signals, rows, factor, tuple(problems), group) for rows in kept]
    return found if least_speed == 0.0 else _moving(found, least_speed, sliding_s, sliding_distance)


def _decimation(rows: int, wanted: int | None) -> int:
    """Return the decimation of segments of up to ``rows`` rows."""
    if wanted is None:
        return default_decimation(rows)
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


def _moving(
    segments: Sequence[RegressionSegment], least_speed: float, sliding_s: float, distance: float
) -> list[RegressionSegment]:
    """Count only rows in which the axis moves; leave out a segment that has none."""
    if not (0.0 < least_speed < math.inf):
        raise UsageError(f"the least speed that counts is a number above 0, not {least_speed:g}")
    found = []
    for each in segments:
        if sliding_s > 0.0:
            segment, slides, reach_s = _thinned(each, least_speed, sliding_s, distance)
            is_moving, around = segment.kept_rows(slides), f" there or within {1e3 * reach_s:.3g} ms"
        else:
            segment, is_moving, around = each, np.abs(each.reduce_smooth(each.velocity)) >= least_speed, ""
        around += f", or within {distance:.3g} of a reversal" if distance > 0.0 else ""
        count = np.count_nonzero(~is_moving)
        note = f"slower than {least_speed:g}{around}: {count} of {len(is_moving)} rows do not count"
        if is_moving.any():
            found.append(replace(segment, is_moving=is_moving, problems=(*segment.problems, note)))
    return found


def _thinned(
    segment: RegressionSegment, least_speed: float, sliding_s: float, distance: float
) -> tuple[RegressionSegment, Mask, float]:
    """Return a segment whose rows are kept without a filter, with derivatives that are right up to its low-pass.

    Returns also the rows (n,) in which it slides, and the time to either side that was asked of them, s.
    """
    segment, cut_hz, reach_s = replace(segment, is_thinned=True), segment.lowpass_hz, sliding_s
    if cut_hz is None:
        return segment, is_sliding(segment, least_speed, sliding_s, distance), sliding_s
    velocity, acceleration = derivatives(segment.position, segment.dt)
    segment = replace(segment, velocity=velocity, acceleration=acceleration)
    rows, least_hz = is_sliding(segment, least_speed, reach_s, distance), th.LEAST_CUT * cut_hz
    while rows.any() and cut_hz > least_hz:
        noise = acceleration_noise(segment.resolution or 0.0, cut_hz, segment.rate_hz)
        if noise <= NOISE_RATIO * np.std(segment.acceleration[rows]):
            break
        # an acceleration with the noise of the counts would make the inertia too small; what it misses of a fast one
        # is not correlated with the rest, and only adds to the residual
        cut_hz *= th.CUT_STEP
        longer_s = max(sliding_s, th.MIXED_PERIODS / cut_hz)
        if not (left := is_sliding(segment, least_speed, longer_s, distance)).any():
            break
        rows, reach_s = left, longer_s
        smooth = filtering.lowpass(segment.position, cut_hz, segment.rate_hz)
        segment = replace(segment, acceleration=derivatives(smooth, segment.dt)[1])
    return segment, rows, reach_s


def is_sliding(segment: RegressionSegment, least_speed: float, sliding_s: float, distance: float) -> Mask:
    """Return the rows (n,) about which the axis slides in one direction for ``sliding_s`` to either side.

    The axis has moved by ``distance`` or more since its last reversal.
    """
    reach = max(1, round(sliding_s * segment.rate_hz))
    found = np.zeros(len(segment.velocity), dtype=np.bool_)
    for sign in (1.0, -1.0):
        # number of rows up to each one that are too slow: it stands still over a stretch without any
        slow = np.concatenate([[0], np.cumsum(sign * segment.velocity < least_speed)])
        rows = np.arange(len(segment.velocity))
        first, last = np.maximum(rows - reach, 0), np.minimum(rows + reach + 1, len(rows))
        found |= slow[last] == slow[first]
    return found & (moved_since_reversal(segment.velocity, segment.position) >= distance)


def moved_since_reversal(velocity: Array, position: Array) -> Array:
    """Return the distance (n,) from the position at which the velocity has last changed its sign."""
    is_turn = np.diff(np.sign(velocity), prepend=0.0) != 0.0
    since = np.maximum.accumulate(np.where(is_turn, np.arange(len(velocity)), 0))
    moved: Array = np.abs(position - position[since])
    return moved


def _regression_segment(
    signals: EvenSignals, rows: slice, decimation: int, problems: tuple[str, ...], group: str
) -> RegressionSegment:
    segment, settling = signals.segment(rows), signals.settling_rows
    velocity = segment.velocity
    end = len(velocity) - settling
    if settling and np.ptp(velocity[end:]) < th.STEADY_RATIO * np.max(np.abs(velocity)):
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
        is_torque_age_stated=stated_torque_delay_s(signals.recording) is not None,
        has_position=not is_position_integrated(signals.recording),
    )


class Data:
    """Several segments stacked for one regression.

    ``known``: values of linear parameters that are known while the gain of the drive is not: their torque is the column
    ``drive.inverse_gain``.
    """

    def __init__(self, records: Sequence[RegressionSegment], known: Mapping[str, float] | None = None) -> None:
        self.records = tuple(records)
        self.known = dict(known or {})
        reduced = [record.reduced_torque() for record in self.records]
        ends = np.cumsum([0, *map(len, reduced)])
        # rows of each record in the stack
        self.parts = tuple(slice(int(a), int(b)) for a, b in itertools.pairwise(ends))
        self.torque: Array = np.concatenate([np.empty(0), *reduced])  # (k,), measured, reduced
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

    ``key`` is ``offset``, ``gravity.constant``, ``gravity.sine``, ``gravity.cosine``, ``viscous``, ``viscous.positive``
    and ``viscous.negative`` (in one direction alone), ``viscous.quadratic``, ``viscous.cubic``, ``drive.back_emf``, or
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
