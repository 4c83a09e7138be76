"""Detection of faults in the time stamps and values of a log; the callers report and repair them. Pure."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
RowIndices = NDArray[np.intp]

GAP_PERIODS = 10.0  # longer gaps are not interpolated
UNEVEN_RATIO = 0.1  # of the period: larger deviations of a time stamp make a record uneven
LARGEST = 1e100  # larger values, which are no measurements, would overflow in computations
_COARSE_FRACTION = 0.2  # of the steps being zero: above, the stamps are coarse and no row is a repetition
_NAMED_ROWS = 5
_SAMPLE = 50_000  # rows that suffice to find the steps of a quantised value
_EXACT = 1e-2  # of a step: tolerance within which the distances of quantised levels are its multiples
_FEWEST_LEVELS = 5
_FEWEST_ROUNDED = 50  # levels that show a step behind their rounding
_ROUNDED = 0.2  # of a step: standard deviation of rounded levels; of any numbers, it is 0.29
_NEAR = 1.75  # times the smallest distance of levels: below are single steps
_MOST_PARTS = 4  # of the smallest distance, if no two levels are one step apart
_STAGES = 40
_BITS = 1e-4  # of a step
_MOST_DIGITS = 1e14  # beyond, any number is a multiple of its last digit
_FINEST = 1e-9  # of the span
_WRAP_BITS = range(8, 33)  # ranges of encoders, in counts
_WRAP_RATIO = 0.5  # of the span: a wrap jumps by more, motion between two samples by less
_MOTION_RATIO = 0.2  # of a jump: the largest step between other samples


@dataclass(frozen=True, slots=True)
class Wrap:
    """Overflow of the counter of a position."""

    range: float  # size of a jump, in the unit of the position
    name: str  # in messages: `2 pi`, `2^16 steps`
    rows: RowIndices  # the first one after each jump


@dataclass(frozen=True, slots=True)
class TimeFacts:
    """Regularity of time stamps."""

    period_s: float  # median of the positive intervals; NaN if there are none
    jitter_s: float  # largest deviation of an interval from the period, without gaps
    gaps: RowIndices  # rows that follow an interval of more than `GAP_PERIODS` periods
    longest_gap_s: float  # 0 if there is none
    backward: RowIndices  # rows whose stamp is earlier than that of the previous row
    standing: RowIndices  # rows whose stamp is that of the previous row


def all_finite(values: Array) -> bool:
    """True if there is neither NaN nor infinity; fast in that case."""
    with np.errstate(over="ignore", invalid="ignore"):
        return bool(np.isfinite(np.sum(values))) or bool(np.isfinite(values).all())


def is_ordinary(values: Array) -> bool:
    """True if all values are finite and at most `LARGEST` in size; quick, as it copies nothing."""
    return not len(values) or bool(values.min() >= -LARGEST and values.max() <= LARGEST)


def too_large(values: Array) -> RowIndices:
    """Return the rows whose value is finite and above `LARGEST` in size."""
    if is_ordinary(values):
        return np.empty(0, np.intp)
    return np.flatnonzero(np.isfinite(values) & (np.abs(values) > LARGEST))


def without_overflow(values: Array) -> Array:
    """Return the values (n,) with NaN for those that are `too_large`; the same array if there are none."""
    rows = too_large(values)
    if not rows.size:
        return values
    changed = values.copy()
    changed[rows] = np.nan
    return changed


def time_facts(time: Array) -> TimeFacts:
    """Analyse time stamps (n,), s, all finite."""
    steps = np.diff(time)
    forward = steps[steps > 0.0]
    backward, standing = np.flatnonzero(steps < 0.0) + 1, np.flatnonzero(steps == 0.0) + 1
    if not forward.size:
        return TimeFacts(math.nan, 0.0, np.empty(0, np.intp), 0.0, backward, standing)
    period = float(np.median(forward))
    limit = GAP_PERIODS * period
    gaps = np.flatnonzero(steps > limit) + 1
    return TimeFacts(
        period_s=period,
        jitter_s=float(np.max(np.abs(forward[forward <= limit] - period), initial=0.0)),
        gaps=gaps,
        longest_gap_s=float(np.max(steps[gaps - 1], initial=0.0)),
        backward=backward,
        standing=standing,
    )


def stamps_are_coarse(facts: TimeFacts, rows: int) -> bool:
    """True if so many stamps are equal that they must be rounded, not repeated."""
    return facts.standing.size > _COARSE_FRACTION * rows


def spread(time: Array) -> Array:
    """Spread rows with equal stamps evenly up to the next stamp; ``time`` must not decrease."""
    first = np.flatnonzero(np.concatenate([[True], np.diff(time) > 0.0]))
    if len(first) < 2:
        return time
    counts = np.diff(np.append(first, len(time)))
    lengths = np.append(np.diff(time[first]), np.median(np.diff(time[first])))
    index = np.arange(len(time)) - np.repeat(first, counts)
    spread_time: Array = time + index * np.repeat(lengths / counts, counts)
    return spread_time


def find_jumps(position: Array, ignored: RowIndices | None = None) -> RowIndices:
    """Find jumps of a position that are no motion: over half its span, and much larger than its other steps.

    ``position`` is finite, in order of time. ``ignored``: rows that follow a gap in time, before which any motion is
    possible.
    """
    sizes = np.abs(np.diff(position))
    if ignored is not None and ignored.size:
        sizes[ignored - 1] = 0.0
    span = float(np.max(position) - np.min(position)) if len(position) else 0.0
    jumps = np.flatnonzero(sizes > _WRAP_RATIO * span)
    if not jumps.size:
        return jumps
    smallest = float(sizes[jumps].min())
    sizes[jumps] = 0.0
    return jumps + 1 if float(sizes.max()) < _MOTION_RATIO * smallest else jumps[:0]


def find_wrap(position: Array, jumps: RowIndices) -> Wrap | None:
    """Find the range of a counter that explains jumps: 2 pi, 360, or a power of two times the resolution.

    ``position`` is finite, in order of time; ``jumps``: of `find_jumps`. None if there are no jumps, or no such range
    explains all of them.
    """
    if not jumps.size:
        return None
    sizes = np.abs(np.diff(position))
    span = float(np.max(position) - np.min(position))
    step = resolution(position)
    ranges = [(2.0 * math.pi, "2 pi"), (360.0, "360")]
    if step is not None:
        ranges += [(step * 2.0**bits, f"2^{bits} steps") for bits in _WRAP_BITS]
    before = jumps - 1
    others = sizes.copy()
    others[before] = 0.0
    beside = np.maximum(others[np.maximum(before - 1, 0)], others[np.minimum(before + 1, len(sizes) - 1)])
    # tolerance: a jump contains motion as large as the steps before and after it
    slack = 3.0 * beside + (0.0 if step is None else 2.0 * step)
    for size, name in ranges:
        if span <= size * (1.0 + 1e-9) and np.all(np.abs(sizes[before] - size) <= slack + 1e-9 * size):
            return Wrap(size, name, jumps)
    return None


def unwrap(position: Array, wrap: Wrap) -> Array:
    """Remove the jumps of a wrap from a position."""
    unwrapped: Array = np.unwrap(position, period=wrap.range)
    return unwrapped


def resolution(values: Array) -> float | None:
    """Return the step of a quantised column, None if it is not quantised; ``values`` (n,) may contain NaN."""
    if len(values) > _SAMPLE:
        parts = np.linspace(0, len(values) - _SAMPLE // 5, 5).astype(np.intp)
        values = np.concatenate([values[start : start + _SAMPLE // 5] for start in parts])
    levels = np.unique(values[np.isfinite(values)])
    if levels.size < _FEWEST_LEVELS:
        return None
    step = _common_step(levels)
    if levels.size < _FEWEST_ROUNDED or (step is not None and _is_exact(step, levels)):
        return step
    return _rounded_step(levels) or step


def acceleration_noise(step: float, cut_hz: float, rate_hz: float) -> float:
    """Return the standard deviation of the acceleration of a low-passed position that is due to its counts.

    White noise of variance step^2 / 12 up to half the sampling rate, twice differentiated up to ``cut_hz``.
    """
    return step / math.sqrt(12.0) * math.sqrt(0.4 * cut_hz / rate_hz) * (math.tau * cut_hz) ** 2


def is_last_digit(step: float, values: Array) -> bool:
    """True if a step is a power of ten of which the values are multiples: a file's last digit, not a count."""
    power = 10.0 ** round(math.log10(step)) if step > 0.0 else 0.0
    size = float(np.max(np.abs(values), initial=0.0))
    if not power or abs(step / power - 1.0) > 1e-6 or size / power > _MOST_DIGITS:
        return False
    counts = values / power
    return bool(np.all(np.abs(counts - np.round(counts)) <= 1e-6 + 4.0 * np.finfo(float).eps * size / power))


