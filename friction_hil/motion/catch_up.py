"""Time of a motion that was held up: behind by the periods that were missed, until it has caught up. Pure.

While the loop misses periods, a drive receives no set-points and keeps the last one. The motion therefore goes on from
there, later by the missed time, and then runs a little faster than time until nothing is left of that lag. The excess
of its rate over 1 rises and falls by the step 3 x^2 - 2 x^3: velocity and acceleration of the axes stay continuous.
"""

import math

_STEEPEST = 1.5  # slope of 3 x^2 - 2 x^3 at its middle
_LEAST_EXCESS = 1e-4  # of the rate: below it, a lag would take minutes to be caught up


def smooth_step(x: float) -> tuple[float, float, float]:
    """Return integral, value and derivative of 3 x^2 - 2 x^3 at ``x``, from 0 to 1."""
    return x**3 - 0.5 * x**4, x * x * (3.0 - 2.0 * x), 6.0 * x * (1.0 - x)


class _Bump:
    """Excess of the rate that catches up a lag: it rises, is held and falls.

    ``lag_s`` is to be caught up, above zero. ``excess``: largest one of the rate; ``change``: largest derivative of the
    rate, 1/s.
    """

    __slots__ = ("_excess", "_ramp_s", "begin_s", "end_s", "lag_s")

    def __init__(self, begin_s: float, lag_s: float, excess: float, change: float) -> None:
        # a rise to e takes 1.5 e / change; without a time at e, rise and fall gain e times that
        self._excess = min(excess, math.sqrt(lag_s * change / _STEEPEST))
        self._ramp_s = _STEEPEST * self._excess / change
        self.begin_s, self.lag_s = begin_s, lag_s
        self.end_s = begin_s + max(lag_s / self._excess, self._ramp_s) + self._ramp_s

    def at(self, time_s: float) -> tuple[float, float, float]:
        """Return the lag that is left at ``time_s``, the excess of the rate, and its derivative."""
        if time_s <= self.begin_s:
            return self.lag_s, 0.0, 0.0
        if time_s >= self.end_s:
            return 0.0, 0.0, 0.0
        excess, ramp_s, left_s = self._excess, self._ramp_s, self.end_s - time_s
        since_s = time_s - self.begin_s
        if since_s < ramp_s:
            gained, value, slope = smooth_step(since_s / ramp_s)
            return self.lag_s - excess * ramp_s * gained, excess * value, excess * slope / ramp_s
        if left_s < ramp_s:
            left, value, slope = smooth_step(left_s / ramp_s)
            return excess * ramp_s * left, excess * value, -excess * slope / ramp_s
        return excess * (left_s - 0.5 * ramp_s), excess, 0.0


class HeldTime:
    """Time that was held up and catches up.

    A hold during a catch-up leaves that one as it is; its own lag is caught up after it.

    ``excess``: largest excess of the rate over 1; below 1e-4 nothing is caught up, and the lag remains. ``change``:
    largest derivative of the rate, 1/s.

    >>> time = HeldTime(excess=0.1, change=1.0)
    >>> time.hold(now_s=2.0, missed_s=0.005, later_s=2.0)
    >>> [round(time.lag_s(t), 5) for t in (2.0, 2.1, 3.0)]
    [0.005, 0.00174, 0.0]
    """

    __slots__ = ("_bumps", "_change", "_excess", "_remaining_s")

    def __init__(self, excess: float, change: float) -> None:
        self._excess, self._change = excess, change
        self._bumps: list[_Bump] = []  # one under way, one to come
        self._remaining_s = 0.0  # of the lag, which is not caught up

    def hold(self, now_s: float, missed_s: float, later_s: float) -> None:
        """Let the motion go on at ``now_s`` from where it was ``missed_s`` before, and catch up from ``later_s`` on.

        Set-points up to ``later_s`` were sent already: until then the rate is the one before.
        """
        for bump in self._bumps:  # they belong to the motion, which is later now
            bump.begin_s += missed_s
            bump.end_s += missed_s
        if self._excess < _LEAST_EXCESS:
            self._remaining_s += missed_s
            return
        begun = [bump for bump in self._bumps if bump.begin_s < later_s and bump.end_s > now_s]
        lag_s = missed_s + sum(bump.lag_s for bump in self._bumps if bump.begin_s >= later_s)
        begin_s = max([later_s, *(bump.end_s for bump in begun)])
        self._bumps = [*begun, _Bump(begin_s, lag_s, self._excess, self._change)]

    def at(self, time_s: float) -> tuple[float, float, float]:
        """Return the time of the motion at ``time_s``, its rate, and the derivative of the rate."""
        lag_s, rate, change = self._remaining_s, 1.0, 0.0
        for bump in self._bumps:
            lag, excess, slope = bump.at(time_s)
            lag_s, rate, change = lag_s + lag, rate + excess, change + slope
        return time_s - lag_s, rate, change

    def lag_s(self, time_s: float) -> float:
        """Return by how much the motion is behind at ``time_s``, s."""
        return self._remaining_s + sum(bump.at(time_s)[0] for bump in self._bumps)
