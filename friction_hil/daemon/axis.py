"""One axis in the loop: feedback and set-point in, command and a row of the recording out. No bus, no clock."""

import functools
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

from friction_hil.compensator import Compensator, CompensatorInputs
from friction_hil.compensator.velocity_offset import VelocityOffset
from friction_hil.daemon.assembly import lead_s, make_compensator, make_limits, make_shadows, make_velocity_offset
from friction_hil.daemon.command import CommandWriter
from friction_hil.daemon.control.message import AxisChange
from friction_hil.daemon.figures import FeedbackGaps
from friction_hil.daemon.following import Following, LoadFollowing
from friction_hil.daemon.motion import AxisMotion, Demand
from friction_hil.daemon.notices import AxisNotices
from friction_hil.daemon.row import AxisRow, row_width
from friction_hil.daemon.safety import ENDING, LIMITED, MAX_STALE_CYCLES, LoopState, Standstill, Supervisor
from friction_hil.daemon.schedule import Schedule
from friction_hil.daemon.start_checks import start_checks
from friction_hil.daemon.velocity_trust import FirstTorque
from friction_hil.drive import AxisFacts, Command, Feedback
from friction_hil.drive.codes import FaultCode
from friction_hil.errors import OptionError
from friction_hil.motion.trajectory import PathTime, Setpoint
from friction_hil.numerics.readable import POSITION_UNITS

if TYPE_CHECKING:
    from friction_hil.config import AxisConfig

_MOST_MISSED = 1000  # periods: longer is a fault of the loop


class AxisUpdate(NamedTuple):
    """Outcome of one cycle of one axis."""

    fault: str | None
    warning: str | None
    is_standing: bool
    is_faded_out: bool