def _rounded_step(levels: Array) -> float | None:
    """Return the step of quantised levels that were rounded to fewer digits since; None if they show none.

    The smallest distances are that step, give or take the last digit. It becomes more exact with each level further
    away, whose number of steps is known as long as the error of so many steps is less than half of one.
    """
    distances = np.diff(levels)
    near = distances[distances <= _NEAR * float(distances.min())]
    for parts in range(1, _MOST_PARTS + 1):
        step, base = float(np.mean(near)) / parts, levels[0]
        for end in np.unique(np.geomspace(3, len(levels), _STAGES).astype(int)):
            away = levels[:end] - base
            counts = np.round(away / step)
            spread = counts - np.mean(counts)
            if not np.any(spread):
                break
            step = float(spread @ away / (spread @ spread))
            base = levels[0] + float(np.mean(away - step * counts))
            if not step > 0.0 or (end >= _FEWEST_ROUNDED and _rest(levels[:end], base, step) > _ROUNDED):
                break
        else:
            if _rest(levels, base, step) <= _ROUNDED:
                return step
    return None


def _rest(levels: Array, base: float, step: float) -> float:
    """Return by how much levels are no multiples of a step above a base, as standard deviation in steps."""
    steps = (levels - base) / step
    return float(np.std(steps - np.round(steps)))


