"""The time of a loop of the user's own, counted in periods."""

import math
from collections.abc import Callable, Iterator
from typing import Any

from friction_hil.own_loop.faults import as_seconds

_WRONG_PERIOD = 0.1  # of the period, by which the mean of the measured ones may be off before it is told
_LEAST_PERIOD = 0.5  # of the period: calls that come faster are a fault
_MOST_MISSED = 1000  # periods of a pause: from there on its length does not matter


class Pace:
    """Periods between the calls of a loop."""

    __slots__ = ("_clock", "_elapsed_s", "_last_ns", "_period_s", "calls", "invalid", "missed")

    def __init__(self, period_s: float, clock: Callable[[], int]) -> None:
        self._period_s, self._clock = period_s, clock
        self._last_ns, self._elapsed_s = 0, 0.0
        self.calls = 0  # without a missed period, since `judge`
        self.missed = 0  # periods without a call
        self.invalid = 0  # calls with a time that is none

    def passed(self, dt: Any) -> float:
        """Return the number of periods since the last call, one at least; ``dt``: their time, s, None to measure it."""
        now, last = self._clock(), self._last_ns
        self._last_ns = now
        if dt is None:
            if not last:
                return 1.0
            elapsed_s = (now - last) * 1e-9
        else:
            elapsed_s = as_seconds(dt)
            if not 0.0 < elapsed_s < math.inf:
                self.invalid, elapsed_s = self.invalid + 1, self._period_s
        ratio = elapsed_s / self._period_s + 0.5
        if ratio < 2.0:
            self.calls += 1
            self._elapsed_s += elapsed_s
            return 1.0
        passed = int(min(ratio, _MOST_MISSED + 1.0))
        self.missed += passed - 1
        return float(passed)

    def judge(self) -> tuple[str, bool]:
        """Return what is wrong with the mean time of the calls, empty for nothing, and if it is a fault; begin anew.

        Calls with a missed period before them are not counted.
        """
        mean_s, self.calls, self._elapsed_s = self._elapsed_s / self.calls, 0, 0.0
        ratio, text = mean_s / self._period_s, f"a call comes every {1e3 * mean_s:.3g} ms"
        text += f", and period_s is {1e3 * self._period_s:g} ms"
        if ratio < _LEAST_PERIOD:
            return f"{text}: the velocities would be too low by as much", True
        return (f"{text}: the velocities are wrong by as much" if abs(ratio - 1.0) > _WRONG_PERIOD else ""), False

    def remarks(self) -> Iterator[str]:
        """Yield what the user should know of the calls so far."""
        if self.missed:
            yield "the loop misses periods: `missed` counts them; the compensation goes on over them"
        if self.invalid:
            yield "dt is not above zero, or no number: a call without a time counts as a period"
