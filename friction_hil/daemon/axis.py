"""One axis in the loop: feedback and set-point in, command and a row of the recording out. No bus, no clock."""

import functools
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

from friction_hil.compensator import CompensatorInputs
from friction_hil.daemon.assembly import lead_s, make_compensator, make_limits, make_shadows
from friction_hil.daemon.command import CommandWriter
from friction_hil.daemon.control.message import AxisChange
from friction_hil.daemon.control.state import error_without
from friction_hil.daemon.figures import CompensationNotices, Condition, FeedbackGaps, FollowingErrors
from friction_hil.daemon.first_motion import FirstMotion
from friction_hil.daemon.follow_check import FollowCheck
from friction_hil.daemon.motion import AxisMotion
from friction_hil.daemon.row import AxisRow, row_width
from friction_hil.daemon.safety import (
    ENDING,
    LIMITED,
    MAX_STALE_CYCLES,
    FaultReset,
    LoopState,
    SafetyLimits,
    Supervisor,
)
from friction_hil.daemon.sequence import STANDSTILL_S
from friction_hil.daemon.temperature import TemperatureNotices
from friction_hil.daemon.velocity_trust import FirstTorque
from friction_hil.daemon.worsening import WorseningJudge
from friction_hil.drive import AxisFacts, Command, Feedback
from friction_hil.drive.codes import FaultCode
from friction_hil.errors import OptionError
from friction_hil.motion.trajectory import PathTime, Setpoint
from friction_hil.numerics.readable import POSITION_UNITS, quantity

if TYPE_CHECKING:
    from friction_hil.config import AxisConfig

_STANDSTILL_RATIO = 1e-3  # of the velocity limit: slower counts as standing
_HELD_S = 0.5 * STANDSTILL_S  # a cycle without usable feedback tells nothing about standstill, for so long
_MOST_MISSED = 1000  # periods: longer is a fault of the loop
_MOST_HELD = 10  # cycles
_FADING, _WITHOUT, _WITH = Condition.FADING, Condition.WITHOUT, Condition.WITH


class AxisUpdate(NamedTuple):
    """Outcome of one cycle of one axis."""

    fault: str | None
    warning: str | None
    is_reset_due: bool  # the drive is in a fault that the user wants to leave
    is_standing: bool
    is_faded_out: bool