def _is_exact(step: float, levels: Array) -> bool:
    """True if levels are multiples of a step to the last bits, and the step is no file's last digit."""
    counts = (levels - levels[0]) / step
    return bool(np.all(np.abs(counts - np.round(counts)) < _BITS)) and not is_last_digit(step, levels)


def _common_step(levels: Array) -> float | None:
    """Return the largest step of which all distances of levels are multiples; None if there is none."""
    span = float(levels[-1] - levels[0])
    smallest = _FINEST * span  # smaller distances are rounding errors
    steps = np.diff(levels)
    steps = steps[steps > smallest]
    step = float(steps.min(initial=span))
    # Euclid's algorithm on all distances at once; for values that are not quantised it ends at rounding errors
    while step > smallest:
        rests = steps % step
        rests = np.minimum(rests, step - rests)
        if float(rests.max()) <= _EXACT * step:
            return span / round(span / step)  # the span gives a more accurate value
        step = float(rests[rests > _EXACT * step].min())
    return None


def is_coarse(values: Array) -> bool:
    """True if most consecutive values of a moving column are equal because its steps are coarse."""
    known = values[np.isfinite(values)]
    steps = np.diff(known)
    moving = (known[1:] != 0.0) | (known[:-1] != 0.0)
    return bool(moving.any()) and bool(np.mean(steps[moving] == 0.0) > 0.5) and resolution(known) is not None


def rows_text(rows: Sequence[int] | RowIndices, total: int) -> str:
    """Return text such as ``3 of 100 rows (row 4, 7, 9)``."""
    named = ", ".join(str(row) for row in rows[:_NAMED_ROWS])
    return f"{len(rows)} of {total} rows (row {named}{', ...' if len(rows) > _NAMED_ROWS else ''})"
