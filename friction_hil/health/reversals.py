"""What reversals show: the torque at which the axis breaks away, and the motion that is lost. Pure.

After a reversal the friction torque rises from the level of one direction to that of the other, while bristles turn and
the gap of a transmission is crossed. The largest friction torque of this distance is the break-away friction; the
distance after which three quarters of the new level are reached is the lost motion. Where the position of the load is
recorded, lost motion is the difference of motor and load between the directions instead.
"""

import itertools
import math
from collections.abc import Mapping, Sequence

import numpy as np

from friction_hil.health.observation import BREAKAWAY, DIRECTIONS, LOST_MOTION, Quantity
from friction_hil.identification.data import RegressionSegment
from friction_hil.numerics import filtering
from friction_hil.numerics.jit import Array
from friction_hil.recordings import Recording
from friction_hil.recordings.quality import without_overflow

_WIDE_HZ, _BAND = 100.0, 0.2  # of the low-pass, and share of the sampling rate
_REACH = 0.05  # of the travel, after a reversal: where break-away is looked for
_LEAST_STROKE = 0.1  # of the travel: smaller strokes do not leave presliding
_REACHED = 0.75  # of the level of the new direction
_FEWEST = 4  # reversals in a direction
_SLOW = 0.05  # of the top speed: slower, the load may stick
_HOW = f"reverse {_FEWEST} times or more in each direction, with strokes of a tenth of the travel"


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
        cut = min(_WIDE_HZ, _BAND * record.rate_hz)
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
        if not np.max(moved, initial=0.0) >= _LEAST_STROKE * travel:
            continue
        direction = DIRECTIONS[int(velocity[begin] < 0.0)]
        along = (-friction if velocity[begin] < 0.0 else friction)[begin:end]
        reach = int(np.argmax(moved >= _REACH * travel)) + 1
        peaks[direction].append(float(np.max(along[:reach])))
        if direction in levels:
            is_reached = along >= _REACHED * levels[direction]
            if is_reached.any():
                distances.append(float(moved[int(np.argmax(is_reached))]))


def _add(
    name: str, found: Sequence[float], how: str, quantities: dict[str, Quantity], not_shown: dict[str, str]
) -> None:
    if len(found) < _FEWEST:
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
    rows = is_known & (np.abs(np.nan_to_num(velocity)) > _SLOW * top)
    if np.count_nonzero(rows) < _FEWEST:
        return None
    sides = np.sign(velocity[rows])
    strokes = np.cumsum(np.diff(sides, prepend=sides[0]) != 0.0)  # each stroke gives one independent mean
    means = np.array([np.mean((motor - load)[rows][strokes == k]) for k in range(strokes[-1] + 1)])
    of_side = np.array([sides[strokes == k][0] for k in range(strokes[-1] + 1)])
    pair = [means[of_side == side] for side in (1.0, -1.0)]
    if min(map(len, pair)) < _FEWEST:
        return None
    error = math.hypot(*(float(np.std(each, ddof=1)) / math.sqrt(len(each)) for each in pair))
    return Quantity(float(np.mean(pair[0]) - np.mean(pair[1])), error)
