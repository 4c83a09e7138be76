"""Axes that another controller enables and moves: the loop only adds the compensation (``bus.role: sidecar``).

Nothing here stops the machine. The compensation of an axis is faded in while its drive is in Operation enabled in the
configured mode, and out otherwise; a fault of the daemon fades all of it out and ends the run.
"""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from friction_hil.compensator import CompensatorInputs
from friction_hil.daemon.assembly import make_limits
from friction_hil.daemon.axis import AxisLoop, AxisUpdate, compensator_inputs
from friction_hil.daemon.demand import DemandEstimator
from friction_hil.daemon.figures import Condition, FollowingErrors
from friction_hil.daemon.row import AxisRow
from friction_hil.daemon.safety import MAX_STALE_CYCLES, LoopState, Supervisor
from friction_hil.daemon.sequence import SETTLE_S, RunInputs, RunStateMachine, after_the_stop
from friction_hil.daemon.worsening import WorseningJudge
from friction_hil.drive import AxisFacts, Command, DriveState, Feedback
from friction_hil.drive.codes import FaultCode
from friction_hil.motion.trajectory import PathTime
from friction_hil.numerics.readable import POSITION_UNITS

if TYPE_CHECKING:
    from friction_hil.config import AxisConfig

_FAULTS = (DriveState.FAULT, DriveState.FAULT_REACTION_ACTIVE)
_IDLE_S = 0.5  # without compensation, before it is told why


class FollowerStateMachine(RunStateMachine):
    """State of a run in which another controller enables and stops the drives: IDLE, RUNNING, fading out, DONE."""

    __slots__ = ()

    def _next(self, elapsed_s: float, inputs: RunInputs, has_stood: bool) -> LoopState:
        state = self.state
        if state is LoopState.IDLE:
            if inputs.is_stop_requested or inputs.has_fault:
                return after_the_stop(inputs)
            if self._is_listening or elapsed_s < SETTLE_S:
                return state
            return LoopState.WAITING if inputs.is_pause_requested else LoopState.RUNNING
        if state in (LoopState.RUNNING, LoopState.STOPPING) and inputs.has_fault:
            return LoopState.FAULT_STOPPING
        if state is LoopState.RUNNING:
            return LoopState.STOPPING if inputs.is_stop_requested or inputs.is_pause_requested else state
        if state is LoopState.WAITING:
            if inputs.is_stop_requested:
                return LoopState.DONE
            return state if inputs.is_pause_requested or inputs.has_fault else LoopState.RUNNING
        return after_the_stop(inputs) if inputs.is_faded_out else state


class FollowerSupervisor(Supervisor):
    """Check the feedback of an axis that another controller moves; see `friction_hil.daemon.safety.Supervisor`.

    Outside of Operation enabled, and in another mode than the configured one, the axis may be moved by hand or be
    homed: its position may jump, and its limits do not apply.
    """

    __slots__ = ("is_operating",)

    is_operating: bool  # in Operation enabled, in the configured mode

    def take(self, feedback: Feedback, missed: int = 0) -> bool:
        """Take one cycle's feedback; return True if it is fresh, finite and, while the drive operates, plausible."""
        if not self.is_operating and feedback.is_fresh and math.isfinite(feedback.position):
            self._last_position = feedback.position
        return super().take(feedback, missed)

    def find_fault(self, feedback: Feedback, state: LoopState, velocity: float, position_demand: float) -> str | None:
        """Return the fault of the axis as a message, or None: a fault of the drive is its master's business."""
        if feedback.message or self._stale_cycles > self._max_stale_cycles or feedback.state not in _FAULTS:
            judged = state if self.is_operating else LoopState.IDLE
            return super().find_fault(feedback, judged, velocity, position_demand)
        return None


