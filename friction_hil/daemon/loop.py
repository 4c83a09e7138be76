"""The fixed-period loop: deadline, feedback, computation, command, one row out. One thread, nothing that blocks."""

import copy
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from friction_hil.daemon.axis import AxisLoop
from friction_hil.daemon.safety import REQUESTS, REQUESTS_AFTER_FAULT, LoopState
from friction_hil.daemon.sequence import Course, Facts
from friction_hil.daemon.stop import StopRequest
from friction_hil.drive import Clock, Command, Drives, DriveState, Feedback, Request
from friction_hil.errors import DriveError, FrictionHilError
from friction_hil.motion.trajectory import PathTime
from friction_hil.numerics.jit import Array
from friction_hil.recordings import columns

_TIME, _CYCLE = columns.NAMES.index(columns.TIME), columns.NAMES.index(columns.CYCLE)
_LATE = columns.NAMES.index("late_us")
_EXCHANGE = columns.NAMES.index("exchange_us")
_FIRST_FEEDBACK_S = 1.0
_FAULT_RESET_S = 1.0
_HISTOGRAM_US = 20000
_WITHOUT_FAULT = (
    DriveState.SWITCH_ON_DISABLED,
    DriveState.READY_TO_SWITCH_ON,
    DriveState.SWITCHED_ON,
    DriveState.OPERATION_ENABLED,
    DriveState.QUICK_STOP_ACTIVE,
)


class Sink(Protocol):
    """Where rows and events go; neither call may block a real-time loop."""

    def push(self, row: Array) -> None:
        """Take the rows of all axes of one cycle; ``row`` is reused."""
        ...

    def event(self, cycle: int, name: str, text: str) -> None:
        """Take something that happened in a cycle."""
        ...


@dataclass(frozen=True, slots=True)
class LoopSettings:
    """How the loop runs.

    Attributes
    ----------
    period_s : float
    duration_s : float
        Time after which the motion comes to rest; infinity for none.
    max_missed : int
        Missed periods in a row that are a fault.
    dry_run : bool
        Listen, compute, record; never command.
    is_fault_reset_wanted : bool
        Leave a drive's fault, on the user's word, before enabling.
    """

    period_s: float
    duration_s: float = math.inf
    max_missed: int = 10
    dry_run: bool = False
    is_fault_reset_wanted: bool = False


@dataclass(slots=True)
class LoopResult:
    """What a run amounts to. Lateness is that of the wake-ups, in microseconds."""

    cycles: int = 0
    missed: int = 0
    late_p50_us: float = math.nan
    late_p99_us: float = math.nan
    faults: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)


