"""The run around the cycles: when it begins, which state it is in, and what a change of state brings about."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from friction_hil.daemon.axis import AxisLoop, AxisUpdate
from friction_hil.daemon.follower import FollowerStateMachine
from friction_hil.daemon.log import RunLog
from friction_hil.daemon.pacing import ExchangeTimes
from friction_hil.daemon.safety import LoopState, why_unusable
from friction_hil.daemon.sequence import ENABLE_TIMEOUT_S, Requests, RunInputs, RunStateMachine, timeout_faults
from friction_hil.daemon.stop import StopRequest
from friction_hil.drive import DriveState, Feedback
from friction_hil.drive.codes import FaultCode
from friction_hil.errors import DriveError, UsageError
from friction_hil.motion.trajectory import PathTime

_FIRST_FEEDBACK_S = 1.0


@dataclass(frozen=True, slots=True)
class LoopSettings:
    """Settings of the loop."""

    period_s: float
    duration_s: float = math.inf  # after which the motion comes to rest; infinity for none
    max_missed: int = 10  # periods in a row that are a fault
    enable_timeout_s: float = ENABLE_TIMEOUT_S  # within which all drives must be enabled
    dry_run: bool = False  # listen, compute, record; never command
    is_fault_reset_wanted: bool = False  # reset, before enabling, the fault that a drive is found in
    is_follower: bool = False  # another controller enables and moves the drives
    is_waiting: bool = False  # enable nothing before somebody starts the axes, and wait again after a stop or a fault


class RunControl:
    """Begin a run, take it from state to state, and end it."""

    def __init__(
        self,
        axes: Sequence[AxisLoop],
        path_time: PathTime,
        settings: LoopSettings,
        stop: StopRequest,
        log: RunLog,
    ) -> None:
        self._axes, self._path_time, self._settings, self._stop, self._log = axes, path_time, settings, stop, log
        machine = FollowerStateMachine if settings.is_follower else RunStateMachine
        self._machine = machine(is_listening=settings.dry_run, enable_timeout_s=settings.enable_timeout_s)
        self._idle_exchanges = ExchangeTimes(settings.period_s)
        self.requests = Requests(
            len(axes), is_follower=settings.is_follower, is_fault_reset_wanted=settings.is_fault_reset_wanted
        )
        self._has_begun = False
        self.setpoint_delay_s = max(axis.facts.setpoint_delay_s for axis in axes)
        self._running_since_s = 0.0 if settings.dry_run else math.nan
        self._is_paused = settings.is_waiting and not settings.dry_run

    @property
    def state(self) -> LoopState:
        """State of the run."""
        return self._machine.state

    @property
    def is_idle(self) -> bool:
        """True while the drives are still idle; a dry run, which never leaves that state, does not count."""
        return self._machine.state is LoopState.IDLE and not self._settings.dry_run

    def running_s(self, time_s: float) -> float:
        """Return the time since the motion began, or in a dry run since its start, s; NaN before."""
        return time_s - self._running_since_s

    def start(self, feedback: Sequence[Feedback]) -> str:
        """Let the axes be enabled; return why that is not possible, empty if it is."""
        if self._settings.dry_run:
            return "a dry run enables nothing"
        if not self._is_paused:
            return "it is started already"
        if self._machine.state is not LoopState.WAITING:
            return "it is still stopping: start it when it has stopped"
        if self._log.has_fault:
            return "it has a fault: remove the cause and reset it first"
        if broken := [axis.name for axis in self._axes if axis.is_broken or axis.is_arm_lost]:
            return f"{broken[0]}: its computation has failed: start the daemon again"
        if not self._settings.is_follower and (obstacle := self._obstacle(feedback)):
            return obstacle
        self._is_paused = False
        return ""

    def _obstacle(self, feedback: Sequence[Feedback]) -> str:
        """Return why an axis cannot be enabled now; empty if all can."""
        for index, (axis, heard) in enumerate(zip(self._axes, feedback, strict=True)):
            if not heard.is_fresh or not heard.is_reachable:
                return f"{axis.name}: the state of the drive is unknown: nothing was read back in this cycle"
            is_reset = heard.state is DriveState.FAULT and self.requests.may_reset(index)
            if heard.state in (DriveState.FAULT, DriveState.FAULT_REACTION_ACTIVE) and not is_reset:
                reason = heard.error or "it reports no error code"
                return f"{axis.name}: the drive is in fault: {reason}; remove the cause and reset it first"
            try:
                axis.motion.check(axis.supervisor.position)
            except UsageError as error:
                return str(error)
        return ""

    def pause(self) -> str:
        """Let the axes come to rest and be disabled, and wait; return why that is not possible, empty if it is."""
        if self._settings.dry_run:
            return "a dry run has enabled nothing"
        self._is_paused = self.requests.is_stop_asked = True
        return ""

    def reset(self, cycle: int) -> str:
        """Reset the fault of the run, and those of the drives; return why that is not possible, empty if it is."""
        if self._settings.dry_run or self._settings.is_follower:
            return "it commands no drive: their faults are not its own to reset"
        if self._machine.state is not LoopState.WAITING:
            return "it has not stopped: faults are reset once it waits without power"
        self._log.reset(cycle)
        self.requests.reset_faults(cycle * self._settings.period_s)
        return ""

    def begin(self, feedback: Sequence[Feedback], time_s: float) -> bool:
        """Return True once every axis has reported its position and its path has been checked from there.

        Raises `DriveError`: an axis has not reported a position in time; `UsageError`: the path of an axis leaves its
        limits.
        """
        if self._has_begun:
            return True
        for axis, heard in zip(self._axes, feedback, strict=True):
            if not axis.supervisor.has_position and not axis.supervisor.take(heard):
                if time_s > _FIRST_FEEDBACK_S:
                    text = f"{axis.name}: no usable feedback within {_FIRST_FEEDBACK_S:g} s of the start"
                    text += f": {reason}" if (reason := heard.message or why_unusable(heard)) else ""
                    raise DriveError(FaultCode.FIRST_FEEDBACK_MISSING.append_to(text))
                return False
        if not self._settings.dry_run and not self._settings.is_follower:
            for axis in self._axes:
                axis.motion.check(axis.supervisor.position)
        self._has_begun = True
        return True

    def advance(
        self, cycle: int, feedback: Sequence[Feedback], updates: Sequence[AxisUpdate], exchange_us: float
    ) -> None:
        """End a cycle: take the run to its next state, if that is due."""
        time_s, left = cycle * self._settings.period_s, self._machine.state
        if self.is_idle:
            self._idle_exchanges.add(exchange_us)
        if self.running_s(time_s) >= self._settings.duration_s:
            self._stop.is_requested = True
        if not self._machine.advance(time_s, self._inputs(time_s, feedback, updates)):
            return
        if (timeout := self._machine.take_timeout()) is not None:
            is_standing = [update.is_standing for update in updates]
            is_silent = [axis.supervisor.is_silent for axis in self._axes]
            names = [axis.name for axis in self._axes]
            for text in timeout_faults(timeout, left, names, feedback, is_standing, is_silent):
                self._log.fault(cycle, text)
        if left is LoopState.WAITING and self._machine.state is not LoopState.DONE:
            for axis in self._axes:
                axis.begin_again()
        self._enter(self._machine.state, cycle, time_s)

    def _inputs(self, time_s: float, feedback: Sequence[Feedback], updates: Sequence[AxisUpdate]) -> RunInputs:
        """Return what the next state depends on."""
        inputs = RunInputs(is_enabled=True, is_standing=True, is_faded_out=True)
        inputs.is_stop_requested = self._stop.is_requested
        inputs.has_fault = self._log.has_fault
        if inputs.has_fault and self._settings.is_waiting:
            inputs.is_kept_after_fault = self._is_paused = True
        inputs.is_pause_requested = self._is_paused
        inputs.is_setpoint_standing = self._path_time.is_standing(time_s - self._settings.period_s)
        # one loop: each generator would be several calls, in every cycle
        for axis, heard, update in zip(self._axes, feedback, updates, strict=True):
            state = heard.state
            if not heard.is_reachable:
                inputs.is_enabled = False
                inputs.is_lost_powered = inputs.is_lost_powered or state.is_powered
                inputs.is_lost_unknown = inputs.is_lost_unknown or state is DriveState.UNKNOWN
            else:
                if state is DriveState.OPERATION_ENABLED:
                    inputs.is_powered = True
                else:
                    inputs.is_enabled = False
                    inputs.is_powered = inputs.is_powered or state.is_powered
                inputs.is_standing = inputs.is_standing and update.is_standing
            inputs.is_faded_out = inputs.is_faded_out and update.is_faded_out
            inputs.is_first_motion_due = inputs.is_first_motion_due or axis.is_first_motion_due
        return inputs

    def _enter(self, state: LoopState, cycle: int, time_s: float) -> None:
        """Do what the new state asks for."""
        # set-points are sent ahead of time: those already sent stay valid
        later_s = time_s + self._settings.period_s + self.setpoint_delay_s
        if state is LoopState.ENABLING and (warning := self._idle_exchanges.warning()):
            self._log.warn(cycle, warning)
        elif state is LoopState.RUNNING:
            self._running_since_s = time_s
            for axis in self._axes:
                axis.enter_path()
            self._path_time.start(later_s)
        elif state is LoopState.STOPPING:
            self._path_time.stop(later_s)
        elif state is LoopState.WAITING:
            self._running_since_s = math.nan
        self._log.state(cycle, state)
