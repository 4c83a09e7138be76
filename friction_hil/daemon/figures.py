"""Figures of an axis in a run: its following error without and with compensation, and its feedback."""

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np

from friction_hil.daemon.delay_fit import DelaySums
from friction_hil.numerics.jit import Array

_LONGEST_GAP = 10_000  # cycles; a longer one is a fault in any configuration
_MOST_REASONS = 20
_NAMED_WITHIN, _NAMED_SHARE = 100, 0.2  # cycles before a fault, and the missing part of them that may have caused it
_OTHERS = "other reasons"
_MOST_PERIODS = 1000  # of a condition that are kept apart, the last ones
_ROUNDING = 1e-6  # of a cycle

SETTLE_S = 0.5  # time for the drive's loops to settle after a ramp or a fade
RECOVERY_S = 0.03  # after a missed period: several time constants of a position loop
RECOVERY_OF_MISSED = 5.0  # additional periods for each that was missed
RECOVERY_OF_LATE = 5.0  # periods; feedback that follows late feedback may belong to an earlier cycle


@dataclass(frozen=True, slots=True)
class Figures:
    """Following error of one axis, rad or m: root mean square and largest absolute value."""

    rms: float
    peak: float

    def times(self, other: "Figures") -> "Figures":
        """Return the ratios of these figures to ``other``: how many times lower the others are."""
        return Figures(_ratio(self.rms, other.rms), _ratio(self.peak, other.peak))


@dataclass(frozen=True, slots=True)
class ErrorFigures(Figures):
    """Following error in one condition, rad or m, over ``seconds`` of steady motion in it."""

    seconds: float


def figures_of(error: Array) -> Figures:
    """Return the figures of an error (n,); infinity if a value is not finite, as in a simulation that diverged."""
    rms = float(np.sqrt(np.mean(error**2)))
    return Figures(rms, float(np.max(np.abs(error)))) if math.isfinite(rms) else Figures(math.inf, math.inf)


def _ratio(before: float, after: float) -> float:
    """Compute before / after, where an error below the encoder's resolution is zero."""
    if after == 0.0:
        return math.inf if before > 0.0 else 1.0
    return before / after


class Condition(IntEnum):
    """State of the compensation in a cycle."""

    FADING = 0  # or the axis does not move: the cycle does not count
    WITHOUT = 1
    WITH = 2


@dataclass(frozen=True, slots=True)
class ConditionFigures(Figures):
    """Following error of one axis in one condition; ``rms`` and ``peak`` in rad or m."""

    counted: int  # cycles that count
    left_out: int  # cycles that do not because a period was missed or feedback was late, in them or shortly before
    is_whole: bool = True  # False if they are less than a period of the motion, and so miss parts of it


@dataclass(frozen=True, slots=True)
class AxisFigures:
    """Figures of one axis in a run."""

    unit: str  # of the position: rad or m
    without: ConditionFigures | None  # following error without compensation; None if no cycle of the condition counts
    compensated: ConditionFigures | None  # the same with compensation
    # False if the motion differs from one moment to the next, as that of an experiment does: then the two conditions do
    # not compare
    is_comparable: bool
    stale: int  # cycles without usable feedback
    bridged: int = 0  # those of them after which there was feedback again
    # number of bridged cycles by the reason that the driver gave
    bridged_reasons: dict[str, int] = field(default_factory=dict)
    load: "AxisFigures | None" = None  # the same of the load, against the path; None where it has no encoder
    taken_back: str = ""  # what the compensation was taken back for; empty if it was not
    configured_delay: float = math.nan  # periods until the drive's demand equals a set-point
    # the same as the errors fit it, which are then given without it; NaN where they show no other one
    delay: float = math.nan
    lacks_demand: bool = False  # another controller moves the axis, and no demanded position was heard of it

    @property
    def reduction(self) -> Figures | None:
        """Ratios of the following error without to with compensation; None if there is nothing to compare."""
        if self.without is None or self.compensated is None or not self.is_comparable:
            return None
        if not (self.without.is_whole and self.compensated.is_whole):
            return None
        return self.without.times(self.compensated)


@dataclass(slots=True)
class _Part:
    """Sum over cycles of one condition, from ``begin`` to ``end``, cycles of the motion."""

    begin: float
    end: float
    count: int = 0
    left_out: int = 0
    square: float = 0.0
    peak: float = 0.0
    sums: DelaySums = field(default_factory=DelaySums)

    def add(self, other: "_Part") -> None:
        """Add the cycles of another part, which may follow at any time."""
        self.begin, self.end = min(self.begin, other.begin), max(self.end, other.end)
        self.count += other.count
        self.left_out += other.left_out
        self.square += other.square
        self.peak = max(self.peak, other.peak)
        self.sums.join(other.sums)


