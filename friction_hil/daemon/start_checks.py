"""What watches the beginning of a motion of one axis: first motion, first torque, and whether the path is followed."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

from friction_hil.daemon.first_motion import FirstMotion
from friction_hil.daemon.follow_check import FollowCheck
from friction_hil.daemon.motion import AxisMotion
from friction_hil.daemon.safety import SafetyLimits
from friction_hil.daemon.velocity_trust import FirstTorque
from friction_hil.drive import AxisFacts

if TYPE_CHECKING:
    from friction_hil.config import AxisConfig


@dataclass(slots=True)
class StartChecks:
    """Checks of one axis; None for what its mode and motion do not need, and for what has been confirmed."""

    first_motion: FirstMotion | None = None
    first_torque: FirstTorque | None = None
    follow_check: FollowCheck | None = None

    @property
    def is_first_motion_due(self) -> bool:
        """True if the unit of the velocity target is still to be confirmed by a first motion."""
        return self.first_motion is not None and not self.first_motion.is_done

    def begin_again(self, new: "StartChecks") -> None:
        """Watch another motion by ``new`` checks; what was confirmed of the drive stays so."""
        if self.is_first_motion_due:
            self.first_motion = new.first_motion
        if self.first_torque is not None:
            self.first_torque = new.first_torque
        self.follow_check = new.follow_check


def start_checks(
    name: str,
    unit: str,
    config: "AxisConfig",
    limits: SafetyLimits,
    facts: AxisFacts,
    period_s: float,
    motion: AxisMotion,
) -> StartChecks:
    """Return the checks of an axis that the daemon moves.

    Raises `UsageError`: the position is too coarse for the first motion within the position limits.
    """
    checks, resolution, step = StartChecks(), facts.position_resolution, facts.velocity_resolution
    is_torque_ours = config.mode == "cst"
    if is_torque_ours:
        checks.first_torque = FirstTorque(limits.torque, limits.velocity, period_s, resolution)
    if config.mode == "csv" and motion.has_setpoint and step > 0.0:
        checks.first_motion = FirstMotion(name, unit, limits, period_s, resolution, step)
    if motion.has_setpoint:
        checks.follow_check = FollowCheck(
            name, unit, limits, motion.distance, period_s, resolution, is_torque_ours=is_torque_ours
        )
    return checks