class AxisLoop:
    """Computation of one axis.

    ``facts``: resolution and delays, as found by the driver. ``path_time``: shared by all axes, so that they stay on
    their common path. ``shadow_names``: shadow models of all axes: the rows of all axes have the same columns.
    ``max_stale_cycles``: largest number of successive cycles without usable feedback that are bridged.
    """

    # slots here and in its parts: with a __dict__, the deep copy that warms the caches would be laid out differently,
    # and the interpreter would specialise the code for neither
    __slots__ = (
        "_baseline_s",
        "_command",
        "_configured_baseline_s",
        "_fade_s",
        "_faded_in_s",
        "_fault_reset",
        "_first_motion",
        "_first_torque",
        "_follow_check",
        "_has_offset",
        "_held",
        "_is_compensation_enabled",
        "_is_standing",
        "_is_velocity_doubt_told",
        "_last_cycle",
        "_load_position",
        "_load_zero",
        "_make_checks",
        "_most_held",
        "_news",
        "_period_s",
        "_standstill",
        "_states",
        "_temperature_notices",
        "_unit",
        "_worsening",
        "compensator",
        "following_errors",
        "gaps",
        "is_broken",
        "is_stopped_by_gaps",
        "lacks_demand",
        "lead_s",
        "load_errors",
        "motion",
        "name",
        "notices",
        "row_width",
        "setpoint_age_s",
        "setpoint_delay_s",
        "shadow_names",
        "shadows",
        "stale_cycles",
        "state_width",
        "supervisor",
        "taken_back",
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
    ) -> None:
        check_torque(name, config, facts)
        unit, limits = POSITION_UNITS[config.model.axis], make_limits(config)
        self.name = name
        self._period_s, self._unit = period_s, unit
        self.lead_s = lead_s(config.model, facts, period_s)
        self.setpoint_delay_s, self.setpoint_age_s = facts.setpoint_delay_s, facts.setpoint_age_s
        self.shadow_names = list(shadow_names)
        self.compensator = make_compensator(config, config.model, facts, period_s)
        self.shadows = make_shadows(config, facts, period_s)
        self.supervisor = Supervisor(
            name,
            limits,
            period_s,
            facts.position_resolution,
            unit,
            max_stale_cycles,
            facts.velocity_resolution,
            is_velocity_trusted=config.mode != "cst" and config.compensation.velocity != "drive",
        )
        self.motion = AxisMotion(name, unit, config, limits, facts, period_s, self.lead_s, path_time)
        # stops where set-points are missing: it has a path of positions; velocity or torque would be kept
        self.is_stopped_by_gaps = config.mode == "csp" and self.motion.distance > 0.0
        motion_s = 1.0 / config.trajectory.frequency if hasattr(config.trajectory, "frequency") else math.inf
        self.following_errors = FollowingErrors(period_s, path_time.ramp_s, motion_s)
        self._worsening = WorseningJudge(period_s, motion_s, facts.position_resolution)
        self.taken_back = self._news = ""  # why the compensation was taken back in this run; empty if it was not
        # another controller moves the axis, and no demanded position has been heard of it so far
        self.lacks_demand = False
        self.stale_cycles = 0  # without usable feedback
        self.gaps = FeedbackGaps()
        self._has_offset = config.compensation.transmission is not None
        self._is_compensation_enabled = config.compensation.enabled
        self._configured_baseline_s = config.compensation.baseline_s
        self._baseline_s = self._configured_baseline_s if config.compensation.enabled else math.inf
        self._fade_s = config.compensation.fade_s
        self._faded_in_s = self._baseline_s + self._fade_s
        self._standstill = max(_STANDSTILL_RATIO * limits.velocity, 2.0 * facts.position_resolution / period_s)
        self._command = CommandWriter(config, limits, self.motion, period_s, self.lead_s)
        # of the load, against the path, where it has an encoder
        self.load_errors = None
        if facts.has_load_encoder:
            self.load_errors = FollowingErrors(period_s, path_time.ramp_s, motion_s)
        self._load_zero = self._load_position = math.nan
        self.notices = CompensationNotices(name, unit, self.compensator)
        self._watch_temperature()
        self._fault_reset = FaultReset(is_wanted=False)
        self._make_checks = functools.partial(_checks, name, unit, config, limits, facts, period_s, self.motion)
        self._first_motion, self._first_torque, self._follow_check = self._make_checks()
        self._is_velocity_doubt_told = False
        self.is_broken = False  # its computation has failed: it gets no torque any more
        self._is_standing = False  # in the last cycle with usable feedback
        self._held = 0  # cycles since then
        self._last_cycle = -1
        self._most_held = min(_MOST_HELD, max(1, int(_HELD_S / period_s)))
        self._states = [one.state for one in (self.compensator, *self.shadows.values())]
        self.state_width = sum(state.size for state in self._states)
        self.row_width = row_width(shadow_names) + self.state_width
        self._command.compile()
        self.following_errors.compile()
        for one in (self.compensator, *self.shadows.values()):
            one.compile()

    def allow_fault_reset(self) -> None:
        """Allow to reset the fault in which the drive is found at the start."""
        self._fault_reset = FaultReset(is_wanted=True)

    def apply(self, change: AxisChange, running_s: float) -> None:
        """Change settings, model or the switch of the compensation before the next cycle; see `AxisChange`.

        ``running_s``: time since the motion began, s; NaN before.
        """
        if change.record is not None:
            self.compensator.adopt(change.record, change.friction)
            self._fade_s = change.record[0]["fade_s"].item()
        if change.friction is not None:
            self.lead_s = self.motion.lead_s = self.compensator.record[0]["lead_s"].item()
            self.notices.renew(self.compensator)
            self._watch_temperature()
        if change.static is not None:
            self._command.adopt(change.static, self._fade_s, self.lead_s)
        if change.is_enabled is not None:
            self._is_compensation_enabled = change.is_enabled
            begins_s = max(self._configured_baseline_s, running_s if math.isfinite(running_s) else 0.0)
            self._baseline_s = begins_s if change.is_enabled else math.inf
        self._faded_in_s = self._baseline_s + self._fade_s
        self._worsening.restart()

    def begin_again(self) -> None:
        """Prepare for another motion after the axis was disabled: checks and figures are those of the new motion."""
        first_motion, first_torque, self._follow_check = self._make_checks()
        if self.is_first_motion_due:
            self._first_motion = first_motion
        if self._first_torque is not None:
            self._first_torque = first_torque
        self.following_errors = self.following_errors.anew()
        self._worsening = self._worsening.anew()
        if self.load_errors is not None:
            self.load_errors = self.load_errors.anew()
        self._baseline_s = self._configured_baseline_s if self._is_compensation_enabled else math.inf
        self._faded_in_s = self._baseline_s + self._fade_s

    def _watch_temperature(self) -> None:
        """Begin to watch the temperature, if the present model depends on it."""
        self._temperature_notices = None
        if math.isfinite(self.compensator.record[0]["reference_temperature"]):
            self._temperature_notices = TemperatureNotices(self.name, self.compensator, self._period_s)

    @property
    def may_reset_fault(self) -> bool:
        """True if the fault in which the drive is found is to be reset when the axis is enabled."""
        return self._fault_reset.is_open

    @property
    def is_first_motion_due(self) -> bool:
        """True if the unit of the velocity target is still to be confirmed by a first motion."""
        return self._first_motion is not None and not self._first_motion.is_done

    def enter_path(self) -> None:
        """Let the path begin where the axis is held now."""
        self.motion.begin_at(self._command.held_position)
        self._load_zero = self._load_position - self._command.held_position

    def update(
        self, cycle: int, state: LoopState, running_s: float, feedback: Feedback, command: Command, row: AxisRow
    ) -> AxisUpdate:
        """Compute one cycle; the arguments are those of `compute`.

        An exception in the computation is a fault, which `--reset-fault` does not cover: from then on the axis
        gets no torque, and its row holds NaN. Only want of memory is raised: it ends the loop.
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
                warning = self.notices.next(self.compensator, self.compensator.velocity_estimate)
        command.torque = command.velocity = 0.0
        row.clear(cycle * self._period_s, cycle)
        is_standing = self._judge_standstill(self._seems_to_stand(feedback), is_usable=feedback.is_fresh)
        return AxisUpdate(fault, warning, False, is_standing, self.compensator.is_faded_out)

    def _judge_standstill(self, is_slow: bool, *, is_usable: bool) -> bool:
        """Return True if the axis stands; a lost cycle now and then says nothing, and changes nothing."""
        if is_usable:
            self._is_standing, self._held = is_slow, 0
        else:
            self._held += 1
        return self._is_standing and self._held <= self._most_held

    def _seems_to_stand(self, feedback: Feedback) -> bool:
        """True if the drive itself reports standstill; a velocity that is not a number proves none."""
        try:
            return feedback.is_fresh and abs(feedback.velocity) <= self._standstill
        except TypeError:
            return False

    def _note_gap(self, cycle: int, feedback: Feedback, state: LoopState, *, is_usable: bool) -> None:
        """Count a cycle without usable feedback, or the end of a gap."""
        self.stale_cycles += not is_usable
        if is_usable or state in ENDING:
            self.gaps.close(is_bridged=state not in ENDING)
        elif self.supervisor.has_position:  # before the first one nothing is bridged
            reason = "its position jumps further than limits.velocity allows" if feedback.is_fresh else ""
            self.gaps.miss(cycle, feedback.missing or reason or "no reason is known")

    def _count_missed(self, cycle: int) -> int:
        """Return the number of periods between the cycle before and this one."""
        missed, self._last_cycle = cycle - self._last_cycle - 1, cycle
        return min(missed, _MOST_MISSED)

    def compute(
        self, cycle: int, state: LoopState, running_s: float, feedback: Feedback, command: Command, row: AxisRow
    ) -> AxisUpdate:
        """Compute one cycle: check the feedback, compensate, command, record.

        ``running_s``: time since the motion began, or in a dry run since its start, s; NaN before. ``feedback``: from
        the drive, this cycle. ``command`` is filled with the set-point and torque of this cycle, ``row`` with the
        columns of the recording and the states before this cycle.
        """
        time_s, compensator, supervisor = cycle * self._period_s, self.compensator, self.supervisor
        missed = self._count_missed(cycle)
        is_usable = supervisor.take(feedback, missed)
        if not is_usable or self.gaps.is_open:
            self._note_gap(cycle, feedback, state, is_usable=is_usable)
        position = supervisor.position
        velocity = supervisor.velocity(feedback) if is_usable else compensator.velocity_estimate
        setpoint, demand = self.motion.demand(time_s, state)
        is_active = self._is_compensation_enabled and state in (LoopState.IDLE, LoopState.RUNNING)
        is_enabled = is_active and running_s >= self._baseline_s
        inputs = compensator_inputs(
            cycle, position, velocity, feedback, demand, is_usable=is_usable, is_enabled=is_enabled
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
        if self._first_torque is not None:
            self._bound_torque(state, position, missed)
        self._command.write(command, state, time_s, position, estimate, setpoint, compensation, feedback)
        if state is LoopState.FIRST_MOTION and self._first_motion is not None:
            for _ in range(missed):
                self._first_motion.take(math.nan, math.nan, is_usable=False)
            fault = self._first_motion.take(position, feedback.velocity, is_usable=is_usable) or fault
            command.velocity = self._first_motion.target
        if self.load_errors is not None:
            load_position = self._take_load(feedback.load_position, position)
            row.write_load(load_position)
        if setpoint is not None and state is LoopState.RUNNING:
            condition = _WITH if running_s >= self._faded_in_s else _FADING
            if running_s < self._baseline_s and compensator.is_faded_out:
                condition = _WITHOUT
            error = setpoint.position - position
            velocity, acceleration = inputs.velocity_demand, inputs.acceleration_demand_ahead
            if self.following_errors.take(condition, error, missed, is_usable, velocity, acceleration):
                self._judge(condition, inputs, error)
            if self.load_errors is not None:
                error = inputs.position_demand - load_position
                is_known = is_usable and math.isfinite(error)
                self.load_errors.take(condition, error, missed, is_known, velocity, acceleration)
            if self._follow_check is not None:
                take = self._follow_check.take
                for _ in range(missed):
                    take(math.nan, math.nan, math.nan, math.nan, is_usable=False)
                fault = take(position, estimate, setpoint.position, command.torque, is_usable=is_usable) or fault
                if self._follow_check.is_confirmed:
                    self._follow_check = None
        row.write_cycle(time_s, inputs, estimate, compensation, command.torque, state, feedback.state)
        row.write_estimates(compensator.load_estimate, compensator.temperature_estimate, compensator.offset_now[0])
        for name, shadow in self.shadows.items():
            row.write_shadow(name, shadow.step(*inputs))
        is_standing = self._judge_standstill(abs(estimate) <= self._standstill, is_usable=is_usable)
        is_reset_due = self._takes_reset(time_s, state, feedback, fault)
        fault = None if is_reset_due else fault  # what is to be reset does not end the run
        warning = self.notices.next(compensator, estimate) or self._take_first_warning() or self._doubt_velocity()
        warning = warning or self._take_news()
        if warning is None and self._temperature_notices is not None:
            warning = self._temperature_notices.next(feedback.temperature)
        return AxisUpdate(fault, warning, is_reset_due, is_standing, compensator.is_faded_out)

    def _take_load(self, load_position: float, position: float) -> float:
        """Return the load's position, zero where the motor's is: at first, and again where the motion begins."""
        self._load_position = load_position
        if math.isnan(self._load_zero):
            self._load_zero = load_position - position
        return load_position - self._load_zero

    def _judge(self, condition: Condition, inputs: CompensatorInputs, error: float) -> None:
        """Take the compensation back if settled motion shows that it makes the following error larger."""
        velocity, acceleration = inputs.velocity_demand, inputs.acceleration_demand_ahead
        worse = self._worsening.take(condition, velocity, acceleration, error)
        if worse is None:
            return
        self._is_compensation_enabled = False
        self._baseline_s = self._faded_in_s = math.inf
        self.taken_back = FaultCode.TAKEN_BACK.append_to(
            f"{self.name}: compensation makes the following error larger, {quantity(worse.without, self._unit)} -> "
            f"{quantity(worse.compensated, self._unit)} RMS at the same velocities: it is taken back, the run goes on "
            "without it; is the sign of the torque right (inverted_torque, 607Eh), and the model that of this axis?"
        )
        self._news = self.taken_back

    def _take_news(self) -> str | None:
        """Return, once, that the compensation was taken back."""
        news, self._news = self._news, ""
        return news or None

    def take_error_without(self) -> str | None:
        """Return, once, the text of the event that a time without compensation has ended; None in most cycles."""
        if (news := self.following_errors.news) is None:
            return None
        self.following_errors.news = None
        return error_without(self.name, self._unit, news.rms, news.peak, news.seconds)

    def _bound_torque(self, state: LoopState, position: float, missed: int) -> None:
        """Let the torque of the loop's controller rise only until the axis moves, while its velocity is in doubt."""
        if self.supervisor.is_velocity_confirmed or self._first_torque is None:
            self._first_torque, self._command.most = None, math.inf
        elif state in LIMITED:
            self._command.most = self._first_torque.next(position, self._command.effort, missed + 1)

    def _doubt_velocity(self) -> str | None:
        """Return a warning, once, that the velocity which the drive reports is not that of its position."""
        ratio = self.supervisor.velocity_contradiction
        if self._is_velocity_doubt_told or math.isnan(ratio):
            return None
        self._is_velocity_doubt_told = True
        return (
            f"{self.name}: the drive reports a velocity {ratio:.3g} times the derivative of its position: it is not "
            "used, speed follows from the position alone; compare the unit of its velocity with its manual"
        )

    def _take_first_warning(self) -> str | None:
        """Return the warning of the first motion, once."""
        if self._first_motion is None or self._first_motion.warning is None:
            return None
        warning, self._first_motion.warning = self._first_motion.warning, None
        return warning

    def _takes_reset(self, time_s: float, state: LoopState, feedback: Feedback, fault: str | None) -> bool:
        """Take the feedback; return True if the drive is in the fault that the user wants to leave."""
        if fault is not None or state is LoopState.ENABLING:
            self._fault_reset.take(feedback)
        return self._fault_reset.is_due(feedback, state, time_s)


