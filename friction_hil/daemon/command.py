"""The command of one axis in a cycle: set-point and torque, by mode and state. The last limit before the drive."""

import math
from typing import TYPE_CHECKING

from friction_hil.compensator.limiter import limit_torque
from friction_hil.compensator.velocity_offset import VelocityOffset
from friction_hil.daemon.assembly import make_controller, make_setpoint_shift
from friction_hil.daemon.motion import AxisMotion
from friction_hil.daemon.safety import MOVING, LoopState, SafetyLimits
from friction_hil.daemon.static_torque import Fade, StaticTorque, static_torque
from friction_hil.drive import Command, DriveState, Feedback, Mode
from friction_hil.motion.controller import cascade
from friction_hil.motion.trajectory import Setpoint

if TYPE_CHECKING:
    from friction_hil.config import AxisConfig


class LimitedOutput:
    """A value that the drive adds to its demand, within its own limit and slew, in its own unit.

    A value whose command the driver reports as lost (`Feedback.is_setpoint_lost`) may or may not be in the drive. The
    next one stays within a step of it and of all that the drive may have instead, so that neither the drive nor the
    wire sees more than one step.
    """

    __slots__ = ("_highest", "_largest_step", "_limit", "_lowest", "_value")

    def __init__(self, limit: float, largest_step: float) -> None:
        self._limit, self._largest_step = limit, largest_step
        self.clear()

    def clear(self) -> None:
        """Begin at zero, without a slew."""
        self._value = self._lowest = self._highest = 0.0  # the last one, and the bounds of what the drive may have

    def begin(self, *, is_lost: bool) -> None:
        """Begin a cycle; ``is_lost``: the command of the cycle before."""
        if is_lost:
            self._lowest, self._highest = min(self._lowest, self._value), max(self._highest, self._value)
        else:
            self._lowest = self._highest = self._value

    def next(self, wanted: float) -> float:
        """Return the value within limit and slew, and keep it as the last one."""
        value = limit_torque(wanted, self._lowest, self._limit, self._largest_step)
        if self._highest != self._lowest:  # apart by a step at most: one value at least is within a step of both
            value = limit_torque(value, self._highest, self._limit, self._largest_step)
        self._value = value
        return value


_ENABLED = (LoopState.ENABLING, LoopState.FIRST_MOTION)
_STOPPED = (LoopState.FAULT_STOPPING, LoopState.DISABLING)