class FollowerAxis(AxisLoop):
    """Computation of one axis that another controller moves; see `friction_hil.daemon.axis.AxisLoop`.

    Its following error counts while the drive operates. The motion is the other controller's: its period is not known.
    """

    __slots__ = ("_baseline_left_s", "_demand", "_drive_notice", "_faded_s", "_has_demand")

    supervisor: FollowerSupervisor

    def __init__(
        self,
        name: str,
        config: "AxisConfig",
        facts: AxisFacts,
        period_s: float,
        path_time: PathTime,
        shadow_names: Sequence[str] = (),
        max_stale_cycles: int = MAX_STALE_CYCLES,
    ) -> None:
        super().__init__(name, config, facts, period_s, path_time, shadow_names, max_stale_cycles)
        unit, limits = POSITION_UNITS[config.model.axis], make_limits(config)
        self.supervisor = FollowerSupervisor(name, limits, period_s, facts.position_resolution, unit, max_stale_cycles)
        self.supervisor.is_operating = False
        self.following_errors = FollowingErrors(period_s, 0.0, math.inf)
        self._worsening = WorseningJudge(period_s, math.inf, facts.position_resolution)
        self._demand = DemandEstimator(period_s, facts.setpoint_delay_s, self.lead_s)
        self._baseline_left_s = config.compensation.baseline_s
        self._has_demand = False
        self._faded_s = 0.0  # time for which the compensation has been enabled
        self._drive_notice = _DriveNotice(name, period_s)

    def begin_again(self) -> None:
        """Prepare for another time of compensation, which begins without it as the first one did."""
        super().begin_again()
        self._baseline_left_s, self._faded_s = self._configured_baseline_s, 0.0

    def enter_path(self) -> None:
        """Do nothing: the path is another controller's."""

    def update(
        self, cycle: int, state: LoopState, running_s: float, feedback: Feedback, command: Command, row: AxisRow
    ) -> AxisUpdate:
        """Compute one cycle; see `AxisLoop.update`. After an exception nothing is left to fade out."""
        update = super().update(cycle, state, running_s, feedback, command, row)
        return update._replace(is_faded_out=True) if self.is_broken else update

    def compute(
        self, cycle: int, state: LoopState, running_s: float, feedback: Feedback, command: Command, row: AxisRow
    ) -> AxisUpdate:
        """Compute one cycle: check the feedback, compensate, command, record; see `AxisLoop.compute`."""
        time_s, compensator, supervisor = cycle * self._period_s, self.compensator, self.supervisor
        is_powered = feedback.state is DriveState.OPERATION_ENABLED
        supervisor.is_operating = is_operating = is_powered and feedback.is_offset_wanted
        missed = self._count_missed(cycle)
        is_usable = supervisor.take(feedback, missed)
        if not is_usable or self.gaps.is_open:
            self._note_gap(cycle, feedback, state, is_usable=is_usable)
        position = supervisor.position
        velocity = feedback.velocity if is_usable else compensator.velocity_estimate
        if not is_operating:
            self._demand.forget()
        demand = self._demand.take(cycle, feedback.position_demand if is_operating else math.nan)
        is_enabled = self._gate(
            is_operating and state in (LoopState.IDLE, LoopState.RUNNING) and running_s >= 0.0,
            (missed + 1) * self._period_s,
        )
        inputs = compensator_inputs(
            cycle, position, velocity, feedback, demand, is_usable=is_usable, is_enabled=is_enabled
        )
        if compensator.is_changing:  # its state is whole afterwards
            compensator.finish_change(*inputs)
        row.write_states(self._states)
        compensation = compensator.step(*inputs)
        estimate = compensator.velocity_estimate
        fault = supervisor.find_fault(feedback, state, estimate, inputs.position_demand)
        if fault is None and compensator.is_faulty:
            text = f"{self.name}: the friction model gave a torque that is not finite"
            fault = FaultCode.MODEL_NOT_FINITE.append_to(text)
        # without power no torque flows, and none may wait for the moment in which the master enables the drive again
        torque = compensation if is_powered else 0.0
        self._command.write(command, state, time_s, position, estimate, None, torque, feedback)
        is_counted = is_operating and state is LoopState.RUNNING
        self._count_follower_error(inputs, missed, is_counted=is_counted)
        row.write_cycle(time_s, inputs, estimate, compensation, command.torque, state, feedback.state)
        row.write_estimates(compensator.load_estimate, compensator.temperature_estimate, 0.0)
        for name, shadow in self.shadows.items():
            row.write_shadow(name, shadow.step(*inputs))
        is_standing = supervisor.is_current and abs(estimate) <= self._standstill
        warning = self.notices.next(compensator, estimate) or self._drive_notice.next(feedback) or self._take_news()
        if warning is None and self._temperature_notices is not None:
            warning = self._temperature_notices.next(feedback.temperature)
        is_faded_out = compensator.is_faded_out and command.torque == 0.0
        return AxisUpdate(fault, warning, False, is_standing, is_faded_out)

    def _gate(self, is_open: bool, elapsed_s: float) -> bool:
        """Return True if the compensation is to be faded in, or kept: after the time without it at the start."""
        if is_open and self._baseline_left_s > 0.0:
            self._baseline_left_s -= elapsed_s
            is_open = False
        is_enabled = is_open and self._is_compensation_enabled
        self._faded_s = self._faded_s + elapsed_s if is_enabled else 0.0
        return is_enabled

    def _count_follower_error(self, inputs: CompensatorInputs, missed: int, *, is_counted: bool) -> None:
        """Count the following error of a cycle as one without, or one with full compensation."""
        condition = Condition.FADING
        if is_counted and self._faded_s > self._fade_s:
            condition = Condition.WITH
        elif is_counted and self.compensator.is_faded_out:
            condition = Condition.WITHOUT
        error = inputs.position_demand - inputs.position
        is_known = inputs.is_fresh and math.isfinite(error)
        self._has_demand = self._has_demand or is_known
        self.lacks_demand = not self._has_demand and (self.lacks_demand or (is_counted and inputs.is_fresh))
        velocity, acceleration = inputs.velocity_demand, inputs.acceleration_demand_ahead
        if self.following_errors.take(condition, error, missed, is_known, velocity, acceleration):
            self._judge(condition, inputs, error)