class Loop:
    """Drives some axes through a run.

    Parameters
    ----------
    drives : Drives
        Connected, not yet started.
    axes : sequence of AxisLoop
        In the order of the drives' axes.
    path_time : PathTime
        The axes' shared one.
    clock : Clock
    sink : Sink
    settings : LoopSettings
    stop : StopRequest
    """

    def __init__(
        self,
        drives: Drives,
        axes: Sequence[AxisLoop],
        path_time: PathTime,
        clock: Clock,
        sink: Sink,
        settings: LoopSettings,
        stop: StopRequest,
    ) -> None:
        self._drives = drives
        self._axes = list(axes)
        self._path_time = path_time
        self._clock = clock
        self._sink = sink
        self._settings = settings
        self._stop = stop
        self._feedback = [Feedback() for _ in axes]
        self._commands = [Command() for _ in axes]
        self._is_broken = [False for _ in axes]
        self._is_warming_broken = False
        self._may_reset_fault = [settings.is_fault_reset_wanted for _ in axes]
        width = columns_width(self._axes)
        self._row = np.full(len(self._axes) * width, math.nan)
        self._parts = [self._row[k * width : (k + 1) * width] for k in range(len(self._axes))]
        self._double = copy.deepcopy(self._axes[0])
        self._double_feedback = Feedback(state=DriveState.OPERATION_ENABLED, is_fresh=True)
        self._double_command, self._double_row = Command(), self._parts[0].copy()
        self._late = np.zeros(_HISTOGRAM_US + 1, dtype=np.int64)
        self._course = Course(is_listening=settings.dry_run)
        self._running_since_s = math.nan
        self._idle_exchanges_us: list[float] = []
        self.result = LoopResult()

    def run(self) -> LoopResult:
        """Run until the duration is over, a stop is requested, or a fault has been dealt with.

        The drives are disabled when it returns, as far as they can still be reached. What went wrong is in the
        result's ``faults``.
        """
        for axis in self._axes:
            axis.warm_up()
        cycle = 0
        try:
            self._drives.start()
            period_ns = round(self._settings.period_s * 1e9)
            start_ns = self._clock.now_ns() + period_ns
            while self._course.state is not LoopState.DONE:
                deadline_ns = start_ns + cycle * period_ns
                if self._clock.doze_until(deadline_ns):
                    self._warm_caches(cycle)
                self._clock.sleep_until(deadline_ns)
                late_ns = self._clock.now_ns() - deadline_ns
                skipped = late_ns // period_ns
                if skipped:
                    self._note_missed(cycle, skipped, late_ns)
                    cycle += skipped
                    late_ns -= skipped * period_ns
                self._late[min(late_ns // 1000, _HISTOGRAM_US)] += 1
                self._cycle(cycle, start_ns + cycle * period_ns, late_ns)
                cycle += 1
        except FrictionHilError as error:
            self._fault(cycle, str(error))
        finally:
            self._finish(cycle)
        return self.result

    def _warm_caches(self, cycle: int) -> None:
        """Run a cycle's code on a copy of the first axis: caches that a sleep has emptied cost as much as the work."""
        if self._is_warming_broken:
            return
        try:
            self._drives.warm_caches()
            self._double.update(
                cycle, LoopState.RUNNING, 0.0, self._double_feedback, self._double_command, self._double_row
            )
        except Exception as error:  # noqa: BLE001 - what fails here will fail in earnest: come to rest in good order
            self._is_warming_broken = True
            self._fault(cycle, f"warming the caches failed: {type(error).__name__}: {error}")

    def _note_missed(self, cycle: int, skipped: int, late_ns: int) -> None:
        """Count missed periods; while the drives are idle, none is."""
        if self._course.state is LoopState.IDLE and not self._settings.dry_run:
            return
        self.result.missed += skipped
        if skipped >= self._settings.max_missed:
            self._fault(cycle, f"the loop was late by {late_ns / 1000:.0f} us ({skipped} periods)")

    def _cycle(self, cycle: int, deadline_ns: int, late_ns: int) -> None:
        """Everything that happens in one period."""
        clock, settings = self._clock, self._settings
        time_s = cycle * settings.period_s
        began_ns = clock.now_ns()
        self._drives.receive(self._feedback, deadline_ns + round(settings.period_s * 1e9))
        if not self._is_first_feedback_here(cycle, time_s):
            return
        state = self._course.state
        running_s = time_s if settings.dry_run else time_s - self._running_since_s
        for k, axis in enumerate(self._axes):
            fault = self._update(k, axis, cycle, state, running_s)
            if axis.notice:
                self._warn(cycle, axis.notice)
                axis.notice = ""
            if fault is not None and not self._is_fault_being_reset(k, time_s):
                self._fault(cycle, fault)
        request = (REQUESTS_AFTER_FAULT if self.result.faults else REQUESTS)[state]
        for k, command in enumerate(self._commands):
            is_reset = state is LoopState.ENABLING and self._is_fault_being_reset(k, time_s)
            command.request = Request.RESET_FAULT if is_reset else request
        self._drives.send(self._commands)
        exchange_us = (clock.now_ns() - began_ns) * 1e-3
        for part in self._parts:
            part[_LATE] = late_ns * 1e-3
            part[_EXCHANGE] = exchange_us
        self._sink.push(self._row)
        self.result.cycles += 1
        if state is LoopState.IDLE and not settings.dry_run:
            self._idle_exchanges_us.append(exchange_us)
        self._advance(cycle, time_s)

    def _is_first_feedback_here(self, cycle: int, time_s: float) -> bool:
        """Whether every axis has told its position at least once; until then nothing is computed."""
        if cycle == 0 or any(math.isnan(axis.supervisor.position) for axis in self._axes):
            for axis, feedback in zip(self._axes, self._feedback, strict=True):
                if math.isnan(axis.supervisor.position) and not axis.supervisor.is_usable(feedback):
                    if time_s > _FIRST_FEEDBACK_S:
                        raise DriveError(f"{axis.name}: no usable feedback within {_FIRST_FEEDBACK_S:g} s of the start")
                    return False
            if not self._settings.dry_run:
                for axis in self._axes:
                    axis.check_path()
        return True

    def _is_fault_being_reset(self, k: int, time_s: float) -> bool:
        """Whether the drive is in the fault that the user wants to leave: the one it was found in, no later one."""
        feedback = self._feedback[k]
        if feedback.is_fresh and feedback.state in _WITHOUT_FAULT:
            self._may_reset_fault[k] = False
        return (
            self._may_reset_fault[k]
            and self._course.state in (LoopState.IDLE, LoopState.ENABLING)
            and feedback.state is DriveState.FAULT
            and time_s < _FAULT_RESET_S
        )

    def _update(self, k: int, axis: AxisLoop, cycle: int, state: LoopState, running_s: float) -> str | None:
        """Compute one axis. A mistake of ours is a fault like any other: no torque, and the axis is stopped."""
        command, part, fault = self._commands[k], self._parts[k], None
        if not self._is_broken[k]:
            try:
                return axis.update(cycle, state, running_s, self._feedback[k], command, part)
            except Exception as error:  # noqa: BLE001 - whatever it is, the machine must come to rest
                self._is_broken[k] = True
                fault = f"{axis.name}: the computation failed: {type(error).__name__}: {error}"
        command.torque = command.velocity = 0.0
        part.fill(math.nan)
        part[_TIME], part[_CYCLE] = cycle * self._settings.period_s, cycle
        return fault

    def _is_standing(self, k: int, axis: AxisLoop) -> bool:
        if not self._is_broken[k]:
            return axis.is_standing
        feedback = self._feedback[k]
        return feedback.is_fresh and abs(feedback.velocity) <= axis.standstill

    def _advance(self, cycle: int, time_s: float) -> None:
        """Take the run one step on, if it is due."""
        if not math.isnan(self._running_since_s) and time_s - self._running_since_s >= self._settings.duration_s:
            self._stop.is_requested = True
        if self._settings.dry_run and time_s >= self._settings.duration_s:
            self._stop.is_requested = True
        states = [feedback.state for feedback in self._feedback]
        facts = Facts(
            is_stop_requested=self._stop.is_requested,
            has_fault=bool(self.result.faults),
            is_enabled=all(state is DriveState.OPERATION_ENABLED for state in states),
            is_powered=any(state.is_powered for state in states),
            is_setpoint_standing=self._path_time.is_standing(time_s - self._settings.period_s),
            is_standing=all(self._is_standing(k, axis) for k, axis in enumerate(self._axes)),
            is_faded_out=all(axis.compensator.is_faded_out for axis in self._axes),
        )
        before, told = self._course.state, self._course.fault
        if not self._course.advance(time_s, facts):
            return
        if self._course.fault != told:
            self._give_up(cycle, before)
        if self._course.state is LoopState.ENABLING:
            self._check_exchange(cycle)
        # set-points are sent ahead of time: what has been sent stays true
        later_s = time_s + self._settings.period_s + max(axis.setpoint_delay_s for axis in self._axes)
        if self._course.state is LoopState.RUNNING:
            self._running_since_s = time_s
            for axis in self._axes:
                axis.enter_path()
            self._path_time.start(later_s)
        elif self._course.state is LoopState.STOPPING:
            self._path_time.stop(later_s)
        self._sink.event(cycle, "state", self._course.state.name.lower())

    def _give_up(self, cycle: int, awaited_in: LoopState) -> None:
        """Note for which axes the course waited in vain while it was in a state, and what their drives are in."""
        text = self._course.fault
        late = [k for k, axis in enumerate(self._axes) if self._is_awaited(k, axis, awaited_in)]
        for k in late:
            feedback = self._feedback[k]
            error = f" ({feedback.error})" if feedback.error else ""
            self._fault(cycle, f"{self._axes[k].name}: {text}: the drive is in {feedback.state.words}{error}")
        if not late:  # an axis that comes to rest now and then stands in this very cycle
            self._fault(cycle, text)

    def _is_awaited(self, k: int, axis: AxisLoop, state: LoopState) -> bool:
        """Whether the course stays in ``state`` because of this axis."""
        if state is LoopState.ENABLING:
            return self._feedback[k].state is not DriveState.OPERATION_ENABLED
        if state is LoopState.DISABLING:
            return self._feedback[k].state.is_powered
        return not self._is_standing(k, axis)

    def _fault(self, cycle: int, text: str) -> None:
        """Note a fault, once."""
        if text not in self.result.faults and len(self.result.faults) < 20:
            self.result.faults.append(text)
            self._sink.event(cycle, "fault", text)

    def _check_exchange(self, cycle: int) -> None:
        """See whether feedback and command go between two deadlines, by the idle cycles (in motion, misses count)."""
        typical_us = float(np.median(self._idle_exchanges_us))
        period_us = 1e6 * self._settings.period_s
        if typical_us > period_us:
            self._warn(
                cycle,
                f"feedback and command take {typical_us:.0f} us, more than the period of {period_us:.0f} us: torques "
                "act whole periods later than they are computed for; take a longer period_s, a faster bus or fewer "
                "axes",
            )

    def _warn(self, cycle: int, text: str) -> None:
        """Note what the user should know."""
        self.result.warnings.append(text)
        self._sink.event(cycle, "warning", text)

    def _finish(self, cycle: int) -> None:
        """Write zero torque and disable once more whatever happened, leave the bus, sum up."""
        try:
            if not self._settings.dry_run:
                for command in self._commands:
                    command.request, command.torque, command.velocity = Request.DISABLE, 0.0, 0.0
                self._drives.send(self._commands)
        except FrictionHilError as error:
            self._fault(cycle, str(error))
        finally:
            self._drives.close()
        if self.result.cycles:
            self.result.late_p50_us, self.result.late_p99_us = (_percentile(self._late, q) for q in (0.5, 0.99))


def columns_width(axes: Sequence[AxisLoop]) -> int:
    """Numbers in one axis's part of a row: columns of the recording, then the states; equal for all axes."""
    return max(axis.row_width + axis.state_width for axis in axes)


def _percentile(histogram: "np.ndarray[tuple[int], np.dtype[np.int64]]", share: float) -> float:
    """Smallest value, in bins, that at least ``share`` of the samples do not exceed."""
    return float(np.searchsorted(np.cumsum(histogram), share * histogram.sum()))
