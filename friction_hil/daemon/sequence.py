"""State machine of a run (enabling, running, coming to rest, disabling), and what is asked of the drives in each state.

Pure: inputs of a cycle, next state and requests.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from friction_hil.daemon.safety import NOT_YET_ENABLED, STANDSTILL_S, LoopState
from friction_hil.drive import Command, DriveState, Feedback, Request
from friction_hil.drive.codes import FaultCode

SETTLE_S = 0.05  # idle cycles at the start, in which everything runs once
ENABLE_TIMEOUT_S = 5.0
STANDSTILL_TIMEOUT_S = 2.0
FADE_TIMEOUT_S = 10.0  # for the compensation to fade out: of a longer fade_s, what is left ends with the power
QUICK_STOP_TIMEOUT_S = 5.0
DISABLE_TIMEOUT_S = 2.0
LOST_POWERED_TIMEOUT_S = 5.0  # for the driver to stop a drive that commands do not reach, if that still tells its state
LOST_UNKNOWN_TIMEOUT_S = 1.0  # the same for a drive whose state is unknown: its own watchdog has acted by then
FAULT_RESET_S = 1.0  # for which the reset of a drive's fault is tried

REQUESTS = {
    LoopState.IDLE: Request.LISTEN,
    LoopState.ENABLING: Request.ENABLE,
    LoopState.FIRST_MOTION: Request.ENABLE,
    LoopState.RUNNING: Request.ENABLE,
    LoopState.STOPPING: Request.ENABLE,
    LoopState.FAULT_STOPPING: Request.QUICK_STOP,
    LoopState.DISABLING: Request.DISABLE,
    LoopState.DONE: Request.DISABLE,
    LoopState.WAITING: Request.DISABLE,
}
# in the very cycle in which a fault is found, before the state follows
REQUESTS_AFTER_FAULT = REQUESTS | {
    LoopState.ENABLING: Request.DISABLE,
    LoopState.FIRST_MOTION: Request.QUICK_STOP,
    LoopState.RUNNING: Request.QUICK_STOP,
    LoopState.STOPPING: Request.QUICK_STOP,
}

_WITHOUT_FAULT = (
    DriveState.SWITCH_ON_DISABLED,
    DriveState.READY_TO_SWITCH_ON,
    DriveState.SWITCHED_ON,
    DriveState.OPERATION_ENABLED,
    DriveState.QUICK_STOP_ACTIVE,
)


@dataclass(slots=True)
class RunInputs:
    """Inputs of the state machine in one cycle, of all axes together.

    A drive that commands do not reach any more is no part of ``is_powered`` and ``is_standing``: the others must not
    wait for it. The driver stops it in another way, as far as it can.
    """

    is_stop_requested: bool = False  # for good: the run ends
    is_pause_requested: bool = False  # the axes are to be stopped and disabled, and the run waits
    is_kept_after_fault: bool = False  # a fault does not end the run either: it waits
    has_fault: bool = False
    is_enabled: bool = False  # every drive is in Operation enabled
    is_powered: bool = False  # some drive in reach may give torque
    is_setpoint_standing: bool = False  # the set-point has come to rest for good
    is_standing: bool = False  # no axis in reach moves in this cycle
    is_faded_out: bool = False  # no compensation is left
    is_lost_powered: bool = False  # some drive out of reach has power
    is_lost_unknown: bool = False  # the state of some drive out of reach is unknown
    is_first_motion_due: bool = False  # some axis has yet to show that its velocity target means what it should


@dataclass(frozen=True, slots=True)
class Timeout:
    """A condition that did not come in time."""

    code: FaultCode
    text: str


class RunStateMachine:
    """State of a run, and when it began."""

    __slots__ = ("_changed_s", "_enable_timeout_s", "_is_listening", "_moved_s", "_timeout", "since_s", "state")

    def __init__(self, *, is_listening: bool, enable_timeout_s: float = ENABLE_TIMEOUT_S) -> None:
        self._is_listening = is_listening  # stay idle: a dry run enables nothing
        self._enable_timeout_s = enable_timeout_s  # within which all drives must be enabled
        self.state = LoopState.IDLE
        self.since_s = 0.0  # time at which this state began
        self._timeout: Timeout | None = None
        self._moved_s = 0.0
        self._changed_s = 0.0  # time in this state after which neither set-point nor compensation changes any more

    def advance(self, time_s: float, inputs: RunInputs) -> bool:
        """Take one cycle's inputs; return True if the state changed."""
        if not inputs.is_standing:
            self._moved_s = time_s
        has_stood = time_s - self._moved_s >= STANDSTILL_S
        after = self._next(time_s - self.since_s, inputs, has_stood)
        if after is self.state:
            return False
        self.state, self.since_s, self._changed_s = after, time_s, 0.0
        return True

    def take_timeout(self) -> Timeout | None:
        """Return the condition that the run has waited for in vain, once."""
        timeout, self._timeout = self._timeout, None
        return timeout

    def _next(self, elapsed_s: float, inputs: RunInputs, has_stood: bool) -> LoopState:
        state = self.state
        is_ending = inputs.is_stop_requested or inputs.has_fault or inputs.is_pause_requested
        if state is LoopState.IDLE:
            if inputs.is_stop_requested or inputs.has_fault:
                return after_the_stop(inputs)
            if self._is_listening or elapsed_s < SETTLE_S:
                return state
            return LoopState.WAITING if inputs.is_pause_requested else LoopState.ENABLING
        if state is LoopState.WAITING:
            if inputs.is_stop_requested:
                return LoopState.DONE
            is_kept = self._is_listening or inputs.is_pause_requested or inputs.has_fault
            return state if is_kept else LoopState.ENABLING
        if state is LoopState.ENABLING:
            return LoopState.DISABLING if is_ending else self._enabling(elapsed_s, inputs)
        if state is LoopState.FIRST_MOTION:
            if is_ending:  # no path has begun that could come to rest: the drives stop by themselves
                return LoopState.FAULT_STOPPING
            return state if inputs.is_first_motion_due else LoopState.RUNNING
        if state in (LoopState.RUNNING, LoopState.STOPPING) and inputs.has_fault:
            return LoopState.FAULT_STOPPING
        if state is LoopState.RUNNING:
            return LoopState.STOPPING if is_ending else state
        if state is LoopState.STOPPING:
            return self._stopping(elapsed_s, inputs, has_stood)
        if state is LoopState.FAULT_STOPPING:
            return self._fault_stopping(elapsed_s, inputs, has_stood)
        if state is LoopState.DISABLING:
            return self._disabling(elapsed_s, inputs)
        return state

    def _enabling(self, elapsed_s: float, inputs: RunInputs) -> LoopState:
        if elapsed_s > self._enable_timeout_s:
            self._timeout = Timeout(FaultCode.NOT_ENABLED, f"not enabled within {self._enable_timeout_s:g} s")
            return LoopState.DISABLING
        if not inputs.is_enabled:
            return self.state
        return LoopState.FIRST_MOTION if inputs.is_first_motion_due else LoopState.RUNNING

    def _stopping(self, elapsed_s: float, inputs: RunInputs, has_stood: bool) -> LoopState:
        if not (inputs.is_setpoint_standing and (inputs.is_faded_out or elapsed_s > FADE_TIMEOUT_S)):
            self._changed_s = elapsed_s
            return self.state  # both end with their ramps, which began with this state
        # after the timeout the axis may still move although the set-point rests: it hunts or is moved by hand
        is_over = elapsed_s - self._changed_s > STANDSTILL_TIMEOUT_S
        return LoopState.DISABLING if has_stood or is_over else self.state

    def _fault_stopping(self, elapsed_s: float, inputs: RunInputs, has_stood: bool) -> LoopState:
        if has_stood or not (inputs.is_powered or inputs.is_lost_powered or inputs.is_lost_unknown):
            return LoopState.DISABLING
        if elapsed_s > QUICK_STOP_TIMEOUT_S:
            text = f"no standstill within {QUICK_STOP_TIMEOUT_S:g} s of the quick stop; the request to disable follows"
            self._timeout = Timeout(FaultCode.NO_STANDSTILL, text)
            return LoopState.DISABLING
        return self.state

    def _disabling(self, elapsed_s: float, inputs: RunInputs) -> LoopState:
        is_waiting = (inputs.is_lost_powered and elapsed_s <= LOST_POWERED_TIMEOUT_S) or (
            inputs.is_lost_unknown and elapsed_s <= LOST_UNKNOWN_TIMEOUT_S
        )
        if not inputs.is_powered:
            return self.state if is_waiting else after_the_stop(inputs)
        if elapsed_s > DISABLE_TIMEOUT_S:
            text = f"still powered {DISABLE_TIMEOUT_S:g} s after the request to disable"
            self._timeout = Timeout(FaultCode.STILL_POWERED, text)
            return LoopState.DONE
        return self.state


