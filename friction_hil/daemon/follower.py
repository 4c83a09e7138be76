"""Axes that another controller enables and moves: the loop only adds the compensation (``bus.role: sidecar``).

Nothing here stops the machine. The compensation of an axis is faded in while its drive is in Operation enabled in the
configured mode, and out otherwise; a fault of the daemon fades all of it out and ends the run.
"""

import functools
import math
from typing import TYPE_CHECKING

from friction_hil.compensator import CompensatorInputs
from friction_hil.daemon.assembly import make_limits
from friction_hil.daemon.axis import AxisLoop, AxisUpdate
from friction_hil.daemon.demand import DemandEstimator
from friction_hil.daemon.figures import Condition
from friction_hil.daemon.following import Following
from friction_hil.daemon.motion import NO_DEMAND, Demand
from friction_hil.daemon.notices import MasterNotices
from friction_hil.daemon.row import AxisRow
from friction_hil.daemon.safety import LoopState, Supervisor
from friction_hil.daemon.schedule import FollowerSchedule
from friction_hil.daemon.sequence import SETTLE_S, RunInputs, RunStateMachine, after_the_stop
from friction_hil.daemon.start_checks import StartChecks
from friction_hil.drive import Command, DriveState, Feedback
from friction_hil.motion.trajectory import Setpoint

if TYPE_CHECKING:
    from friction_hil.config import AxisConfig

_FAULTS = (DriveState.FAULT, DriveState.FAULT_REACTION_ACTIVE)


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

    __slots__ = ("is_operating", "is_torque_taken")

    is_torque_taken: bool  # in Operation enabled
    is_operating: bool  # in Operation enabled, in the configured mode

    def take(self, feedback: Feedback, missed: int = 0) -> bool:
        """Take one cycle's feedback; return True if it is fresh, finite and, while the drive operates, plausible."""
        self.is_torque_taken = feedback.state is DriveState.OPERATION_ENABLED
        self.is_operating = self.is_torque_taken and feedback.is_offset_wanted
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

    __slots__ = ("_estimator", "_has_demand", "_heard", "_master_notices")

    supervisor: FollowerSupervisor

    def _make_parts(self, config: "AxisConfig", unit: str, ramp_s: float, max_stale_cycles: int) -> None:
        """Make the parts that depend on who moves the axis: here it is its master."""
        period_s, resolution = self._period_s, self.facts.position_resolution
        self.supervisor = FollowerSupervisor(
            self.name, make_limits(config), period_s, resolution, unit, max_stale_cycles
        )
        self.schedule = FollowerSchedule(config)
        self._make_checks = functools.partial(StartChecks)  # none: its master begins the motion
        self.checks, self.load = StartChecks(), None
        self.following = Following(self.name, unit, period_s, 0.0, math.inf, resolution)
        self._estimator = DemandEstimator(period_s, self.facts.setpoint_delay_s, self.lead_s)
        self._has_demand = False
        self._heard: Demand = NO_DEMAND  # in the last cycle
        self._master_notices = MasterNotices(self.name, period_s)

    def enter_path(self) -> None:
        """Do nothing: the path is another controller's."""

    def update(
        self, cycle: int, state: LoopState, running_s: float, feedback: Feedback, command: Command, row: AxisRow
    ) -> AxisUpdate:
        """Compute one cycle; see `AxisLoop.update`. After an exception nothing is left to fade out."""
        self.notices.add(self._master_notices.next(feedback))
        update = super().update(cycle, state, running_s, feedback, command, row)
        is_faded_out = self.is_broken or (update.is_faded_out and command.torque == 0.0)
        return update if is_faded_out == update.is_faded_out else update._replace(is_faded_out=is_faded_out)

    def _demand(self, cycle: int, state: LoopState, feedback: Feedback) -> tuple[Setpoint | None, Demand]:
        """Return no set-point, and the demand that is heard of the master."""
        is_operating = self.supervisor.is_operating
        if not is_operating:
            self._estimator.forget()
        self._heard = self._estimator.take(cycle, feedback.position_demand if is_operating else math.nan)
        return None, self._heard

    def _demand_of_arm(self, cycle: int, state: LoopState) -> tuple[float, float, float, float]:
        """Return the demand of the cycle before: that of this one is heard with the other inputs of the axis."""
        position, _, velocity, acceleration = self._heard
        return position, velocity, acceleration, self.lead_s + self._period_s

    def _count(self, inputs: CompensatorInputs, shift: float, state: LoopState, running_s: float, missed: int) -> None:
        """Count the following error of a cycle, in whatever state the axis is."""
        is_counted, condition = self.supervisor.is_operating and state is LoopState.RUNNING, Condition.FADING
        if is_counted:
            condition = self.schedule.condition(running_s, self.compensator.is_faded_out)
        error = inputs.position_demand - inputs.position
        is_known = inputs.is_fresh and math.isfinite(error)
        self._has_demand = self._has_demand or is_known
        self.lacks_demand = not self._has_demand and (self.lacks_demand or (is_counted and inputs.is_fresh))
        self._take_back(self.following.take(condition, inputs, error, missed, is_known))
