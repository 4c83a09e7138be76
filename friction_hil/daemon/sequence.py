"""The course of a run: enabling, running, coming to rest, disabling. Pure: facts of a cycle -> next state."""

from dataclasses import dataclass

from friction_hil.daemon.safety import LoopState

SETTLE_S = 0.05  # of idle cycles first, in which everything is used once
ENABLE_TIMEOUT_S = 5.0
STANDSTILL_TIMEOUT_S = 2.0
QUICK_STOP_TIMEOUT_S = 5.0
DISABLE_TIMEOUT_S = 2.0
STANDSTILL_S = 0.05  # without motion; in a single cycle an axis seems to stand at each reversal


@dataclass(slots=True)
class Facts:
    """What is known of all axes together in a cycle."""

    is_stop_requested: bool = False
    has_fault: bool = False
    is_enabled: bool = False  # every drive is in Operation Enabled
    is_powered: bool = False  # some drive may give torque
    is_setpoint_standing: bool = False  # the set-point has come to rest for good
    is_standing: bool = False  # no axis moves in this cycle
    is_faded_out: bool = False  # no compensation is left


class Course:
    """Where a run stands, and since when.

    Parameters
    ----------
    is_listening : bool
        Stay idle: a dry run enables nothing.

    Attributes
    ----------
    state : LoopState
    since_s : float
        When this state began.
    fault : str
        What the course itself has waited for in vain, last, or empty; for which axes, the loop tells.
    """

    __slots__ = ("_is_listening", "_moved_s", "fault", "since_s", "state")

    def __init__(self, *, is_listening: bool) -> None:
        self._is_listening = is_listening
        self.state = LoopState.IDLE
        self.since_s = 0.0
        self.fault = ""
        self._moved_s = 0.0

    def advance(self, time_s: float, facts: Facts) -> bool:
        """Take one cycle's facts; whether the state changed."""
        if not facts.is_standing:
            self._moved_s = time_s
        has_stood = time_s - self._moved_s >= STANDSTILL_S
        after = self._next(time_s - self.since_s, facts, has_stood)
        if after is self.state:
            return False
        self.state, self.since_s = after, time_s
        return True

    def _next(self, elapsed_s: float, facts: Facts, has_stood: bool) -> LoopState:
        state = self.state
        if state is LoopState.IDLE:
            if facts.is_stop_requested or facts.has_fault:
                return LoopState.DONE
            return state if self._is_listening or elapsed_s < SETTLE_S else LoopState.ENABLING
        if state is LoopState.ENABLING:
            if facts.is_stop_requested or facts.has_fault:
                return LoopState.DISABLING
            if elapsed_s > ENABLE_TIMEOUT_S:
                self.fault = f"not enabled within {ENABLE_TIMEOUT_S:g} s"
                return LoopState.DISABLING
            return LoopState.RUNNING if facts.is_enabled else state
        if state in (LoopState.RUNNING, LoopState.STOPPING) and facts.has_fault:
            return LoopState.FAULT_STOPPING
        if state is LoopState.RUNNING:
            return LoopState.STOPPING if facts.is_stop_requested else state
        if state is LoopState.STOPPING:
            return self._stopping(elapsed_s, facts, has_stood)
        if state is LoopState.FAULT_STOPPING:
            if has_stood or not facts.is_powered:
                return LoopState.DISABLING
            if elapsed_s > QUICK_STOP_TIMEOUT_S:
                self.fault = f"no standstill within {QUICK_STOP_TIMEOUT_S:g} s of the quick stop; disabled all the same"
                return LoopState.DISABLING
            return state
        if state is LoopState.DISABLING:
            if not facts.is_powered:
                return LoopState.DONE
            if elapsed_s > DISABLE_TIMEOUT_S:
                self.fault = f"still powered {DISABLE_TIMEOUT_S:g} s after it was told to disable"
                return LoopState.DONE
        return state

    def _stopping(self, elapsed_s: float, facts: Facts, has_stood: bool) -> LoopState:
        if not (facts.is_setpoint_standing and facts.is_faded_out):
            # neither can take longer than its ramp, which starts with this state
            return self.state
        if has_stood:
            return LoopState.DISABLING
        if elapsed_s > STANDSTILL_TIMEOUT_S:
            # a set-point at rest and an axis in motion: somebody turns it, or it hunts
            return LoopState.DISABLING
        return self.state