def after_the_stop(inputs: RunInputs) -> LoopState:
    """Return the state that follows once no drive has power: the run waits for a start, or it ends."""
    is_kept = inputs.is_kept_after_fault or (inputs.is_pause_requested and not inputs.has_fault)
    return LoopState.WAITING if is_kept and not inputs.is_stop_requested else LoopState.DONE


def timeout_faults(
    timeout: Timeout,
    state: LoopState,
    names: Sequence[str],
    feedback: Sequence[Feedback],
    is_standing: Sequence[bool],
    is_silent: Sequence[bool],
) -> Iterator[str]:
    """Yield the message of a timeout for each axis that kept the run in ``state``.

    Of a drive that has been silent for too long nothing is known: its missing feedback is a fault already, and the
    state in which it is left is read back after the stop, or is unknown then.

    ``state``: that the run has just left. The sequences hold a value of each axis.
    """
    is_any = False
    for name, heard, stands, silent in zip(names, feedback, is_standing, is_silent, strict=True):
        if heard.is_reachable and _is_awaited(state, heard.state, stands):
            is_any = True
            if not silent:
                yield timeout.code.append_to(f"{name}: {timeout.text}: {_known(heard)}{heard.reason}")
    if not is_any:  # an axis that comes to rest now and then may stand in this very cycle
        yield timeout.code.append_to(timeout.text)


