"""Demanded motion of an axis that another controller moves, from the set-points heard on the bus. Pure."""

import math

import numpy as np

from friction_hil.numerics.jit import Array

SPAN = 5  # set-points in the fit
_LONGEST_GAP = 3  # cycles without a set-point, with the same one, or missed, that are bridged
_SMOOTHING = 0.2  # coefficient of the one-pole filter of the acceleration, which shows the rounding most
_NO_DEMAND = (math.nan, math.nan, math.nan, math.nan)


class DemandEstimator:
    """Demand now, and its velocity and acceleration ahead, by a parabola through the last set-points (least squares).

    The parabola filters the rounding of the set-points to whole counts: at the newest of them its slope has 0.8 times
    the variance of their simple difference. A constant acceleration leaves no error. Where a set-point was lost, came
    a cycle late or is rounded to the same count, the gap is filled in on the straight line to the next one; until that
    comes, the motion is taken to go on with the acceleration that it had.

    ``period_s``: time between set-points, s. ``delay_s``: time until the drive's demand equals the newest set-point, s.
    ``lead_s``: time until this cycle's torque acts, s.

    Examples
    --------
    >>> demand = DemandEstimator(1e-3, 1.5e-3, 1e-3)
    >>> for k in range(5):
    ...     heard = demand.take(k, 0.002 * k)
    >>> [round(value, 6) for value in heard]
    [0.005, 2.0, 2.0, 0.0]
    """

    __slots__ = (
        "_acceleration",
        "_ahead",
        "_bend",
        "_count",
        "_cycle",
        "_last",
        "_now",
        "_period_s",
        "_points",
        "_rate",
    )

    def __init__(self, period_s: float, delay_s: float, lead_s: float) -> None:
        grid = np.arange(1.0 - SPAN, 1.0)  # periods, the newest at 0
        fit = np.linalg.pinv(np.vander(grid, 3, increasing=True))  # coefficients from set-points
        now, ahead = -delay_s / period_s, (lead_s - delay_s) / period_s
        self._now: Array = np.array([1.0, now, now * now]) @ fit
        self._rate: Array = np.array([0.0, 1.0, 2.0 * now]) @ fit / period_s
        self._ahead: Array = np.array([0.0, 1.0, 2.0 * ahead]) @ fit / period_s
        self._bend: Array = 2.0 * fit[2] / (period_s * period_s)
        self._period_s = period_s
        self._acceleration = 0.0
        self._points = np.zeros(SPAN)
        self._count = 0
        self._cycle = 0  # of the newest set-point
        self._last = _NO_DEMAND  # that was computed from it

    def forget(self) -> None:
        """Begin anew: the motion that was heard is over."""
        self._count, self._last = 0, _NO_DEMAND

    def take(self, cycle: int, setpoint: float) -> tuple[float, float, float, float]:
        """Take one cycle's set-point, NaN if none was heard; return position and velocity now, velocity and
        acceleration ahead.

        They are NaN until there is one set-point for each point of the fit, and after a gap that is too long.
        """
        if math.isfinite(setpoint):
            self._last = self._fit(cycle, setpoint)
            return self._last
        if cycle - self._cycle > _LONGEST_GAP:
            self.forget()
        return self._continued((cycle - self._cycle) * self._period_s)

    def _continued(self, elapsed_s: float) -> tuple[float, float, float, float]:
        position, velocity, ahead, acceleration = self._last
        change = acceleration * elapsed_s
        return position + (velocity + 0.5 * change) * elapsed_s, velocity + change, ahead + change, acceleration

    def _fit(self, cycle: int, setpoint: float) -> tuple[float, float, float, float]:
        elapsed = max(cycle - self._cycle, 1)
        self._cycle = cycle
        if elapsed > _LONGEST_GAP:
            self._count = 0
        points, known = self._points, self._count
        for _ in range(elapsed if known else 1):
            points[:-1] = points[1:]
            points[-1] = setpoint
        if known:
            self._fill(setpoint, elapsed, known)
        self._count = min(known + elapsed, SPAN) if known else 1
        if self._count < SPAN:
            self._acceleration = 0.0
            return _NO_DEMAND
        # relative to the newest: a position of many turns must not cost digits of the velocity
        relative = points - setpoint
        self._acceleration += _SMOOTHING * (float(self._bend @ relative) - self._acceleration)
        return (
            setpoint + float(self._now @ relative),
            float(self._rate @ relative),
            float(self._ahead @ relative),
            self._acceleration,
        )

    def _fill(self, setpoint: float, elapsed: int, known: int) -> None:
        """Place the set-points of a gap on the straight line to this one."""
        points, gap = self._points, elapsed
        before = float(points[-1 - gap])
        while gap - elapsed + 1 < known and gap + 2 <= SPAN and points[-2 - gap] == before:
            gap += 1
        if setpoint != before and 1 < gap <= _LONGEST_GAP:
            for k in range(1, gap):
                points[-1 - k] = setpoint + (before - setpoint) * k / gap
