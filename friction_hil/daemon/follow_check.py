"""Does an axis follow its path, at its beginning: does it move at all, and towards its set-point? Pure.

Once the axis has followed a part of its path, the check ends for this run; later faults have their own limits.

- It does not move: the demand has covered a distance X, and 0.3 s later the position not a twentieth of it. X is half
  of the path, or 80 % of `limits.following_error`, whichever is smaller.
- It moves in the wrong direction (cst, where the daemon's own torque moves the axis): it leaves its set-point although
  the torque pushes towards it, and faster and faster. A load that sinks until the torque holds it does so too, but then
  the growing torque slows it down. With the wrong sign the torque accelerates the axis, v grows with the distance x,
  and v^2 is four times as large at 2 x; under a constant load twice as large, and less once torque slows it down. The
  distance counts from where the axis began to leave: one that a load holds beside its set-point may follow it later.
"""

import math

from friction_hil.daemon.safety import SafetyLimits
from friction_hil.daemon.start_numbers import Follow
from friction_hil.drive.codes import FaultCode


class FollowCheck:
    """Check of one axis.

    ``extent``: largest distance of the path from its beginning, SI. ``position_resolution``: smallest step of the
    position, SI. ``is_torque_ours``: True in mode CST.
    """

    __slots__ = (
        "_demand_high",
        "_demand_low",
        "_demanded",
        "_distance",
        "_extent",
        "_high",
        "_is_torque_ours",
        "_low",
        "_name",
        "_next",
        "_origin",
        "_patience",
        "_period_s",
        "_runaway",
        "_speed",
        "_start",
        "_start_demand",
        "_unheard",
        "_unit",
        "_waited",
        "is_confirmed",
    )

    def __init__(
        self,
        name: str,
        unit: str,
        limits: SafetyLimits,
        extent: float,
        period_s: float,
        position_resolution: float,
        *,
        is_torque_ours: bool,
    ) -> None:
        self._name, self._unit, self._extent, self._is_torque_ours = name, unit, extent, is_torque_ours
        self._distance = max(
            min(Follow.PATH_PART * extent, Follow.ERROR_PART * limits.following_error),
            Follow.LEAST_STEPS * position_resolution,
        )
        self._patience = max(Follow.PATIENCE_S / period_s, Follow.PATIENCE_CYCLES)
        self._runaway = max(
            min(Follow.RUNAWAY_S * limits.velocity, Follow.ERROR_PART * limits.following_error),
            Follow.LEAST_RUNAWAY_STEPS * position_resolution,
        )
        self._period_s = period_s
        self._waited = 0
        self._start = self._start_demand = math.nan
        self._low = self._high = self._demand_low = self._demand_high = 0.0  # since the start
        self._demanded = 0.0  # in the last cycle with feedback
        self._unheard = 0  # periods since then
        self._origin = 0.0  # where the axis began to leave its set-point
        self._next = self._runaway / 2.0**Follow.DOUBLINGS  # distance at which the speed is noted next
        self._speed = math.nan  # at half of that distance
        self.is_confirmed = False  # the axis has followed its path: nothing more is to be checked

    def take(
        self,
        position: float,
        velocity: float,
        demand: float,
        torque: float,
        missed: int = 0,
        *,
        is_usable: bool = True,
    ) -> str | None:
        """Take one cycle of the motion; return a fault as a message, or None.

        ``demand``: demanded position at the time of the feedback. ``torque``: that is sent, SI. ``missed``: periods
        since the cycle before that had none. ``is_usable``: False for a cycle without feedback.
        """
        self._unheard += 1 + missed
        if not is_usable:
            return None
        elapsed_s, self._unheard = self._unheard * self._period_s, 0
        if math.isnan(self._start):
            self._start, self._start_demand = position, demand
        moved, demanded = position - self._start, demand - self._start_demand
        self._low, self._high = min(self._low, moved), max(self._high, moved)
        self._demand_low, self._demand_high = min(self._demand_low, demanded), max(self._demand_high, demanded)
        error = demanded - moved
        demand_rate, self._demanded = (demanded - self._demanded) / elapsed_s, demanded
        if abs(moved) >= max(Follow.FOLLOWED * self._extent, Follow.FOLLOWED_DISTANCE * self._distance) and abs(
            error
        ) < Follow.FOLLOWED_ERROR * abs(moved):
            self.is_confirmed = moved * demanded > 0.0
            return None
        if self._is_torque_ours and (
            fault := self._find_runaway(moved, velocity, velocity - demand_rate, error, torque)
        ):
            return fault
        demand_range, moved_range = self._demand_high - self._demand_low, self._high - self._low
        self._waited = self._waited + 1 if demand_range >= self._distance else 0
        if self._waited >= self._patience and moved_range < Follow.MOVED * demand_range:
            text = (
                f"{self._name}: the axis does not move although its set-point has moved by {demand_range:.3g} "
                f"{self._unit}: brake, blocked axis, torque limit, or wrong unit of the position"
            )
            return FaultCode.AXIS_DOES_NOT_MOVE.append_to(text)
        return None

    def _find_runaway(self, moved: float, velocity: float, leaving: float, error: float, torque: float) -> str | None:
        """Return a fault if the axis accelerates against the torque that should bring it back.

        ``leaving`` is its velocity relative to the set-point.
        """
        is_outside = moved * error < 0.0 and torque * error > 0.0
        if not (is_outside and velocity * error < 0.0 and leaving * error < 0.0):
            if abs(moved) >= self._runaway / 2.0**Follow.DOUBLINGS:
                self._next = math.inf  # a load may oscillate until the torque holds it; only a first departure counts
            self._origin = moved
            return None
        if abs(moved - self._origin) < self._next:
            return None
        before, self._speed = self._speed, abs(velocity)
        distance, self._next = self._next, 2.0 * self._next
        if distance <= self._runaway and self._speed**2 >= Follow.GROWTH * before**2:
            text = (
                f"{self._name}: the axis moves in the wrong direction: {moved:.3g} {self._unit} away from its "
                f"set-point, faster and faster, against a torque of {torque:.3g}: sign of the encoder or of the motor "
                "in the drive"
            )
            return FaultCode.WRONG_DIRECTION.append_to(text)
        return None