def compensator_inputs(
    cycle: int,
    position: float,
    velocity: float,
    feedback: Feedback,
    demand: tuple[float, float, float, float],
    *,
    is_usable: bool,
    is_enabled: bool,
) -> CompensatorInputs:
    """Return the inputs of one cycle; ``demand`` is position and velocity now, velocity and acceleration ahead."""
    position_demand, velocity_demand, velocity_ahead, acceleration_ahead = demand
    return CompensatorInputs(
        float(cycle),
        position,
        velocity,
        feedback.torque,
        position_demand,
        velocity_demand,
        velocity_ahead,
        is_usable,
        is_enabled,
        acceleration_ahead,
        feedback.temperature,
    )


def _checks(
    name: str,
    unit: str,
    config: "AxisConfig",
    limits: SafetyLimits,
    facts: AxisFacts,
    period_s: float,
    motion: AxisMotion,
) -> tuple[FirstMotion | None, FirstTorque | None, FollowCheck | None]:
    """Return what watches the beginning of a motion, None for what is not needed."""
    first_motion = first_torque = follow_check = None
    if config.mode == "cst":
        first_torque = FirstTorque(limits.torque, limits.velocity, period_s, facts.position_resolution)
    if config.mode == "csv" and motion.has_setpoint and facts.velocity_resolution > 0.0:
        first_motion = FirstMotion(name, unit, limits, period_s, facts.position_resolution, facts.velocity_resolution)
    if motion.has_setpoint:
        follow_check = FollowCheck(
            name,
            unit,
            limits,
            motion.distance,
            period_s,
            facts.position_resolution,
            is_torque_ours=config.mode == "cst",
        )
    return first_motion, first_torque, follow_check


def check_torque(name: str, config: "AxisConfig", facts: AxisFacts) -> None:
    """Refuse settings that need the torque of a drive that does not report it."""
    if facts.torque_delay_s is not None:
        return
    given = config.compensation
    key = "velocity" if given.velocity == "kalman" else "adaptation" if given.adaptation is not None else None
    if key:
        raise OptionError(name, f"compensation.{key}", "needs the torque, which this drive does not report")
