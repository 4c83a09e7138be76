"""State machine of a run: enabling, running, coming to rest, disabling. Pure: inputs of a cycle, next state."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from friction_hil.daemon.safety import LoopState
from friction_hil.drive import DriveState, Feedback
from friction_hil.drive.codes import FaultCode

SETTLE_S = 0.05  # idle cycles at the start, in which everything runs once
ENABLE_TIMEOUT_S = 5.0
STANDSTILL_TIMEOUT_S = 2.0
FADE_TIMEOUT_S = 10.0  # for the compensation to fade out: of a longer fade_s, what is left ends with the power
QUICK_STOP_TIMEOUT_S = 5.0
DISABLE_TIMEOUT_S = 2.0
LOST_POWERED_TIMEOUT_S = 5.0  # for the driver to stop a drive that commands do not reach, if that still tells its state
LOST_UNKNOWN_TIMEOUT_S = 1.0  # the same for a drive whose state is unknown: its own watchdog has acted by then
STANDSTILL_S = 0.05  # without motion; in a single cycle an axis seems to stand at each reversal


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