def _known(heard: Feedback) -> str:
    """Return what is known of a drive's state."""
    if heard.is_fresh:
        return f"the drive is in {heard.state.words}"
    return f"the state of the drive is unknown, the last one reported was {heard.state.words}"


def _is_awaited(state: LoopState, drive_state: DriveState, is_standing: bool) -> bool:
    """Return True if the run stays in ``state`` because of this axis."""
    if state is LoopState.ENABLING:
        return drive_state is not DriveState.OPERATION_ENABLED
    if state is LoopState.DISABLING:
        return drive_state.is_powered
    return not is_standing


class FaultReset:
    """Reset of the fault in which a drive is found at the start, on the user's request; no later fault is reset.

    ``is_wanted``: the user asked for it (``--reset-fault``).
    """

    __slots__ = ("_until_s", "is_open")

    def __init__(self, is_wanted: bool) -> None:
        self.is_open = is_wanted  # the permission is still given
        self._until_s = FAULT_RESET_S

    def take(self, feedback: Feedback) -> None:
        """Take one cycle's feedback: once the drive has no fault, the permission ends."""
        if feedback.is_fresh and feedback.state in _WITHOUT_FAULT:
            self.is_open = False

    def is_due(self, feedback: Feedback, state: LoopState, time_s: float) -> bool:
        """Return True if the drive's fault is to be reset in this cycle."""
        if state not in NOT_YET_ENABLED:  # `run --wait`: its time begins once somebody starts the axes
            self._until_s = math.nan
            return False
        if math.isnan(self._until_s):
            self._until_s = time_s + FAULT_RESET_S
        return self.is_open and feedback.state is DriveState.FAULT and time_s < self._until_s


class Requests:
    """What is asked of each drive in a cycle.

    ``drives``: their number. ``is_follower``: another controller enables and stops them. ``is_fault_reset_wanted``: the
    fault in which a drive is found at the start is to be reset.
    """

    __slots__ = ("_is_follower", "_reset_until_s", "_resets", "is_commanded", "is_stop_asked")

    def __init__(self, drives: int, *, is_follower: bool = False, is_fault_reset_wanted: bool = False) -> None:
        self._is_follower = is_follower
        self._resets = [FaultReset(is_fault_reset_wanted) for _ in range(drives)]
        self._reset_until_s = -math.inf
        self.is_commanded = False  # something but LISTEN was asked
        # somebody has asked to stop since the start: drives that are found with power are disabled too
        self.is_stop_asked = False

    def may_reset(self, index: int) -> bool:
        """Return True if the fault in which this drive is found is to be reset when it is enabled."""
        return self._resets[index].is_open

    def reset_faults(self, time_s: float) -> None:
        """Reset the faults that drives have while the run waits, from now on for `FAULT_RESET_S`."""
        self._reset_until_s = time_s + FAULT_RESET_S

    def covers(self, index: int, feedback: Feedback, state: LoopState, time_s: float, *, has_fault: bool) -> bool:
        """Take one cycle of a drive; return True if it is in the fault that is to be reset, which ends no run."""
        reset = self._resets[index]
        if has_fault or state is LoopState.ENABLING:
            reset.take(feedback)
        return reset.is_due(feedback, state, time_s)

    def fill(
        self,
        commands: Sequence[Command],
        feedback: Sequence[Feedback],
        is_covered: Sequence[bool],
        state: LoopState,
        time_s: float,
        *,
        has_fault: bool,
    ) -> None:
        """Write the request of a cycle into the command of each drive; ``is_covered``: `covers` of each."""
        request = (REQUESTS_AFTER_FAULT if has_fault else REQUESTS)[state]
        if self._is_follower or (state is LoopState.WAITING and not (self.is_commanded or self.is_stop_asked)):
            request = Request.LISTEN  # nothing was enabled so far, and nobody has asked to take the power of a drive
        is_resetting = state is LoopState.WAITING and time_s < self._reset_until_s
        for command, heard, is_due in zip(commands, feedback, is_covered, strict=True):
            is_reset = (state is LoopState.ENABLING and is_due) or (is_resetting and heard.state is DriveState.FAULT)
            command.request = Request.RESET_FAULT if is_reset else request
        self.is_commanded = self.is_commanded or request is not Request.LISTEN or is_resetting
