"""Observations of the friction of an axis from one of its recordings. Pure."""

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from friction_hil.errors import RecordingError
from friction_hil.health import thresholds as th
from friction_hil.health.observation import (
    BREAKAWAY,
    DIRECTIONS,
    LOST_MOTION,
    AxisKind,
    Layout,
    Motion,
    Observation,
    Quantity,
    layout_of,
)
from friction_hil.health.sliding import fit_sliding
from friction_hil.identification.data import RegressionSegment, prepare
from friction_hil.identification.sliding import sliding_rows, top_speed
from friction_hil.numerics import filtering
from friction_hil.numerics.jit import Array
from friction_hil.recordings import Recording
from friction_hil.recordings.columns import TIME
from friction_hil.recordings.parts import SUFFIX
from friction_hil.recordings.quality import without_overflow

COLUMNS = (TIME, "position", "velocity", "torque", "temperature", "load_position")  # of a recording, that are used
_NAMELESS = "axis"
_HOW = f"reverse {th.FEWEST_REVERSALS} times or more in each direction, with strokes of a tenth of the travel"


def by_axis(path: Path, several: Mapping[str, Recording], axis: str | None = None) -> Mapping[str, Recording]:
    """Return the recordings by axis; the axis of a table has the name of its file, which is not that of other files."""
    if list(several) == [path.stem] and path.suffix.lower() != SUFFIX:
        return {axis or _NAMELESS: next(iter(several.values()))}
    return several


def observe(
    recording: Recording,
    *,
    started_s: float,
    kind: AxisKind = "rotary",
    layout: Layout | None = None,
    orders: tuple[float, ...] = (),
    window_s: float = th.WINDOW_S,
) -> tuple[list[Observation], Layout, list[str]]:
    """Measure the friction of an axis in a recording.

    Parameters
    ----------
    recording : Recording
        With ``position`` and ``torque``; ``velocity``, ``temperature`` and ``load_position`` are used if they are
        there.
    started_s : float
        Time of ``time_s`` 0, s since 1970.
    kind : str
        ``rotary`` or ``linear``.
    layout : Layout, optional
        That of former observations of the axis, with which these will be compared; without one it is made from this
        recording.
    orders : tuple of float
        Orders of ripple to watch, for a new layout.
    window_s : float
        Length of the stretch of one observation, s; a recording is divided into equal stretches of about this length.

    Returns
    -------
    observations : list of Observation
    layout : Layout
    problems : list of str
        Why a stretch has no observation.

    Raises
    ------
    RecordingError
        The recording has no position or no torque.
    """
    recording.require("position", "torque")
    if layout is None:
        position = without_overflow(recording["position"])
        layout = layout_of(position[np.isfinite(position)], kind, orders)
    found, problems = [], []
    for part in _windows(recording, window_s):
        try:
            found.append(_observed(part, started_s, layout))
        except RecordingError as error:
            problems.append(str(error))
    return found, layout, problems


def _windows(recording: Recording, window_s: float) -> Iterator[Recording]:
    time = recording[TIME]
    count = max(1, round(recording.duration_s / window_s))
    index = np.clip(((time - time[0]) / max(recording.duration_s, 1e-9) * count).astype(int), 0, count - 1)
    for k in range(count):
        yield replace(recording.at(index == k), problems=[], restarts=[], events=[])


def _observed(part: Recording, started_s: float, layout: Layout) -> Observation:
    records = prepare(part)
    sliding = sliding_rows(records) if top_speed(records) > 0.0 else []
    if not sliding:
        raise RecordingError(
            f"{part.path}: axis {part.axis} slides for too short a time between "
            f"{part[TIME][0]:.6g} and {part[TIME][-1]:.6g} s: no observation"
        )
    fit = fit_sliding(sliding, layout)
    add_reversals(records, fit.inertia, fit.levels, fit.quantities, fit.not_shown)
    if (lost := lost_motion_of_load(part)) is not None:
        fit.quantities[LOST_MOTION] = lost
        fit.not_shown.pop(LOST_MOTION, None)
    speeds = np.concatenate([np.abs(each.record.velocity[each.rows]) for each in sliding])
    position = without_overflow(part["position"])
    return Observation(
        source=Path(part.path).name,
        time_s=started_s + float(np.mean(part[TIME])),
        duration_s=part.duration_s,
        temperature=_mean(part.columns.get("temperature")),
        motion=Motion(float(np.median(speeds)), float(np.nanmax(position) - np.nanmin(position))),
        quantities=fit.quantities,
        not_shown=fit.not_shown,
    )


