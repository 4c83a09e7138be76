"""What is wrong with the time stamps and the values of a log: found here, told and handled by others. Pure."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Rows = NDArray[np.intp]

GAP_PERIODS = 10.0  # beyond which nothing is interpolated
UNEVEN_SHARE = 0.1  # of the period: larger deviations of a time stamp make a record uneven
_COARSE_SHARE = 0.2  # of the steps standing still: then the stamps are too coarse, and no row is a repetition
_NAMED_ROWS = 5
_SAMPLE = 50_000  # rows that are enough to see the steps in which a value comes
_EXACT = 1e-2  # of a step: distances of levels that are multiples of it up to this are quantised
_FEWEST_LEVELS = 5
_FINEST = 1e-9  # of the span
_WRAP_BITS = range(8, 33)  # ranges of encoders, in counts
_WRAP_SHARE = 0.5  # of the span: a wrap jumps over more, the motion between two samples over less
_MOTION_SHARE = 0.2  # of a jump: the largest step between other samples


@dataclass(frozen=True, slots=True)
class Wrap:
    """A position that jumps back when its counter is full.

    Attributes
    ----------
    range : float
        What a wrap jumps over, in the unit of the position.
    name : str
        For people: ``2 pi``, ``2^16 steps``.
    rows : array of int
        The first row after each jump.
    """

    range: float
    name: str
    rows: Rows


@dataclass(frozen=True, slots=True)
class TimeFacts:
    """How regular time stamps are.

    Attributes
    ----------
    period_s : float
        Median distance of stamps that go forward, s; NaN where there are none.
    jitter_s : float
        Largest deviation of a distance from the period, gaps apart, s.
    gaps : array of int
        Rows before which more than `GAP_PERIODS` periods are missing.
    longest_gap_s : float
        s; 0 where there is none.
    backward, standing : array of int
        Rows whose stamp is before, or the same as, that of the row above.
    """

    period_s: float
    jitter_s: float
    gaps: Rows
    longest_gap_s: float
    backward: Rows
    standing: Rows


def all_finite(values: Array) -> bool:
    """Whether there is neither NaN nor infinity; quick where that is so."""
    with np.errstate(over="ignore", invalid="ignore"):
        return bool(np.isfinite(np.sum(values))) or bool(np.isfinite(values).all())


def time_facts(time: Array) -> TimeFacts:
    """Look at time stamps (n,), s, all finite."""
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
    """Whether so many stamps stand still that they must be rounded, not repeated."""
    return facts.standing.size > _COARSE_SHARE * rows


def spread(time: Array) -> Array:
    """Spread rows that share a stamp, in order, evenly up to the next stamp; ``time`` does not go backward."""
    first = np.flatnonzero(np.concatenate([[True], np.diff(time) > 0.0]))
    if len(first) < 2:
        return time
    counts = np.diff(np.append(first, len(time)))
    lengths = np.append(np.diff(time[first]), np.median(np.diff(time[first])))
    place = np.arange(len(time)) - np.repeat(first, counts)
    spread_time: Array = time + place * np.repeat(lengths / counts, counts)
    return spread_time


def find_jumps(position: Array, ignored: Rows | None = None) -> Rows:
    """Rows (m,) before which a position jumps as no motion does: over half its span, far beyond its other steps.

    Parameters
    ----------
    position : (n,) array
        Finite, in order of time.
    ignored : array of int, optional
        Rows before which anything may have happened, since time is missing there.
    """
    sizes = np.abs(np.diff(position))
    if ignored is not None and ignored.size:
        sizes[ignored - 1] = 0.0
    span = float(np.max(position) - np.min(position)) if len(position) else 0.0
    jumps = np.flatnonzero(sizes > _WRAP_SHARE * span)
    if not jumps.size:
        return jumps
    smallest = float(sizes[jumps].min())
    sizes[jumps] = 0.0
    return jumps + 1 if float(sizes.max()) < _MOTION_SHARE * smallest else jumps[:0]


def find_wrap(position: Array, jumps: Rows) -> Wrap | None:
    """Explain jumps by the range of a counter: 2 pi, 360, or a power of two of the steps in which the position comes.

    Parameters
    ----------
    position : (n,) array
        Finite, in order of time.
    jumps : array of int
        What `find_jumps` found.

    Returns
    -------
    Wrap or None
        None where there are none, or no such range explains all of them.
    """
    if not jumps.size:
        return None
    sizes = np.abs(np.diff(position))
    span = float(np.max(position) - np.min(position))
    step = resolution(position)
    ranges = [(2.0 * math.pi, "2 pi"), (360.0, "360")]
    if step is not None:
        ranges += [(step * 2.0**bits, f"2^{bits} steps") for bits in _WRAP_BITS]
    places = jumps - 1
    others = sizes.copy()
    others[places] = 0.0
    beside = np.maximum(others[np.maximum(places - 1, 0)], others[np.minimum(places + 1, len(sizes) - 1)])
    # what is left of a jump is motion like that before and after it
    slack = 3.0 * beside + (0.0 if step is None else 2.0 * step)
    for size, name in ranges:
        if span <= size * (1.0 + 1e-9) and np.all(np.abs(sizes[places] - size) <= slack + 1e-9 * size):
            return Wrap(size, name, jumps)
    return None


def unwrap(position: Array, wrap: Wrap) -> Array:
    """Take the jumps out of a position."""
    unwrapped: Array = np.unwrap(position, period=wrap.range)
    return unwrapped


def resolution(values: Array) -> float | None:
    """Step in which a column comes, None where it is not quantised; ``values`` (n,) may hold NaN."""
    if len(values) > _SAMPLE:
        parts = np.linspace(0, len(values) - _SAMPLE // 5, 5).astype(np.intp)
        values = np.concatenate([values[start : start + _SAMPLE // 5] for start in parts])
    levels = np.unique(values[np.isfinite(values)])
    if levels.size < _FEWEST_LEVELS:
        return None
    span = float(levels[-1] - levels[0])
    smallest = _FINEST * span  # what is less is rounding
    steps = np.diff(levels)
    steps = steps[steps > smallest]
    step = float(steps.min(initial=span))
    # Euclid's algorithm on all distances at once; of values that are not quantised it finds nothing but rounding
    while step > smallest:
        rests = steps % step
        rests = np.minimum(rests, step - rests)
        if float(rests.max()) <= _EXACT * step:
            return span / round(span / step)  # the span tells it more sharply
        step = float(rests[rests > _EXACT * step].min())
    return None


def is_coarse(values: Array) -> bool:
    """Whether a moving column stays the same from row to row more often than not, since its steps are coarse."""
    known = values[np.isfinite(values)]
    steps = np.diff(known)
    moving = (known[1:] != 0.0) | (known[:-1] != 0.0)
    return bool(moving.any()) and bool(np.mean(steps[moving] == 0.0) > 0.5) and resolution(known) is not None


def rows_text(rows: Sequence[int] | Rows, total: int) -> str:
    """``3 of 100 rows (row 4, 7, 9)``."""
    named = ", ".join(str(row) for row in rows[:_NAMED_ROWS])
    return f"{len(rows)} of {total} rows (row {named}{', ...' if len(rows) > _NAMED_ROWS else ''})"