class _DriveNotice:
    """Tells, once for each change, that the drive does not operate, or does again, and why nothing is compensated."""

    __slots__ = ("_idle_cycles", "_is_operating", "_name", "_patience_cycles", "_told")

    def __init__(self, name: str, period_s: float) -> None:
        self._name = name
        self._patience_cycles = max(1, round(_IDLE_S / period_s))
        self._idle_cycles = 0
        self._is_operating: bool | None = None
        self._told = ""

    def next(self, feedback: Feedback) -> str | None:
        """Return the notice of this cycle; None in most cycles."""
        is_powered = feedback.state is DriveState.OPERATION_ENABLED
        self._idle_cycles = 0 if is_powered and feedback.is_offset_wanted else self._idle_cycles + 1
        if is_powered and self._is_operating is False:
            self._is_operating, self._told = True, ""
            return f"{self._name}: its master has enabled the drive again"
        if is_powered:
            self._is_operating = True
        elif self._is_operating and feedback.state.words != self._told:
            self._is_operating, self._told = False, feedback.state.words
            return (
                f"{self._name}: the drive left Operation enabled, its master's business: {self._told}{feedback.reason}"
            )
        if self._idle_cycles == self._patience_cycles:
            return self._why_idle(feedback)
        return None

    def _why_idle(self, feedback: Feedback) -> str | None:
        if self._is_operating is None:
            state = f"the drive is in state {feedback.state.words}{feedback.reason}, and its master has not enabled it"
            return f"{self._name}: not compensated so far: {state}"
        if self._is_operating:
            reason = "it is in another mode than the configured one, or its master does not command operation (6040h)"
            return f"{self._name}: not compensated, although the drive is in Operation enabled: {reason}"
        return None
