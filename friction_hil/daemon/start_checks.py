"""What watches the beginning of a motion of one axis: first motion, first torque, and whether the path is followed."""

import math
from typing import TYPE_CHECKING

from friction_hil.daemon.first_motion import FirstMotion
from friction_hil.daemon.follow_check import FollowCheck
from friction_hil.daemon.motion import AxisMotion
from friction_hil.daemon.safety import SafetyLimits
from friction_hil.daemon.velocity_trust import FirstTorque
from friction_hil.drive import AxisFacts

if TYPE_CHECKING:
    from friction_hil.config import AxisConfig


class StartChecks:
    """Checks of one axis; those that its mode and motion do not need are left out.

    Raises `UsageError`: the position is too coarse for the first motion within the position limits.
    """

    __slots__ = ("_distance", "_first_motion", "_first_torque", "_follow_check", "_given", "_has_setpoint")

    def __init__(
        self,
        name: str,
        unit: str,
        config: "AxisConfig",
        limits: SafetyLimits,
        facts: AxisFacts,
        period_s: float,
        motion: AxisMotion,
    ) -> None:
        self._given = name, unit, config.mode, limits, facts, period_s
        self._has_setpoint, self._distance = motion.has_setpoint, motion.distance
        self._first_motion: FirstMotion | None = None
        self._first_torque: FirstTorque | None = None
        self._make_first()
        self._follow_check = self._make_follow_check()

    def _make_first(self) -> None:
        name, unit, mode, limits, facts, period_s = self._given
        resolution, step = facts.position_resolution, facts.velocity_resolution
        if mode == "cst":
            self._first_torque = FirstTorque(limits.torque, limits.velocity, period_s, resolution)
        if mode == "csv" and self._has_setpoint and step > 0.0:
            self._first_motion = FirstMotion(name, unit, limits, period_s, resolution, step)

    def _make_follow_check(self) -> FollowCheck | None:
        if not self._has_setpoint:
            return None
        name, unit, mode, limits, facts, period_s = self._given
        resolution, is_torque_ours = facts.position_resolution, mode == "cst"
        return FollowCheck(name, unit, limits, self._distance, period_s, resolution, is_torque_ours=is_torque_ours)

    def begin_again(self) -> None:
        """Watch another motion; what was confirmed stays so."""
        if self._first_torque is not None or self.is_first_motion_due:
            self._make_first()
        self._follow_check = self._make_follow_check()

    @property
    def is_first_motion_due(self) -> bool:
        """True if the unit of the velocity target is still to be confirmed by a first motion."""
        return self._first_motion is not None and not self._first_motion.is_done

    @property
    def has_first_torque(self) -> bool:
        """True while the torque of the loop's controller is bounded because the reported velocity is in doubt."""
        return self._first_torque is not None

    def first_torque(self, position: float, effort: float, missed: int, *, is_confirmed: bool) -> float:
        """Return the bound of that torque; infinity, for good, once the velocity ``is_confirmed``."""
        if is_confirmed or self._first_torque is None:
            self._first_torque = None
            return math.inf
        return self._first_torque.next(position, effort, missed + 1)

    @property
    def has_first_motion(self) -> bool:
        """True if the axis makes a first motion, or has made it."""
        return self._first_motion is not None

    def first_motion(
        self, position: float, velocity: float, missed: int, *, is_usable: bool
    ) -> tuple[str | None, float]:
        """Take one cycle of the first motion; return its fault, or None, and its velocity target."""
        motion = self._first_motion
        assert motion is not None
        for _ in range(missed):
            motion.take(math.nan, math.nan, is_usable=False)
        return motion.take(position, velocity, is_usable=is_usable), motion.target

    def take_warning(self) -> str | None:
        """Return the warning of the first motion, once."""
        motion = self._first_motion
        if motion is None or motion.warning is None:
            return None
        warning, motion.warning = motion.warning, None
        return warning

    def follow(
        self, position: float, velocity: float, demand: float, torque: float, missed: int, *, is_usable: bool
    ) -> str | None:
        """Take one cycle of the path; return a fault of an axis that does not follow it, or None."""
        check = self._follow_check
        if check is None:
            return None
        for _ in range(missed):
            check.take(math.nan, math.nan, math.nan, math.nan, is_usable=False)
        fault = check.take(position, velocity, demand, torque, is_usable=is_usable)
        if check.is_confirmed:
            self._follow_check = None
        return fault