class AxisLoop:
    """Computation of one axis.

    ``facts``: resolution and delays, as found by the driver. ``path_time``: shared by all axes, so that they stay on
    their common path. ``shadow_names``: shadow models of all axes: the rows of all axes have the same columns.
    ``max_stale_cycles``: largest number of successive cycles without usable feedback that are bridged.
    ``is_of_arm``: it is a joint of the arm, and `take_arm` comes before each cycle.
    """

    # slots here and in its parts: with a __dict__, the deep copy that warms the caches would be laid out differently,
    # and the interpreter would specialise the code for neither
    __slots__ = (
        "_command",
        "_has_offset",
        "_last_cycle",
        "_make_checks",
        "_period_s",
        "_standstill",
        "_states",
        "_velocity_offset",
        "arm_load",
        "checks",
        "compensator",
        "facts",
        "following",
        "gaps",
        "is_arm_lost",
        "is_broken",
        "is_by_torque",
        "lacks_demand",
        "lead_s",
        "load",
        "motion",
        "name",
        "notices",
        "row_width",
        "schedule",
        "shadow_names",
        "shadows",
        "state_width",
        "supervisor",
    )

    def __init__(
        self,
        name: str,
        config: "AxisConfig",
        facts: AxisFacts,
        period_s: float,
        path_time: PathTime,
        shadow_names: Sequence[str] = (),
        max_stale_cycles: int = MAX_STALE_CYCLES,
        *,
        is_of_arm: bool = False,
    ) -> None:
        check_torque(name, config, facts)
        check_velocity_offset(name, config, facts)
        unit, limits, resolution = POSITION_UNITS[config.model.axis], make_limits(config), facts.position_resolution
        self.name, self.facts, self._period_s = name, facts, period_s
        self.lead_s = lead_s(config.model, facts, period_s)
        self.compensator = make_compensator(config, config.model, facts, period_s)
        self.shadow_names = list(shadow_names)
        self.shadows = make_shadows(config, facts, period_s)
        self.motion = AxisMotion(name, unit, config, limits, facts, period_s, self.lead_s, path_time)
        self._velocity_offset = make_velocity_offset(config, facts, period_s)
        self._command = CommandWriter(
            config, limits, self.motion, period_s, self.lead_s, self._velocity_offset, is_of_arm=is_of_arm
        )
        self.is_by_torque = config.mode == "cst"
        self.arm_load = math.nan  # torque that the arm puts on the axis, N m; NaN: it is in none
        self._has_offset = config.compensation.transmission is not None
        self._standstill = Standstill(limits.velocity, resolution, period_s)
        self.notices = AxisNotices(name, unit, period_s, self.compensator)
        self.gaps = FeedbackGaps()
        self.lacks_demand = False  # another controller moves the axis, and no demanded position was heard of it
        self.is_broken = False  # its computation has failed: it gets no torque any more
        self.is_arm_lost = False  # that of its arm has failed: its weight alone is left
        self._last_cycle = -1
        self._make_parts(config, unit, path_time.ramp_s, max_stale_cycles)
        parts: list[Compensator | VelocityOffset] = [self.compensator, *self.shadows.values()]
        if self._velocity_offset is not None:
            parts.append(self._velocity_offset)
        self._states = [one.state for one in parts]
        self.state_width = sum(state.size for state in self._states)
        self.row_width = row_width(shadow_names) + self.state_width
        self._command.compile()
        self.following.errors.compile()
        for one in parts:
            one.compile()

    def _make_parts(self, config: "AxisConfig", unit: str, ramp_s: float, max_stale_cycles: int) -> None:
        """Make the parts that depend on who moves the axis: here it is the daemon."""
        facts, period_s, limits, resolution = (
            self.facts,
            self._period_s,
            make_limits(config),
            self.facts.position_resolution,
        )
        motion_s = 1.0 / config.trajectory.frequency if hasattr(config.trajectory, "frequency") else math.inf
        self.supervisor = Supervisor(
            self.name,
            limits,
            period_s,
            resolution,
            unit,
            max_stale_cycles,
            facts.velocity_resolution,
            is_velocity_trusted=config.mode != "cst" and config.compensation.velocity != "drive",
        )
        self.schedule = Schedule(config)
        self._make_checks = functools.partial(
            start_checks, self.name, unit, config, limits, facts, period_s, self.motion
        )
        self.checks = self._make_checks()
        self.following = Following(self.name, unit, period_s, ramp_s, motion_s, resolution)
        self.load = LoadFollowing(period_s, ramp_s, motion_s) if facts.has_load_encoder else None

    def apply(self, change: AxisChange, running_s: float) -> None:
        """Change settings, model or the switch of the compensation before the next cycle; see `AxisChange`.

        ``running_s``: time since the motion began, s; NaN before.
        """
        if change.record is not None:
            self.compensator.adopt(change.record, change.friction)
            self.schedule.fade_s = change.record[0]["fade_s"].item()
        if change.friction is not None:
            self.lead_s = self.motion.lead_s = self.compensator.record[0]["lead_s"].item()
            self.notices.renew(self.compensator)
        if change.static is not None:
            self._command.adopt(change.static, self.schedule.fade_s, self.lead_s)
        if change.is_enabled is not None:
            self.schedule.switch(is_enabled=change.is_enabled, running_s=running_s)
        self.following.restart()

    def begin_again(self) -> None:
        """Prepare for another motion after the axis was disabled: checks and figures are those of the new motion."""
        self.schedule.begin_again()
        self.following.begin_again()
        self.checks.begin_again(self._make_checks())
        if self.load is not None:
            self.load.errors = self.load.errors.anew()

    @property
    def is_first_motion_due(self) -> bool:
        """True if the unit of the velocity target is still to be confirmed by a first motion."""
        return self.checks.is_first_motion_due

    def enter_path(self) -> None:
        """Let the path begin where the axis is held now."""
        self.motion.begin_at(self._command.held_position)
        if self.load is not None:
            self.load.enter_path(self._command.held_position)

    def arm_motion(self, cycle: int, state: LoopState, feedback: Feedback) -> tuple[float, float, float]:
        """Return position, velocity and acceleration that count for the arm when this cycle's torque acts, SI.

        They are those that are demanded; else the axis counts as at rest where it was in the cycle before, or, once its
        computation has failed, where its drive says, if that can be.
        """
        if self.is_broken:  # which nothing else has checked
            self.supervisor.take(feedback)
            return self.supervisor.position, 0.0, 0.0
        position, velocity, acceleration, ahead_s = self._demand_of_arm(cycle, state)
        if math.isfinite(position + velocity + acceleration):
            return position + ahead_s * velocity, velocity, acceleration
        ahead_s = self.lead_s + self._period_s
        return self.supervisor.position + ahead_s * self.compensator.velocity_estimate, 0.0, 0.0

    def _demand_of_arm(self, cycle: int, state: LoopState) -> tuple[float, float, float, float]:
        """Return demanded position, and velocity and acceleration ahead; and from that position until then, s."""
        _, (position, _, velocity, acceleration) = self.motion.demand(cycle * self._period_s, state)
        return position, velocity, acceleration, self.lead_s

    def take_arm(self, load: float, torque: float) -> None:
        """Take what the arm puts on the gear of the axis in this cycle, and what is fed forward to it, N m or N."""
        self.arm_load = self._command.arm_load = load
        self._command.arm_torque = torque

    def update(
        self, cycle: int, state: LoopState, running_s: float, feedback: Feedback, command: Command, row: AxisRow
    ) -> AxisUpdate:
        """Compute one cycle; the arguments are those of `compute`.

        An exception in the computation is a fault: from then on the axis gets no torque, and its row holds NaN. Only
        want of memory is raised: it ends the loop.
        """
        fault = warning = None
        if not self.is_broken:
            try:
                return self.compute(cycle, state, running_s, feedback, command, row)
            except MemoryError:
                raise  # the loop has a reserve for its end, but cannot go on
            except Exception as error:  # noqa: BLE001 - whatever it is, the machine must come to rest
                self.is_broken = True
                text = f"{self.name}: the computation failed: {type(error).__name__}: {error}"
                fault = FaultCode.COMPUTATION_FAILED.append_to(text)
                warning = self.notices.next(self.compensator, self.compensator.velocity_estimate, math.nan)
        command.torque = command.velocity = command.velocity_offset = 0.0
        row.clear(cycle * self._period_s, cycle)
        velocity = feedback.velocity if isinstance(feedback.velocity, float) else math.nan
        is_standing = self._standstill.take(velocity, is_usable=feedback.is_fresh)
        return AxisUpdate(fault, warning, is_standing, self.compensator.is_faded_out)

    def _note_gap(self, cycle: int, feedback: Feedback, state: LoopState, *, is_usable: bool) -> None:
        """Count a cycle without usable feedback, or the end of a gap."""
        self.gaps.stale += not is_usable
        if is_usable or state in ENDING:
            self.gaps.close(is_bridged=state not in ENDING)
        elif self.supervisor.has_position:  # before the first one nothing is bridged
            reason = "its position jumps further than limits.velocity allows" if feedback.is_fresh else ""
            self.gaps.miss(cycle, feedback.missing or reason or "no reason is known")

    def compute(
        self, cycle: int, state: LoopState, running_s: float, feedback: Feedback, command: Command, row: AxisRow
    ) -> AxisUpdate:
        """Compute one cycle: check the feedback, compensate, command, record.

        ``running_s``: time since the motion began, or in a dry run since its start, s; NaN before. ``feedback``: from
        the drive, this cycle. ``command`` is filled with the set-point and torque of this cycle, ``row`` with the
        columns of the recording and the states before this cycle.
        """
        time_s, compensator, supervisor = cycle * self._period_s, self.compensator, self.supervisor
        missed, self._last_cycle = min(cycle - self._last_cycle - 1, _MOST_MISSED), cycle
        is_usable = supervisor.take(feedback, missed)
        if not is_usable or self.gaps.is_open:
            self._note_gap(cycle, feedback, state, is_usable=is_usable)
        position = supervisor.position
        velocity = supervisor.velocity(feedback) if is_usable else compensator.velocity_estimate
        setpoint, (position_demand, velocity_demand, velocity_ahead, acceleration_ahead) = self._demand(
            cycle, state, feedback
        )
        inputs = CompensatorInputs(
            float(cycle),
            position,
            velocity,
            feedback.torque,
            position_demand,
            velocity_demand,
            velocity_ahead,
            is_usable,
            self.schedule.is_on(state, running_s, (missed + 1) * self._period_s, supervisor.is_operating),
            acceleration_ahead,
            feedback.temperature,
            self.arm_load,
        )
        if compensator.is_changing:  # its state is whole afterwards
            compensator.finish_change(*inputs)
        row.write_states(self._states)
        compensation = compensator.step(*inputs)
        estimate = compensator.velocity_estimate
        shift = 0.0  # of the motor, across gap and twist of the transmission
        if self._has_offset and setpoint is not None:
            shift, rate = compensator.offset_now
            self._command.offset_sent = compensator.offset_sent
            setpoint = Setpoint(setpoint.position + shift, setpoint.velocity + rate, setpoint.acceleration)
        fault = supervisor.find_fault(feedback, state, estimate, inputs.position_demand + shift)
        if fault is None and compensator.is_faulty:
            text = f"{self.name}: the friction model gave a torque that is not finite"
            fault = FaultCode.MODEL_NOT_FINITE.append_to(text)
        # without power no torque flows, and none may wait for the moment in which the drive is enabled again
        torque = compensation if supervisor.is_torque_taken and self._velocity_offset is None else 0.0
        writer, checks = self._command, self.checks
        if checks.first_torque is not None:
            self._bound_torque(checks.first_torque, state, position, missed)
        writer.write(command, state, time_s, position, estimate, setpoint, torque, feedback)
        if self._velocity_offset is not None:
            offset = self._velocity_offset.step(inputs.cycle, compensation)
            writer.write_velocity_offset(command, state, offset, feedback)
            row.write_velocity_offset(offset)
        start_fault = None
        if state is LoopState.FIRST_MOTION and checks.first_motion is not None:
            start_fault = checks.first_motion.take(position, feedback.velocity, missed, is_usable=is_usable)
            command.velocity = checks.first_motion.target
            self.notices.add(checks.first_motion.take_warning())
        elif state is LoopState.RUNNING and checks.follow_check is not None and setpoint is not None:
            check, wanted = checks.follow_check, setpoint.position
            start_fault = check.take(position, estimate, wanted, command.torque, missed, is_usable=is_usable)
            checks.follow_check = None if check.is_confirmed else check
        if self.load is not None:
            row.write_load(self.load.position(feedback.load_position, position))
        self._count(inputs, shift, state, running_s, missed)
        row.write_cycle(time_s, inputs, estimate, compensation, command.torque, state, feedback.state)
        row.write_feedforward(writer.static)
        row.write_estimates(compensator.load_estimate, compensator.temperature_estimate, compensator.offset_now[0])
        for name, shadow in self.shadows.items():
            row.write_shadow(name, shadow.step(*inputs))
        is_standing = self._standstill.take(estimate, is_usable=is_usable)
        if supervisor.is_in_doubt:
            self.notices.add(supervisor.take_doubt())
        warning = self.notices.next(compensator, estimate, feedback.temperature)
        # the cause before what follows from it: a wrong sign or unit exceeds limits too
        return AxisUpdate(start_fault or fault, warning, is_standing, compensator.is_faded_out)

    def _demand(self, cycle: int, state: LoopState, feedback: Feedback) -> tuple[Setpoint | None, Demand]:
        """Return the set-point of this cycle, None outside of the motion, and the demand for the compensator."""
        return self.motion.demand(cycle * self._period_s, state)

    def _bound_torque(self, first: FirstTorque, state: LoopState, position: float, missed: int) -> None:
        """Let the torque of the loop's controller rise only until the axis moves, while its velocity is in doubt."""
        if self.supervisor.is_velocity_confirmed:
            self.checks.first_torque, self._command.most = None, math.inf
        elif state in LIMITED:
            self._command.most = first.next(position, self._command.effort, missed + 1)

    def _count(self, inputs: CompensatorInputs, shift: float, state: LoopState, running_s: float, missed: int) -> None:
        """Count the following error of a cycle; ``shift``: of the motor against the demand."""
        if state is not LoopState.RUNNING or not self.motion.has_setpoint:
            return
        condition = self.schedule.condition(running_s, self.compensator.is_faded_out)
        error = inputs.position_demand + shift - inputs.position
        self._take_back(self.following.take(condition, inputs, error, missed, inputs.is_fresh))
        if self.load is not None:
            self.load.take(condition, inputs, missed)

    def _take_back(self, warning: str) -> None:
        """Switch the compensation off where there is a warning that it makes the following error larger."""
        if warning:
            self.schedule.take_back()
            self.notices.add(warning)


def check_velocity_offset(name: str, config: "AxisConfig", facts: AxisFacts) -> None:
    """Refuse a velocity offset that does not get to the drive."""
    given = config.compensation
    if given.is_by_velocity and given.enabled and not facts.takes_velocity_offset:
        raise OptionError(name, "compensation.velocity_offset", "is not possible: this drive takes no velocity offset")


def check_torque(name: str, config: "AxisConfig", facts: AxisFacts) -> None:
    """Refuse settings that need the torque of a drive that does not report it."""
    if facts.torque_delay_s is not None:
        return
    given = config.compensation
    key = "velocity" if given.velocity == "kalman" else "adaptation" if given.adaptation is not None else None
    if key:
        raise OptionError(name, f"compensation.{key}", "needs the torque, which this drive does not report")
