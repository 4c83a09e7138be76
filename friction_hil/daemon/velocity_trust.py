"""Speed and torque of an axis whose drive has not shown yet that its velocity is that of its position. Pure.

The unit of a reported velocity may be wrong: where the daemon closes the velocity loop with it (cst), the axis would
have no damping, or far too much. Until a motion has shown that the integral of the reported velocity is the
displacement, `VelocityTrust.velocity` is derived from the position alone, and `FirstTorque` lets the torque rise only
until the position moves: an axis that sticks comes loose, and none is thrown by more than that takes.
"""

import math

from friction_hil.daemon.start_numbers import Trust
from friction_hil.drive.encoder import derived_velocity


class VelocityTrust:
    """Compares the velocity that a drive reports with its position until one motion has confirmed it.

    The resolutions are the smallest steps, SI; 0 for a velocity step that is not known.

    Examples
    --------
    >>> trust = VelocityTrust(1e-3, 1e-5)
    >>> for k in range(200):
    ...     trust.take(0.002 * k, 2.0 * 9.55, 1)
    >>> trust.is_confirmed, round(trust.velocity, 3), round(trust.contradiction, 2)
    (False, 2.0, 9.55)
    """

    __slots__ = (
        "_contradictions",
        "_high",
        "_integral",
        "_low",
        "_period_s",
        "_periods",
        "_position",
        "_reported",
        "_resolution",
        "_start",
        "_velocity_resolution",
        "contradiction",
        "is_confirmed",
        "velocity",
    )

    def __init__(self, period_s: float, position_resolution: float, velocity_resolution: float = 0.0) -> None:
        self._period_s, self._resolution, self._velocity_resolution = period_s, position_resolution, velocity_resolution
        self._position = self._start = math.nan
        # velocity: as the drive reports it once that is confirmed, before by the position, SI
        self._reported = self.velocity = 0.0
        self._contradictions = 0
        # contradiction: reported velocity over that of the position, once several comparisons in a row contradicted
        self.is_confirmed, self.contradiction = False, math.nan
        self._begin()

    def _begin(self) -> None:
        self._start, self._integral, self._periods = self._position, 0.0, 0
        self._low = self._high = self._reported

    def take(self, position: float, reported: float, periods: int) -> None:
        """Take the feedback of a cycle, and the periods since the one before that was usable."""
        if self.is_confirmed:
            self.velocity = reported
            return
        elapsed_s, way = periods * self._period_s, position - self._position
        before, self._reported, self._position = self._reported, reported, position
        if not math.isfinite(way):  # the first position
            self._begin()
            return
        self.velocity = derived_velocity(way, elapsed_s, self.velocity, self._period_s)
        self._integral += 0.5 * (before + reported) * elapsed_s
        self._periods += periods
        self._low, self._high = min(self._low, reported), max(self._high, reported)
        duration_s, moved = self._periods * self._period_s, position - self._start
        if (
            abs(moved) < Trust.LEAST_STEPS * self._resolution
            or self._periods < Trust.FEWEST_CYCLES
            or duration_s < Trust.WINDOW_S
        ):
            if duration_s > Trust.LONGEST_S:
                self._begin()
            return
        self._compare(moved, duration_s)
        self._begin()

    def _compare(self, moved: float, duration_s: float) -> None:
        larger = max(abs(moved), abs(self._integral))
        tolerance = Trust.TOLERANCE * larger + (Trust.LAG_S + 2.0 * self._period_s) * (self._high - self._low)
        tolerance += self._velocity_resolution * duration_s + Trust.ROUNDING_STEPS * self._resolution
        if abs(moved - self._integral) > tolerance:
            self._contradictions += 1
            if self._contradictions >= Trust.CONTRADICTIONS:
                self.contradiction = self._integral / moved
        elif tolerance < Trust.CLEAR * larger:
            self.is_confirmed, self.velocity = True, self._reported


class FirstTorque:
    """Bound of the torque that the daemon's own controller may ask for until the velocity is confirmed.

    It rises from zero while the axis does not follow the torque, and stays while it does. An axis that moves against
    the torque gets all of it: a load must not fall, and with the wrong sign `follow_check` finds it out.

    ``torque``, ``velocity``: limits, SI.

    Examples
    --------
    >>> first = FirstTorque(0.4, 10.0, 1e-3, 1e-5)
    >>> sticking = [first.next(0.0, 0.1, 1) for _ in range(40)]
    >>> moving = [first.next(5e-3 * k, 0.1, 1) for k in range(100)]
    >>> round(sticking[-1], 3), round(moving[-1], 3)
    (0.16, 0.168)
    """

    __slots__ = ("_against", "_bound", "_held_s", "_limit", "_mark", "_period_s", "_step")

    def __init__(self, torque: float, velocity: float, period_s: float, position_resolution: float) -> None:
        self._limit, self._period_s = torque, period_s
        self._step = max(
            Trust.MOVED_S * velocity, Trust.MOVED_STEPS * position_resolution
        )  # the spring of a friction is shorter
        self._against = max(Trust.AGAINST_S * velocity, Trust.MOVED_STEPS * position_resolution)
        self._bound = self._held_s = 0.0
        self._mark = math.nan

    def next(self, position: float, torque: float, periods: int) -> float:
        """Return the bound of a cycle, given its position and the torque before it, ``periods`` after the last one."""
        moved, elapsed_s = position - self._mark, periods * self._period_s
        self._held_s -= elapsed_s
        if moved * torque < 0.0 and abs(moved) > self._against:
            self._bound = self._limit
        if not abs(moved) < self._step:
            self._mark = position
            if moved * torque > 0.0:
                self._held_s = Trust.HELD_S
        if self._held_s <= 0.0:  # one period's step, whatever was missed: nobody looked at the axis meanwhile
            self._bound = min(self._bound + self._limit * self._period_s / Trust.RISE_S, self._limit)
        return self._bound