class _Parts:
    """What is known of one condition: whole periods of the motion, and steady motion that was shorter than one."""

    __slots__ = ("last", "partial", "whole")

    def __init__(self) -> None:
        self.whole = _Part(math.inf, -math.inf)
        self.last: deque[_Part] = deque(maxlen=_MOST_PERIODS)
        self.partial: list[_Part] = []


class FollowingErrors:
    """Following error of one axis without and with compensation, accumulated cycle by cycle.

    What counts is steady motion: not the ramp at the start, not the fade of the compensation, not the `SETTLE_S` after
    each of them, and not cycles in which or shortly before which a period was missed or feedback was late. Of a
    periodic motion only whole periods count, the last ones, as many without as with compensation, so that both are
    compared over the same parts of the path and equally long; if a run is too short for one, the steady motion that
    there is. Of a recording `friction_hil.analysis.baseline` computes the same figures by this class.

    ``start_s``: time that the axes take to reach full speed, s. ``motion_s``: period of the motion, s; infinity if it
    has none.
    """

    __slots__ = (
        "_begin",
        "_condition",
        "_count",
        "_cycle",
        "_first",
        "_given",
        "_left_out",
        "_length",
        "_parts",
        "_peak",
        "_period_begin",
        "_period_end",
        "_recovered",
        "_recovery",
        "_settle",
        "_square",
        "_sums",
        "_told_end",
        "news",
    )

    def __init__(self, period_s: float, start_s: float, motion_s: float) -> None:
        self._given = period_s, start_s, motion_s
        self._settle = SETTLE_S / period_s
        self._recovery = RECOVERY_S / period_s
        self._first = start_s / period_s + self._settle  # cycle of the motion from which on it is steady
        self._length = motion_s / period_s
        self._cycle = -1
        self._condition = Condition.FADING
        self._begin = self._period_begin = self._period_end = math.inf
        self._recovered = 0.0  # cycle from which on errors count again
        self._parts = [_Parts() for _ in Condition]
        # set when a time without compensation ends: of all whole periods without it, or of this time if there is none;
        # whoever tells it sets it to None
        self.news: ErrorFigures | None = None
        self._told_end = -math.inf  # cycle before which the cycles of the last news were
        # of the period that has not ended yet: plain numbers, because every cycle adds to them
        self._count = self._left_out = 0
        self._square = self._peak = 0.0
        self._sums = DelaySums()

    def compile(self) -> None:
        """Compile the kernel that `take` runs."""
        DelaySums().add(0.0, 0.0, 0.0)

    def anew(self) -> "FollowingErrors":
        """Return an accumulator for another motion of the same kind."""
        return FollowingErrors(*self._given)

    def take(
        self,
        condition: Condition,
        error: float,
        missed: int,
        is_usable: bool,
        velocity: float = 0.0,
        acceleration: float = 0.0,
    ) -> bool:
        """Take one cycle of the motion; return True if it counts as settled.

        ``error``: demanded minus measured position, rad or m. ``missed``: number of periods between the cycle before
        and this one. ``is_usable``: the feedback of this cycle is fresh. ``velocity``, ``acceleration``: demanded, SI,
        from which a delay of the demand follows; a velocity of 0 shows none.
        """
        self._cycle = cycle = self._cycle + 1 + missed
        if condition is not self._condition:
            self._enter(condition)
        if missed or not is_usable:
            wait = self._recovery + RECOVERY_OF_MISSED * missed if missed else 0.0
            self._recovered = max(self._recovered, cycle + (wait if is_usable else max(wait, RECOVERY_OF_LATE)))
        if cycle < self._begin:
            return False
        if cycle >= self._period_end:  # its last cycle was missed
            self._end_period()
        is_counted = is_usable and cycle >= self._recovered
        if is_counted:
            self._count += 1
            self._square += error * error
            if velocity:
                self._sums.add(error, velocity * self._given[0], acceleration)
            if error > self._peak:
                self._peak = error
            elif -error > self._peak:
                self._peak = -error
        else:
            self._left_out += 1
        if cycle + 1 >= self._period_end:
            self._end_period()
        return is_counted

    def _enter(self, condition: Condition) -> None:
        self._end_part(self._cycle)
        if self._condition is Condition.WITHOUT:
            self._note_without()
        self._condition = condition
        is_fading = condition is Condition.FADING
        self._begin = math.inf if is_fading else max(self._cycle + self._settle, self._first) - _ROUNDING
        self._period_begin, self._period_end = self._begin, self._begin + self._length

    def _note_without(self) -> None:
        """Make news of the figures without compensation; it takes as long after a thousand periods as after one."""
        parts = self._parts[Condition.WITHOUT]
        for each in [parts.whole] if parts.whole.count else parts.partial[-1:]:
            if each.count and each.end > self._told_end:
                self._told_end = each.end
                self.news = ErrorFigures(math.sqrt(each.square / each.count), each.peak, each.count * self._given[0])

    def _end_period(self) -> None:
        period, parts = self._take_sum(self._period_end), self._parts[self._condition]
        parts.whole.add(period)
        parts.last.append(period)
        while self._cycle + 1 >= self._period_end:
            self._period_begin = self._period_end
            self._period_end += self._length

    def _end_part(self, end: float) -> None:
        """Keep what has been counted since the last whole period, up to the cycle ``end``."""
        if self._count or self._left_out:
            self._parts[self._condition].partial.append(self._take_sum(end))
            self._period_begin = end

    def _take_sum(self, end: float) -> _Part:
        part = _Part(self._period_begin, end, self._count, self._left_out, self._square, self._peak, self._sums)
        self._sums = DelaySums()
        self._count = self._left_out = 0
        self._square = self._peak = 0.0
        return part

    def _counted(self, condition: Condition) -> Sequence[_Part]:
        """Return the parts that count, after the last cycle."""
        self._end_part(self._cycle + 1.0)
        found = self._parts[condition]
        if not found.whole.count:
            return found.partial
        kept = [len(self._parts[each].last) for each in (Condition.WITHOUT, Condition.WITH)]
        return list(found.last)[-min(kept) :] if all(kept) else [found.whole]

    def _total(self, condition: Condition) -> _Part:
        total = _Part(math.inf, -math.inf)
        for part in self._counted(condition):
            total.add(part)
        return total

    def delay(self, configured: float) -> float:
        """Return by how many periods the drive's demand is later than the ``configured`` ones; 0 if nothing shows it.

        After the last cycle. Where there is compensation, its errors show it: friction hides less there.
        """
        totals = [self._total(each) for each in (Condition.WITH, Condition.WITHOUT)]
        return next((each.sums.delay(configured) for each in totals if each.count), 0.0)

    def figures(self, condition: Condition, delay: float = 0.0) -> ConditionFigures | None:
        """Return the figures of a condition without a delay, periods, after the last cycle; None if no cycle counts."""
        total = self._total(condition)
        if not total.count:
            return None
        rms, peak = math.sqrt(total.square / total.count), total.peak
        if delay:
            rms, peak = total.sums.rms(delay), total.sums.peak(delay)
        is_whole = math.isinf(self._length) or self._parts[condition].whole.count > 0
        return ConditionFigures(rms, peak, total.count, total.left_out, is_whole)

    def intervals(self, condition: Condition) -> list[tuple[int, int]]:
        """Return the first cycle of what counts, from the begin of the motion, and the first one after it."""
        joined: list[tuple[int, int]] = []
        for part in self._counted(condition):
            begin, end = math.ceil(part.begin), math.ceil(part.end)
            if joined and begin == joined[-1][1]:
                joined[-1] = joined[-1][0], end
            else:
                joined.append((begin, end))
        return joined


