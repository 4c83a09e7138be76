"""Limits, plausibility of the feedback, and the states of a run. Pure.

Feedback that is not finite, not fresh or not plausible never becomes a command. A fault fades the compensation out,
stops the axes with the drives' quick stop and then disables them; holding torque stays until standstill, because a
vertical axis must not fall. Nothing here leaves a fault by itself.
"""

import math
from dataclasses import dataclass
from enum import IntEnum

from friction_hil.daemon.fast_steps import MOST_FAST_CYCLES, FastSteps
from friction_hil.daemon.velocity_check import VelocityCheck
from friction_hil.daemon.velocity_trust import VelocityTrust
from friction_hil.drive import DriveState, Feedback
from friction_hil.drive.codes import FaultCode

MAX_STALE_CYCLES = 10
STANDSTILL_S = 0.05  # without motion; in a single cycle an axis seems to stand at each reversal
SPEED_MARGIN = 1.5  # times the speed that a motion may reach: faster is a fault, overshoot is not
JUMP_MARGIN = 2.0  # times the velocity limit; a position that moves faster is a glitch
SLACK_STEPS = 10.0  # steps of the position that it may be off besides
_STANDSTILL_RATIO = 1e-3  # of the velocity limit
_HELD_S, _MOST_HELD = 0.5 * STANDSTILL_S, 10  # for so long, and cycles, one without usable feedback changes nothing
_NOISE_STEPS = 2.0  # steps of the encoder by which the displacement over a period may be wrong


class LoopState(IntEnum):
    """State of a run."""

    IDLE = 0  # listening only
    ENABLING = 1
    RUNNING = 2
    STOPPING = 3  # the set-point comes to rest, the compensation fades out
    FAULT_STOPPING = 4  # quick stop of the drives
    DISABLING = 5
    DONE = 6
    FIRST_MOTION = 7  # csv: between ENABLING and RUNNING, see `daemon.first_motion`
    WAITING = 8  # without power, until somebody starts the axes, see `daemon.control`


MOVING = (LoopState.RUNNING, LoopState.STOPPING)
LIMITED = (LoopState.FIRST_MOTION, *MOVING)
NOT_YET_ENABLED = (LoopState.IDLE, LoopState.ENABLING)
ENDING = (LoopState.FAULT_STOPPING, LoopState.DISABLING, LoopState.DONE, LoopState.WAITING)


@dataclass(frozen=True, slots=True)
class SafetyLimits:
    """Limits of one axis as the loop enforces them, SI; infinity where there is none."""

    torque: float
    velocity: float
    torque_slew: float = math.inf
    following_error: float = math.inf
    position_low: float = -math.inf
    position_high: float = math.inf


def why_unusable(feedback: Feedback) -> str:
    """Return why the feedback of a cycle cannot be used, whatever came before it; "" where it can, or nobody says."""
    if not feedback.is_fresh:
        return feedback.missing
    for name in ("position", "velocity", "torque"):
        if not math.isfinite(value := getattr(feedback, name)):
            return f"its {name} is {value}, not a number that can be used"
    return ""