class CommandWriter:
    """Fills the command of one axis.

    The compensator limits its own torque, which replay repeats from a recording. Here the sum is limited that the
    drive receives, with the torque of the loop's own controller (CST) and the feed-forward of gravity and offset: from
    zero at each enabling, and in steps of one period even after missed ones. Both call
    `friction_hil.compensator.limiter.limit_torque`.
    """

    __slots__ = (
        "_controller",
        "_error_left",
        "_fade",
        "_integral",
        "_is_held_by_loop",
        "_keeps_setpoint",
        "_lead_s",
        "_limits",
        "_mode",
        "_motion",
        "_period_s",
        "_shift",
        "_static",
        "_torque",
        "_velocity_offset",
        "arm_load",
        "arm_torque",
        "effort",
        "held_position",
        "most",
        "offset_sent",
        "static",
    )

    def __init__(
        self,
        config: "AxisConfig",
        limits: SafetyLimits,
        motion: AxisMotion,
        period_s: float,
        lead_s: float,
        velocity_offset: VelocityOffset | None = None,  # by which the compensation goes out
        *,
        is_of_arm: bool = False,  # whose inertia takes the place of the model's in the loop's own controller
    ) -> None:
        self._mode = Mode[config.mode.upper()]
        self._limits = limits
        self._motion = motion
        self._period_s = period_s
        self._lead_s = lead_s  # from sampling the position until the torque acts
        self._static = static_torque(config, is_of_arm=is_of_arm)
        self.arm_torque = self.arm_load = 0.0  # what the arm needs in this cycle, N m; see `StaticTorque.at`
        self.static = 0.0  # feed-forward of gravity, offset and arm in the last cycle, N m
        self._fade = Fade(period_s)  # from the feed-forward before the last change
        self._controller, self._integral = make_controller(config, is_of_arm=is_of_arm), 0.0
        self._is_held_by_loop = False  # the loop's own controller (cst) has carried the axis up to now
        self._keeps_setpoint = False  # the drive (csp) is at the last set-point of a motion, until it has no power
        self._error_left = 0.0  # following error with which it came to rest
        self._torque = LimitedOutput(limits.torque, limits.torque_slew * period_s)
        self._velocity_offset: LimitedOutput | None = None
        self._shift = make_setpoint_shift(config, period_s)
        if velocity_offset is not None:
            self._velocity_offset = LimitedOutput(velocity_offset.limit, velocity_offset.slew * period_s)
        self.offset_sent = (0.0, 0.0)  # position and velocity that are added to the set-point that is sent, SI
        # at which the axis is held outside of the moving states, SI; NaN before the first cycle
        self.held_position = math.nan
        # N m (CST): bound of what the loop's controller and the compensation ask for together, and what they asked for
        self.most, self.effort = math.inf, 0.0

    def compile(self) -> None:
        """Compile the kernels that `write` runs."""
        self._control(Setpoint(0.0, 0.0, 0.0), 0.0, 0.0)
        self._integral = 0.0
        self._torque.next(0.0)
        if self._shift is not None:
            self._shift.compile()

    def adopt(self, static: StaticTorque, fade_s: float, lead_s: float) -> None:
        """Go on with another feed-forward of gravity and offset; what it differs by vanishes over ``fade_s``."""
        self._static, self._lead_s = static, lead_s
        self._fade.begin(fade_s)

    def write(
        self,
        command: Command,
        state: LoopState,
        time_s: float,
        position: float,
        velocity: float,
        now: Setpoint | None,
        compensation: float,
        feedback: Feedback,
    ) -> None:
        """Write set-point and torque; outside of the moving states the axis is held where it is.

        There it gets no torque but the feed-forward of gravity and offset, from the request to enable on until the
        drive reports that it has no power: an axis that is enabled without it sags before its loops hold it, and one
        whose brake closes some time after the request to disable sags until then. In cst the loop's controller goes on
        as well, as long as the drive takes its torque: the feed-forward alone is only as good as the model.

        ``position``, ``velocity``: the last usable position and the estimated velocity, SI. ``now``: set-point at the
        time of the feedback. ``compensation``: torque of the compensator, N m. ``feedback``: state of the drive, and
        whether the command before was lost.
        """
        command.velocity = 0.0
        self._torque.begin(is_lost=feedback.is_setpoint_lost)
        static = self.static = self._static_torque(position, velocity, now)
        if state not in MOVING:
            self._hold(command, state, position, velocity, compensation, static, feedback.state)
        elif self._mode is Mode.CST:
            if now is not None:
                self._is_held_by_loop, self._error_left, self.held_position = True, now.position - position, position
            command.torque = self._torque.next(
                self._bounded(self._control(now, position, velocity) + compensation) + static
            )
        else:
            command.torque = self._torque.next(compensation + static)
            if now is not None:
                self._write_setpoint(command, time_s, position, now)
                if self._mode is Mode.CSP:
                    self._keeps_setpoint, self.held_position = True, command.position

    def _hold(
        self,
        command: Command,
        state: LoopState,
        position: float,
        velocity: float,
        compensation: float,
        static: float,
        drive_state: DriveState,
    ) -> None:
        """Write the command of an axis that is not to move; the arguments are those of `write`."""
        is_enabled = drive_state is DriveState.OPERATION_ENABLED
        is_waiting = state is LoopState.FIRST_MOTION and self._mode is not Mode.CSV
        if is_waiting:  # in another axis's first motion, one with torque alone is held by the loop
            self._is_held_by_loop = self._mode is Mode.CST and self._motion.has_setpoint
        elif state is not LoopState.DISABLING or not is_enabled:
            self._is_held_by_loop = False
        else:  # where it stood last: no motion towards the set-point any more, and no step of torque
            self._integral += self._controller[0]["position_gain"] * self._error_left
            self._error_left = 0.0
        # While it waits for the others, an enabled axis is held at one position: following itself, it would sink. After
        # a motion it keeps its set-point: the drive's feed-forward of a set-point that follows it would drive it away.
        self._keeps_setpoint = self._keeps_setpoint and state is LoopState.DISABLING and is_enabled
        is_kept = is_waiting or (is_enabled and state is LoopState.ENABLING and self._mode is Mode.CSP)
        is_kept = is_kept or self._keeps_setpoint
        if not (is_kept or self._is_held_by_loop):
            self.held_position = position
        command.position = self.held_position
        if self._is_held_by_loop:
            held = Setpoint(self.held_position, 0.0, 0.0)
            command.torque = self._torque.next(self._bounded(self._control(held, position, velocity)) + static)
            return
        self._integral = 0.0
        if state in _STOPPED:
            # without power no torque flows: it ends within the slew, as a single wrong statusword must make no step
            left = compensation if state is LoopState.FAULT_STOPPING else 0.0
            command.torque = self._torque.next(static + left if _has_power(drive_state) else 0.0)
        elif state in _ENABLED:
            command.torque = self._torque.next(static)
        else:
            self._torque.clear()
            command.torque = 0.0

    def write_velocity_offset(self, command: Command, state: LoopState, wanted: float, feedback: Feedback) -> None:
        """Write the velocity offset of the compensator, rad/s; where the axis is not to move it goes to zero."""
        output = self._velocity_offset
        assert output is not None
        output.begin(is_lost=feedback.is_setpoint_lost)
        is_acting = state in MOVING or (state is LoopState.FAULT_STOPPING and _has_power(feedback.state))
        offset = output.next(wanted if is_acting else 0.0)
        if self._shift is None:
            command.velocity_offset = offset
        elif state in MOVING:
            path = command.position  # which is within the limits, by a margin
            low, high = min(self._limits.position_low, path), max(self._limits.position_high, path)
            command.position = self.held_position = min(max(path + self._shift.next(offset), low), high)
        else:  # held where it is, or stopped by the drive itself
            self._shift.clear()

    def _static_torque(self, position: float, velocity: float, now: Setpoint | None) -> float:
        """Return the feed-forward of gravity, offset and arm, N m: on the demanded path, without one at the axis."""
        if now is not None:
            position, velocity = now.position, now.velocity
        return self._fade.next(self._static.at(position + self._lead_s * velocity, self.arm_torque, self.arm_load))

    def _bounded(self, wanted: float) -> float:
        """Return the torque within `most`, and keep it as `effort`."""
        self.effort = min(max(wanted, -self.most), self.most)
        return self.effort

    def _write_setpoint(self, command: Command, time_s: float, position: float, now: Setpoint) -> None:
        """Write position and velocity; in CSV the velocity includes the loop's own position control."""
        sent = self._motion.to_send(time_s)
        offset, rate = self.offset_sent
        command.position = sent.position + offset
        command.velocity = sent.velocity + rate
        if self._mode is Mode.CSV:
            wanted = command.velocity + self._controller[0]["position_gain"] * (now.position - position)
            # half of what the path leaves of the limit: a drive that is asked for the limit itself overshoots it
            most = 0.5 * (min(abs(sent.velocity), self._limits.velocity) + self._limits.velocity)
            command.velocity = min(max(wanted, -most), most)

    def _control(self, now: Setpoint | None, position: float, velocity: float) -> float:
        """Return the torque of the loop's own position and velocity control (CST), N m."""
        if now is None:
            return 0.0
        torque, self._integral = cascade(
            self._controller,
            self._integral,
            now.position - position,
            now.velocity,
            now.acceleration,
            velocity,
            self._period_s,  # after missed periods too: how the error went in them is not known
            min(self._limits.torque, self.most),
        )
        return torque


def _has_power(state: DriveState) -> bool:
    """Return True for a drive that may have power; one that does not report its state may."""
    return state.is_powered or state is DriveState.UNKNOWN