class FeedbackGaps:
    """Cycles without usable feedback that were bridged by prediction, and why there was none.

    A gap counts when feedback is there again; one that ends the run, and what is missing after that, was not bridged.
    """

    __slots__ = ("_gap", "_last_missing", "bridged", "is_open", "reasons", "stale")

    def __init__(self) -> None:
        self._last_missing: deque[int] = deque(maxlen=_NAMED_WITHIN)  # cycles
        self.stale = 0  # cycles without usable feedback, bridged or not
        self.bridged = 0  # cycles
        self.reasons: dict[str, int] = {}  # number of these cycles by the reason that the driver gave
        self.is_open = False  # feedback is missing; no property: it is read in every cycle
        self._gap: list[str] = []  # reasons of the cycles since the last usable feedback

    def miss(self, cycle: int, reason: str) -> None:
        """Take a cycle without usable feedback."""
        self.is_open = True
        self._last_missing.append(cycle)
        if len(self._gap) < _LONGEST_GAP:
            self._gap.append(reason)

    def close(self, *, is_bridged: bool) -> None:
        """End the gap: feedback is there again, or the run is ending."""
        if is_bridged:
            self.bridged += len(self._gap)
            for reason in self._gap:
                known = reason if reason in self.reasons or len(self.reasons) < _MOST_REASONS else _OTHERS
                self.reasons[known] = self.reasons.get(known, 0) + 1
        self._gap.clear()
        self.is_open = False

    def before(self, cycle: int) -> str:
        """Return words on the feedback that was missing in the cycles before a fault; empty if it was a few times."""
        missing = sum(cycle - _NAMED_WITHIN <= each < cycle for each in self._last_missing)
        few = missing < _NAMED_SHARE * _NAMED_WITHIN
        return "" if few else f"; feedback was missing in {missing} of the {_NAMED_WITHIN} cycles before"
