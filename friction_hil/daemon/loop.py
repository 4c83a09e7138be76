"""The fixed-period loop: wait, receive, compute, send, record. One thread, nothing that blocks."""

import math
from collections.abc import Sequence

import numpy as np

from friction_hil.daemon.arm import ArmTorques
from friction_hil.daemon.axis import AxisLoop, AxisUpdate
from friction_hil.daemon.control.changes import Changes
from friction_hil.daemon.control.journal import JournalReader
from friction_hil.daemon.failure import Reserve
from friction_hil.daemon.log import LoopResult, RunLog, Sink
from friction_hil.daemon.pacing import CacheWarmer, make_pacer
from friction_hil.daemon.path_hold import PathHold
from friction_hil.daemon.row import AxisRow
from friction_hil.daemon.run import LoopSettings, RunControl
from friction_hil.daemon.safety import LoopState
from friction_hil.daemon.stop import StopRequest
from friction_hil.drive import Clock, Command, Drives, DriveState, Feedback, Request
from friction_hil.drive.codes import FaultCode
from friction_hil.motion.trajectory import PathTime


class Loop:
    """Drive some axes through a run.

    The drives are connected but not started, the axes in the order of theirs. ``path_time`` is that of all axes;
    ``journal`` brings changes while the loop runs. ``arm``: of which some of the axes are joints.
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
        journal: JournalReader | None = None,
        arm: ArmTorques | None = None,
    ) -> None:
        self._drives, self._axes, self._clock, self._sink, self._settings = drives, axes, clock, sink, settings
        self._arm = arm
        self._feedback = [Feedback() for _ in axes]
        self._states_while_disabling = [DriveState.UNKNOWN] * len(axes)
        self._commands = [Command() for _ in axes]
        width = columns_width(axes)
        self._row = np.full(len(axes) * width, math.nan)
        parts = self._row.reshape(len(axes), width)
        self._parts = [AxisRow(part, axis.shadow_names) for part, axis in zip(parts, axes, strict=True)]
        self._log = RunLog(sink, settings.period_s)
        self._run = RunControl(axes, path_time, settings, stop, self._log)
        is_needed = any(axis.motion.stops_without_setpoints for axis in axes) and not settings.is_follower
        self._path = PathHold(path_time, settings.period_s, self._run.setpoint_delay_s, self._log, is_needed=is_needed)
        self._warmer = CacheWarmer(drives, axes[0], self._parts[0])
        self._changes = None if journal is None else Changes(journal, axes, self._log, self._run)
        self.reserve = Reserve()
        self._pacer = make_pacer(drives, clock, settings.period_s, self._warm_caches)

    def run(self) -> LoopResult:
        """Run until the duration is over, a stop is requested, or a fault has been dealt with.

        On return the drives are disabled, as far as they can still be reached. Faults are in the result, and an
        exception, whatever it is, is a fault.
        """
        cycle = 0
        try:
            self._drives.start()
            self._pacer.start()
            while self._run.state is not LoopState.DONE:
                cycle = self._pacer.wait(cycle)
                if self._pacer.skipped and not (self._run.is_idle or self._run.state is LoopState.WAITING):
                    self._log.missed(cycle, self._pacer.skipped, self._pacer.overslept_ns, self._settings.max_missed)
                    self._path.after_missed(cycle, self._run.state, self._pacer.skipped)
                self._cycle(cycle)
                cycle += 1
        except Exception as error:  # noqa: BLE001 - whatever it is, the drives must be stopped
            self._fail(cycle, error)
        finally:
            self._finish(cycle)
        return self._log.result

    def _fail(self, cycle: int, error: Exception) -> None:
        """Keep an exception as a fault, with room to go on where it was for want of memory."""
        self.reserve.release()
        self._log.failure(cycle, error)

    def _cycle(self, cycle: int) -> None:
        """Run one period: feedback in, commands out, a row to the recording, and on to the next state."""
        time_s, began_ns = cycle * self._settings.period_s, self._clock.now_ns()
        self._drives.receive(self._feedback, self._pacer.end_ns(cycle))
        if not self._run.begin(self._feedback, time_s):
            return
        for feedback in self._feedback:  # quicker than `any` of a generator, as below
            if feedback.is_setpoint_lost:
                self._path.after_lost(cycle, self._run.state)
                break
        if self._changes is not None and self._changes.journal.has_news:
            self._changes.take(cycle, self._run.running_s(time_s), self._feedback)
        self._note_states(cycle)
        updates = self._update_axes(cycle, self._run.state, self._run.running_s(time_s))
        self._drives.send(self._commands)
        exchange_us = (self._clock.now_ns() - began_ns) * 1e-3
        path_lag_s = math.nan if self._settings.is_follower else self._path.lag_s(time_s, self._run.state)
        change = 0.0 if self._changes is None else self._changes.last
        for part in self._parts:
            part.write_timing(self._pacer.late_us, exchange_us, path_lag_s, change)
        self._sink.push(self._row)
        self._log.result.cycles += 1
        self._run.advance(cycle, self._feedback, updates, exchange_us)

    def _update_axes(self, cycle: int, state: LoopState, running_s: float) -> list[AxisUpdate]:
        """Compute all axes and fill their commands; a fault of one of them changes the requests to all."""
        updates, is_covered, time_s = [], [], cycle * self._settings.period_s
        requests, log = self._run.requests, self._log
        if self._arm is not None and (text := self._arm.update(cycle, state, self._feedback)):
            log.fault(cycle, text)
        for index, axis in enumerate(self._axes):
            feedback = self._feedback[index]
            update = axis.update(cycle, state, running_s, feedback, self._commands[index], self._parts[index])
            updates.append(update)
            has_fault = update.fault is not None
            # what `--reset-fault` covers is the drive's: a computation that failed is not
            is_reset = not axis.is_broken and requests.covers(index, feedback, state, time_s, has_fault=has_fault)
            is_covered.append(is_reset)
            if update.warning is not None:
                log.warn(cycle, update.warning)
            if (text := axis.following.take_error_without()) is not None:
                log.error_without(cycle, axis.name, text)
            # while the run waits there is no power, and nothing has to be stopped
            if update.fault is not None and not is_reset and state is not LoopState.WAITING:
                log.fault(cycle, update.fault, axis.gaps.before(cycle))
        requests.fill(self._commands, self._feedback, is_covered, state, time_s, has_fault=log.has_fault)
        return updates

    def _note_states(self, cycle: int) -> None:
        """Record what the drives said beside their feedback; keep the states to which they were disabled."""
        state = self._run.state
        if state is LoopState.ENABLING:
            for k in range(len(self._feedback)):
                self._states_while_disabling[k] = DriveState.UNKNOWN  # those of an earlier stop prove nothing any more
        elif state is LoopState.DISABLING or state is LoopState.WAITING:
            for k, feedback in enumerate(self._feedback):
                if feedback.is_fresh or not feedback.state.is_powered:
                    self._states_while_disabling[k] = feedback.state
        for k, feedback in enumerate(self._feedback):
            if feedback.notices:
                for text in feedback.notices:
                    self._log.notice(cycle, f"{self._axes[k].name}: {text}")
                feedback.notices.clear()

    def _warm_caches(self, cycle: int) -> None:
        """Warm the caches for ``cycle``; an exception is a fault, as it would be in the cycle itself."""
        if self._warmer.error is None and (error := self._warmer.warm(cycle)):
            self._log.fault(cycle, FaultCode.WARMING_FAILED.append_to(f"warming the caches failed: {error}"))

    def _finish(self, cycle: int) -> None:
        """Send zero torque and disable once more whatever happened, leave the bus, sum up."""
        self.reserve.release()  # what follows, up to the summary of the command, must not fail for want of memory
        try:
            if not self._settings.dry_run:
                for command in self._commands:
                    command.request, command.torque, command.velocity = Request.DISABLE, 0.0, 0.0
                self._drives.send(self._commands)
        except Exception as error:  # noqa: BLE001 - the bus must be left all the same
            self._fail(cycle, error)
        finally:
            self._close(cycle)
        result = self._log.result
        if result.cycles:
            result.late_p50_us, result.late_p99_us = (self._pacer.late_percentile_us(part) for part in (0.5, 0.99))

    def _close(self, cycle: int) -> None:
        """Leave the bus, and keep the states in which the drives were left."""
        read_back: Sequence[DriveState] | None
        try:
            read_back = self._drives.close()
        except Exception as error:  # noqa: BLE001 - the states of the drives are to be reported
            read_back = [DriveState.UNKNOWN] * len(self._axes)
            self._fail(cycle, error)
        for text in self._drives.leftovers:
            self._log.leftover(cycle, text)
        if self._settings.dry_run or not self._run.requests.is_commanded:
            return
        states = self._states_while_disabling if read_back is None else read_back
        for axis, state in zip(self._axes, states, strict=True):
            self._log.drive_state(cycle, axis.name, state, is_read_back=read_back is not None)


def columns_width(axes: Sequence[AxisLoop]) -> int:
    """Return the number of values in one axis's part of a row: columns, then states; equal for all axes."""
    return max(axis.row_width for axis in axes)
