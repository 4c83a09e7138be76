"""Following error of one axis in a run, of its motor and of its load; compensation that makes it larger. Pure."""

import math

from friction_hil.compensator import CompensatorInputs
from friction_hil.daemon.control.state import error_without
from friction_hil.daemon.figures import Condition, FollowingErrors
from friction_hil.daemon.worsening import WorseningJudge
from friction_hil.drive.codes import FaultCode
from friction_hil.numerics.readable import quantity


class Following:
    """Following error of the motor.

    ``unit``: of the position, ``rad`` or ``m``. ``start_s``, ``motion_s``: those of `FollowingErrors`. ``resolution``:
    smallest step of the position, SI.
    """

    __slots__ = ("_judge", "_name", "_unit", "errors", "taken_back")

    def __init__(
        self, name: str, unit: str, period_s: float, start_s: float, motion_s: float, resolution: float
    ) -> None:
        self._name, self._unit = name, unit
        self.errors = FollowingErrors(period_s, start_s, motion_s)
        self._judge = WorseningJudge(period_s, motion_s, resolution)
        self.taken_back = ""  # why the compensation was taken back in this run; empty if it was not

    def begin_again(self) -> None:
        """Begin another motion of the same kind, with figures of its own."""
        self.errors, self._judge = self.errors.anew(), self._judge.anew()

    def restart(self) -> None:
        """Judge the compensation from now on: its settings have changed."""
        self._judge.restart()

    def take(self, condition: Condition, inputs: CompensatorInputs, error: float, missed: int, is_known: bool) -> str:
        """Take one cycle; return a warning if settled motion shows that compensation makes the error larger, else "".

        The arguments are those of `FollowingErrors.take`.
        """
        velocity, acceleration = inputs.velocity_demand, inputs.acceleration_demand_ahead
        if not self.errors.take(condition, error, missed, is_known, velocity, acceleration):
            return ""
        worse = self._judge.take(condition, velocity, acceleration, error)
        if worse is None:
            return ""
        self.taken_back = FaultCode.TAKEN_BACK.append_to(
            f"{self._name}: compensation makes the following error larger, {quantity(worse.without, self._unit)} -> "
            f"{quantity(worse.compensated, self._unit)} RMS at the same velocities: it is taken back, the run goes on "
            "without it; is the sign of the torque right (inverted_torque, 607Eh), and the model that of this axis?"
        )
        return self.taken_back

    def take_error_without(self) -> str | None:
        """Return, once, the text of the event that a time without compensation has ended; None in most cycles."""
        if (news := self.errors.news) is None:
            return None
        self.errors.news = None
        return error_without(self._name, self._unit, news.rms, news.peak, news.seconds)


class LoadFollowing:
    """Position by an encoder at the load, and its following error against the path."""

    __slots__ = ("_position", "_zero", "errors")

    def __init__(self, period_s: float, start_s: float, motion_s: float) -> None:
        self.errors = FollowingErrors(period_s, start_s, motion_s)
        self._zero = self._position = math.nan

    def position(self, load_position: float, motor_position: float) -> float:
        """Return the load's position, zero where the motor's is: at first, and again where the motion begins."""
        self._position = load_position
        if math.isnan(self._zero):
            self._zero = load_position - motor_position
        return load_position - self._zero

    def enter_path(self, motor_position: float) -> None:
        """Let the motion begin with the motor at this position."""
        self._zero = self._position - motor_position

    def take(self, condition: Condition, inputs: CompensatorInputs, missed: int) -> None:
        """Take one cycle of the motion, after `position`."""
        error = inputs.position_demand - (self._position - self._zero)
        is_known = inputs.is_fresh and math.isfinite(error)
        self.errors.take(condition, error, missed, is_known, inputs.velocity_demand, inputs.acceleration_demand_ahead)