class Supervisor:
    """Check the feedback of one axis.

    ``position_resolution``: smallest step of the position, SI. ``unit``: of the position, for messages: ``rad`` or
    ``m``. ``max_stale_cycles``: largest number of successive cycles without usable feedback that are bridged.
    ``velocity_resolution``: smallest step of the reported velocity, SI; 0 if it is not known. ``is_velocity_trusted``:
    if False, speed is judged from the position alone until a motion has confirmed the velocity that is reported.
    """

    __slots__ = (
        "_allowed",
        "_fast_cycles",
        "_fast_estimates",
        "_fastest",
        "_jump",
        "_last_position",
        "_limits",
        "_max_stale_cycles",
        "_missed",
        "_missed_since_position",
        "_missing",
        "_name",
        "_noise",
        "_slack",
        "_stale_cycles",
        "_steps",
        "_trust",
        "_unit",
        "_velocity_check",
        "is_in_doubt",
    )

    # of an axis that the daemon enables and moves, its state alone is enough to judge it
    is_operating = is_torque_taken = True

    def __init__(
        self,
        name: str,
        limits: SafetyLimits,
        period_s: float,
        position_resolution: float,
        unit: str = "rad",
        max_stale_cycles: int = MAX_STALE_CYCLES,
        velocity_resolution: float = 0.0,
        *,
        is_velocity_trusted: bool = True,
    ) -> None:
        self._name = name
        self._limits = limits
        self._unit = unit
        self._jump = JUMP_MARGIN * limits.velocity * period_s
        self._slack = SLACK_STEPS * position_resolution
        self._noise = max(_NOISE_STEPS * position_resolution / period_s, velocity_resolution)
        self._allowed = math.nan  # speed of the motion that the user was told of
        self._fastest = limits.velocity
        self._last_position = math.nan
        # periods without a cycle before this one, and the same since the last usable position
        self._stale_cycles = self._missed = self._missed_since_position = 0
        self._max_stale_cycles = max_stale_cycles
        self._velocity_check = VelocityCheck(period_s, limits.velocity, position_resolution, velocity_resolution)
        self._trust = None if is_velocity_trusted else VelocityTrust(period_s, position_resolution, velocity_resolution)
        self.is_in_doubt = not is_velocity_trusted  # nothing has been told of the velocity that is reported so far
        self._fast_cycles = 0  # in a row in which the drive reported more than the velocity limit
        self._fast_estimates = 0  # in a row beyond the limit: if the drive reports less, a frame may have been late
        self._steps = FastSteps(limits.velocity * period_s, position_resolution)
        self._missing = ""  # message about the feedback that is missing now

    def allow(self, speed: float) -> None:
        """Allow the axis no more than the speed of a motion that the user was told of, SI, with a margin for overshoot.

        The margin is `SPEED_MARGIN`, and the noise of a velocity from single steps of the encoder, or the step of the
        reported velocity if that is larger.
        """
        self._allowed = speed
        self._fastest = min(self._limits.velocity, SPEED_MARGIN * speed + self._noise)

    @property
    def position(self) -> float:
        """Last usable position; NaN before the first one."""
        return self._last_position

    @property
    def is_velocity_confirmed(self) -> bool:
        """True if the velocity that the drive reports counts; False as long as that of its position does."""
        return self._trust is None or self._trust.is_confirmed

    def velocity(self, feedback: Feedback) -> float:
        """Return the velocity of usable feedback: as reported, or by the position until a motion has confirmed that."""
        return feedback.velocity if self._trust is None else self._trust.velocity

    def take_doubt(self) -> str | None:
        """Return a warning, once, that the velocity which the drive reports is not that of its position."""
        if not self.is_in_doubt or self._trust is None or math.isnan(self._trust.contradiction):
            return None
        self.is_in_doubt = False
        return (
            f"{self._name}: the drive reports a velocity {self._trust.contradiction:.3g} times the derivative of its "
            "position: it is not used, speed follows from the position alone; compare the unit of its velocity with "
            "its manual"
        )

    @property
    def has_position(self) -> bool:
        """True once there was a usable position."""
        return math.isfinite(self._last_position)

    @property
    def is_current(self) -> bool:
        """True if the position is that of the last cycle."""
        return self._stale_cycles == 0

    @property
    def is_silent(self) -> bool:
        """True if feedback has been missing for longer than is bridged."""
        return self._stale_cycles > self._max_stale_cycles

    def take(self, feedback: Feedback, missed: int = 0) -> bool:
        """Take one cycle's feedback; return True if it is fresh, finite and plausible.

        ``missed`` is the number of periods since the cycle before that had none.

        A position that jumps further than twice the velocity limit allows is a glitch, for as many cycles as
        feedback may be missing.
        """
        self._missed = missed
        self._missed_since_position += missed
        usable = (
            feedback.is_fresh
            and math.isfinite(feedback.position)
            and math.isfinite(feedback.velocity)
            and math.isfinite(feedback.torque)
        )
        self._steps.take(feedback.position if usable else math.nan, missed + 1)
        if usable and math.isfinite(self._last_position):
            periods = self._stale_cycles + self._missed_since_position + 1
            reach = self._jump * periods + self._slack
            usable = abs(feedback.position - self._last_position) <= reach
        if usable:
            if self._trust is not None:
                periods = self._stale_cycles + self._missed_since_position + 1
                self._trust.take(feedback.position, feedback.velocity, periods)
            self._last_position = feedback.position
            self._stale_cycles = self._missed_since_position = 0
        else:
            self._stale_cycles += 1
        return usable

    def find_fault(self, feedback: Feedback, state: LoopState, velocity: float, position_demand: float) -> str | None:
        """Return the fault of the axis as a message, or None.

        ``feedback``: after `take`. ``state``: following and an enabled drive are required only while the axis moves.
        ``velocity``: estimated, SI. ``position_demand``: at the time of the feedback; NaN where there is none.
        """
        if feedback.message:
            return FaultCode.DRIVER_MESSAGE.append_to(f"{self._name}: {feedback.message}")
        is_lost = not feedback.is_reachable and state not in ENDING
        if is_lost or self._stale_cycles > self._max_stale_cycles:
            # one message for the whole gap, though the reason may change with each byte received
            self._missing = self._missing or self._missing_feedback(feedback)
            return self._missing
        self._missing = ""
        if feedback.state in (DriveState.FAULT, DriveState.FAULT_REACTION_ACTIVE):
            text = f"{self._name}: the drive is in fault: {feedback.error or 'it reports no error code'}"
            advice = "; --reset-fault leaves it" if state in NOT_YET_ENABLED else ""
            return FaultCode.DRIVE_IN_FAULT.append_to(text + advice)
        return self._find_motion_fault(feedback, velocity, position_demand) if state in LIMITED else None

    def _missing_feedback(self, feedback: Feedback) -> str:
        if self._stale_cycles <= self._max_stale_cycles:
            text = f"{self._name}: commands do not reach the drive any more"
        else:
            text = f"{self._name}: no usable feedback for more than {self._max_stale_cycles} cycles"
            if feedback.is_fresh and not why_unusable(feedback):
                return FaultCode.POSITION_JUMPS.append_to(
                    f"{text}: its position jumps further than limits.velocity allows, now to "
                    f"{feedback.position:.4g} {self._unit}"
                )
        reason = why_unusable(feedback)
        return FaultCode.FEEDBACK_MISSING.append_to(f"{text}: {reason}" if reason else text)

    def _find_motion_fault(self, feedback: Feedback, velocity: float, position_demand: float) -> str | None:
        """Return the fault of an axis that should be enabled and follow its demand within its limits."""
        name, limits, unit, position = self._name, self._limits, self._unit, self._last_position
        if feedback.state is not DriveState.OPERATION_ENABLED:
            return FaultCode.DRIVE_LEFT_OPERATION.append_to(
                f"{name}: the drive left Operation enabled: {feedback.state.words}{feedback.reason}"
            )
        if self._is_too_fast(feedback, velocity):
            return FaultCode.VELOCITY_LIMIT.append_to(
                f"{name}: velocity {velocity:.4g} is beyond its limit of {self._speed_limit()}"
            )
        if self._steps.is_too_fast:
            return FaultCode.VELOCITY_LIMIT.append_to(
                f"{name}: velocity {limits.velocity * self._steps.ratio:.4g} by its positions is beyond its limit of "
                f"{limits.velocity:g} {unit}/s"
            )
        if fault := self._find_velocity_fault(feedback):
            return fault
        if not limits.position_low <= position <= limits.position_high:
            return FaultCode.POSITION_LIMIT.append_to(
                f"{name}: position {position:.4g} {unit} is outside "
                f"[{limits.position_low:g}, {limits.position_high:g}] {unit}"
            )
        if math.isfinite(position_demand) and not abs(position_demand - position) <= limits.following_error:
            return FaultCode.FOLLOWING_ERROR.append_to(
                f"{name}: following error {position_demand - position:.4g} {unit} is beyond its limit of "
                f"{limits.following_error:g} {unit}"
            )
        return None

    def _is_too_fast(self, feedback: Feedback, velocity: float) -> bool:
        """Return True if the axis is beyond its velocity limit.

        At once if the drive reports that too; by the estimate from its position alone in the third cycle in a row.
        """
        if abs(velocity) <= self._fastest:
            self._fast_estimates = 0
            return False
        self._fast_estimates += 1
        is_confirmed = self._stale_cycles == 0 and abs(feedback.velocity) > self._fastest
        return (
            (is_confirmed and self.is_velocity_confirmed)
            or not math.isfinite(velocity)
            or self._fast_estimates >= MOST_FAST_CYCLES
        )

    def _speed_limit(self) -> str:
        """Return the limit of the velocity in words, with its reason if it is not the configured one."""
        text = f"{self._fastest:g} {self._unit}/s"
        if self._fastest == self._limits.velocity:
            return text
        text, allowed = f"{self._fastest:.3g} {self._unit}/s", f"{self._allowed:.3g} {self._unit}/s"
        return f"{text}, {SPEED_MARGIN:g} times the {allowed} that it may reach in this motion"

    def _find_velocity_fault(self, feedback: Feedback) -> str | None:
        """Return the fault of the velocity that the drive reports: too high, or not that of its position."""
        is_usable, velocity, unit = self._stale_cycles == 0, feedback.velocity, self._unit
        if is_usable:
            is_fast = self.is_velocity_confirmed and abs(velocity) > self._fastest
            self._fast_cycles = self._fast_cycles + 1 if is_fast else 0
            if self._fast_cycles >= MOST_FAST_CYCLES:
                return FaultCode.VELOCITY_LIMIT.append_to(
                    f"{self._name}: the drive reports a velocity of {velocity:.4g} {unit}/s, beyond the limit of "
                    f"{self._speed_limit()}"
                )
        for _ in range(self._missed):
            self._velocity_check.take(math.nan, math.nan)
        window = self._velocity_check.take(feedback.position, velocity, is_usable=is_usable)
        if window is None or not self._velocity_check.is_lasting:
            return None
        moved, reported = window.displacement / window.duration_s, window.integral / window.duration_s
        return FaultCode.VELOCITY_CONTRADICTS.append_to(
            f"{self._name}: the drive reports a velocity of {reported:.4g} {unit}/s, but its position changes by "
            f"{moved:.4g} {unit}/s"
        )


class Standstill:
    """Standstill of one axis; a lost cycle now and then says nothing, and changes nothing."""

    __slots__ = ("_held", "_is_slow", "_most_held", "_slowest")

    def __init__(self, velocity_limit: float, position_resolution: float, period_s: float) -> None:
        # speed below which an axis counts as standing, SI
        self._slowest = max(_STANDSTILL_RATIO * velocity_limit, 2.0 * position_resolution / period_s)
        self._most_held = min(_MOST_HELD, max(1, int(_HELD_S / period_s)))
        self._is_slow, self._held = False, 0  # in the last cycle with usable feedback, and cycles since then

    def take(self, velocity: float, *, is_usable: bool) -> bool:
        """Take the velocity of a cycle, SI; return True if the axis stands. One that is not finite proves nothing."""
        if is_usable:
            self._is_slow, self._held = abs(velocity) <= self._slowest, 0
        else:
            self._held += 1
        return self._is_slow and self._held <= self._most_held