def _mean(values: Array | None) -> float | None:
    """Return the mean of what is known; None if nothing is."""
    if values is None:
        return None
    values = without_overflow(values)
    known = values[np.isfinite(values)]
    return float(np.mean(known)) if known.size else None


def add_reversals(
    records: Sequence[RegressionSegment],
    inertia: float,  # of the axis, kg m^2 or kg
    levels: Mapping[str, float],  # friction of each direction where the axis slides, N m or N
    quantities: dict[str, Quantity],  # these and ``not_shown`` are results, which are added to
    not_shown: dict[str, str],
) -> None:
    """Add break-away friction of each direction, and lost motion."""
    peaks: dict[str, list[float]] = {each: [] for each in DIRECTIONS}
    distances: list[float] = []
    travel = max(float(np.ptp(each.position)) for each in records)
    for record in records:
        cut = min(th.WIDE_HZ, th.WIDE_BAND * record.rate_hz)
        if len(record.velocity) <= filtering.lowpass_padding():
            continue
        both = np.column_stack([record.torque - inertia * record.acceleration, record.velocity])
        smooth = filtering.lowpass(both, cut, record.rate_hz)
        _collect(smooth[:, 0], smooth[:, 1], record.position, travel, levels, peaks, distances)
    for direction in DIRECTIONS:
        _add(f"{BREAKAWAY}.{direction}", peaks[direction], _HOW, quantities, not_shown)
    _add(LOST_MOTION, distances, _HOW, quantities, not_shown)


def _collect(
    friction: Array,
    velocity: Array,
    position: Array,
    travel: float,
    levels: Mapping[str, float],
    peaks: dict[str, list[float]],
    distances: list[float],
) -> None:
    turns = np.flatnonzero(np.diff(np.signbit(velocity))) + 1
    for begin, end in itertools.pairwise([*turns.tolist(), len(velocity)]):
        moved = np.abs(position[begin:end] - position[begin])
        if not np.max(moved, initial=0.0) >= th.LEAST_STROKE * travel:
            continue
        direction = DIRECTIONS[int(velocity[begin] < 0.0)]
        along = (-friction if velocity[begin] < 0.0 else friction)[begin:end]
        reach = int(np.argmax(moved >= th.REACH * travel)) + 1
        peaks[direction].append(float(np.max(along[:reach])))
        if direction in levels:
            is_reached = along >= th.REACHED * levels[direction]
            if is_reached.any():
                distances.append(float(moved[int(np.argmax(is_reached))]))


def _add(
    name: str, found: Sequence[float], how: str, quantities: dict[str, Quantity], not_shown: dict[str, str]
) -> None:
    if len(found) < th.FEWEST_REVERSALS:
        not_shown[name] = how
        return
    quantities[name] = Quantity(float(np.mean(found)), float(np.std(found, ddof=1)) / math.sqrt(len(found)))


def lost_motion_of_load(recording: Recording) -> Quantity | None:
    """Return the difference of motor and load between the directions; None if the recording does not show it."""
    if "load_position" not in recording:
        return None
    motor, load = (without_overflow(recording[name]) for name in ("position", "load_position"))
    velocity = np.gradient(motor, recording["time_s"])
    top = float(np.nanmax(np.abs(velocity), initial=0.0))
    is_known = np.isfinite(motor) & np.isfinite(load) & np.isfinite(velocity)
    rows = is_known & (np.abs(np.nan_to_num(velocity)) > th.STUCK * top)
    if np.count_nonzero(rows) < th.FEWEST_REVERSALS:
        return None
    sides = np.sign(velocity[rows])
    strokes = np.cumsum(np.diff(sides, prepend=sides[0]) != 0.0)  # each stroke gives one independent mean
    means = np.array([np.mean((motor - load)[rows][strokes == k]) for k in range(strokes[-1] + 1)])
    of_side = np.array([sides[strokes == k][0] for k in range(strokes[-1] + 1)])
    pair = [means[of_side == side] for side in (1.0, -1.0)]
    if min(map(len, pair)) < th.FEWEST_REVERSALS:
        return None
    error = math.hypot(*(float(np.std(each, ddof=1)) / math.sqrt(len(each)) for each in pair))
    return Quantity(float(np.mean(pair[0]) - np.mean(pair[1])), error)
