"""The cyclic phase of a sidecar: listen to another controller's SYNC and its drives, send torque offsets."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from friction_hil.drive import Clock, Command, FaultCode, Feedback
from friction_hil.drive.codes import coded
from friction_hil.drive.phase_lock import PhaseLock
from friction_hil.errors import BusError
from friction_hil_drivers.canopen import codes
from friction_hil_drivers.canopen.connect.heard_pdos import wrong_period
from friction_hil_drivers.canopen.cycle.listener import STEPPED_TIMEOUT_S, Listener
from friction_hil_drivers.canopen.sidecar.axis import SidecarAxis
from friction_hil_drivers.canopen.wire import cia301
from friction_hil_drivers.canopen.wire.queue_full import QueueFullError
from friction_hil_drivers.cia402 import objects

if TYPE_CHECKING:
    from friction_hil_drivers.canopen.wire.frames import FrameBus

_WINDOW = 0.5  # of the period: SYNC is waited for until this long after it is expected
_TPDO_FRACTION = 0.25  # of the period, kept for computing and sending
_LATE_TO_CAPTURE = 3  # SYNCs outside of the window in a row
_INTERVALS = 50  # between SYNCs by whose median the period is judged
_EXTRA_WEIGHT, _EXTRA_LIMIT = 20, 200  # a SYNC too many weighs 20 cycles: 10 of them in quick succession are a fault
_OPERATIONAL = bytes([cia301.NmtState.OPERATIONAL])


class SidecarExchange(Listener):
    """Frames of every cycle. Nothing is sent but torque offsets, and a heartbeat if one is configured.

    ``lock``: fed with the stamps of SYNC; not used in simulated time. ``max_missed``: successive SYNCs that may be
    missing. ``heartbeat``: node number and period, s, of the daemon's heartbeat.
    """

    def __init__(
        self,
        bus: "FrameBus",
        axes: Sequence[SidecarAxis],
        clock: Clock,
        lock: PhaseLock,
        *,
        period_s: float,
        sync_id: int,
        max_missed: int,
        heartbeat: tuple[int, float] | None,
        dry_run: bool,
    ) -> None:
        handlers, sets = [axis.handlers for axis in axes], [axis.feedback for axis in axes]
        super().__init__(bus, clock, handlers, sets, next_id=sync_id)
        self._axes, self._lock = axes, lock
        self._period_ns = round(period_s * 1e9)
        self._sync_id = sync_id
        self._max_missed = max_missed
        self._heartbeat = heartbeat
        self._next_heartbeat_ns = 0
        self._dry_run = dry_run
        self._cycle = -1
        self._missed = 0  # SYNCs in a row
        self._late = 0  # cycles in a row in which SYNC came outside of its window
        self._heard, self._elapsed = 0, 1  # SYNCs heard in this cycle, periods since the one before
        self._stamp: int | None = None  # of the SYNC before, where its time is known
        self._intervals: list[int] = []  # between successive SYNCs
        self._extra = 0  # SYNCs too many, weighted; falls by one in each cycle
        self._message = ""  # the first fault of SYNC
        self._unsent = 0  # cycles in a row
        self._spare = axes[0].copy()
        self._spare_feedback = Feedback()

    def start(self) -> None:
        """Begin the cyclic phase: what was sent before counts no more."""
        while self._bus.receive(0.0) is not None:
            pass

    def receive(self, feedback: Sequence[Feedback], end_ns: int) -> None:
        """Wait for SYNC and collect what follows it, until it is complete or too late for this cycle.

        ``feedback`` is overwritten, one for each axis. ``end_ns``: when the next cycle begins.
        """
        if self._clock.is_real:
            has_sync = self._await_sync(end_ns)
            self._count_missed(has_sync)
            self._collect(end_ns - round(_TPDO_FRACTION * self._period_ns))
        else:
            self._step()
        for axis, target in zip(self._axes, feedback, strict=True):
            axis.report(target, self._cycle)
            target.message = target.message or self._message
            target.is_setpoint_lost = self._unsent > 0

    def send(self, commands: Sequence[Command]) -> None:
        """Send the torque offset of each axis, and the heartbeat when it is due; a dry run sends nothing."""
        if self._dry_run:
            return
        try:
            self._send(commands)
        except QueueFullError:  # bridged as a missed SYNC is: the queue empties once the bus is free again
            self._unsent += 1
            if self._unsent > self._max_missed:
                raise
        else:
            self._unsent = 0

    def _send(self, commands: Sequence[Command]) -> None:
        for axis, command in zip(self._axes, commands, strict=True):
            self._bus.send(*axis.encode(command.torque))
        if self._heartbeat is not None and (now := self._clock.now_ns()) >= self._next_heartbeat_ns:
            node, period_s = self._heartbeat
            self._bus.send(cia301.HEARTBEAT_BASE + node, _OPERATIONAL)
            self._next_heartbeat_ns = now + round(period_s * 1e9)

    def send_zero(self) -> list[str]:
        """Send a last torque offset of zero to each axis; return which drives may not have taken it, and why.

        Nothing is read back by SDO: another controller may be asking the same server. A drive whose TPDOs come is in
        Operational, where it takes RPDOs.
        """
        left = []
        for axis in () if self._dry_run else self._axes:
            why = axis.why_out_of_reach(self._max_missed)
            try:
                self._bus.send(*axis.encode(0.0))
            except BusError as error:
                why = error.detail
            if why:
                text = f"{axis.facts.name}: {objects.TORQUE_OFFSET} may hold the last offset and not 0: {why}"
                left.append(FaultCode.TORQUE_LEFT.append_to(text))
        return left

    def warm_caches(self) -> None:
        """Decode and encode as in a cycle, on a copy of the first axis; nothing is sent."""
        axis = self._spare
        axis.begin_cycle()
        for can_id, size in axis.sizes.items():
            axis.handlers[can_id](bytes(size))
        axis.report(self._spare_feedback, self._cycle)
        axis.encode(0.0)

    # SYNC in real time

    def _await_sync(self, end_ns: int) -> bool:
        """Begin the cycle at its SYNC, or where SYNC should have come; return True if it came."""
        clock, lock, period_ns = self._clock, self._lock, self._period_ns
        was_missing = self._missed > 0
        # the pacer counts cycles by the same lock: this one ends shortly before the next SYNC
        cycle = lock.cycle_at(end_ns - period_ns // 2)
        self._elapsed, self._cycle = max(cycle - self._cycle, 1), cycle
        self._heard = waiting = self._take_syncs()
        if was_missing and waiting:
            waiting -= 1  # the SYNC before came too late
            self._late += 1
        elif 0 < waiting < self._elapsed and clock.now_ns() < lock.sync_ns(cycle):
            waiting = 0  # those of the periods that the loop missed; this cycle's is still to come
        if self._late >= _LATE_TO_CAPTURE:
            return self._capture(cycle)
        if waiting:
            now = clock.now_ns()
            if now < lock.sync_ns(cycle):  # it came even before that
                lock.take(cycle, now)
            return True
        window_ns = lock.sync_ns(cycle) + round(_WINDOW * period_ns)
        stamp = self._wait_for_sync(window_ns)
        if stamp is None:
            self._begin_cycle()
            return False
        lock.take(cycle, stamp)
        self._late = 0
        return True

    def _capture(self, cycle: int) -> bool:
        """Take the phase of the next SYNC: the other clock has jumped."""
        stamp = self._wait_for_sync(self._clock.now_ns() + 3 * self._period_ns // 2)
        self._late = 0
        if stamp is None:
            self._begin_cycle()
            return False
        self._lock.capture(cycle, stamp)
        return True

    def _take_syncs(self) -> int:
        """Take the frames that have arrived; return the number of SYNCs among them. The last one begins the cycle."""
        count = int(self._has_next)
        if self._has_next:
            self._has_next = False
            self._begin_cycle()
        while (frame := self._bus.receive(0.0)) is not None:
            if frame[0] == self._sync_id:
                count += 1
                self._stamp = None  # when it came is not known
                self._begin_cycle()
            else:
                self._take(*frame)
        return count

    def _wait_for_sync(self, deadline_ns: int) -> int | None:
        """Wait for SYNC, begin the cycle with it and return its time, ns; None if it did not come."""
        clock = self._clock
        while (left := deadline_ns - clock.now_ns()) > 0:
            frame = self._bus.receive(left * 1e-9)
            if frame is None:
                continue
            if frame[0] == self._sync_id:
                stamp = clock.now_ns()
                if self._stamp is not None:
                    self._intervals.append(stamp - self._stamp)
                self._stamp = stamp
                self._heard += 1
                self._begin_cycle()
                return stamp
            self._take(*frame)
        return None

    def _begin_cycle(self) -> None:
        has_early = not self._clock.is_real
        for axis in self._axes:
            axis.begin_cycle(has_early=has_early)

    def _count_missed(self, has_sync: bool) -> None:
        self._missed = 0 if has_sync else self._missed + 1
        # a master that was held up sends fewer at first, and then as many more
        extra = self._extra + _EXTRA_WEIGHT * (self._heard - self._elapsed)
        if extra > 0:
            extra -= 1
        self._extra = max(extra, -_EXTRA_WEIGHT * self._max_missed)
        if self._message:
            return
        if self._missed > self._max_missed:
            text = f"SYNC ({self._sync_id:03X}h) did not come for {self._missed} periods: has its master stopped?"
            self._message = coded(text, codes.SYNC_LOST)
        elif self._extra >= _EXTRA_LIMIT:
            text = f"SYNC ({self._sync_id:03X}h) comes more than once a period: two controllers send it"
            self._message = coded(text, codes.SYNC_LOST)
        elif len(self._intervals) >= _INTERVALS:
            if problem := wrong_period(self._intervals, 1e-9 * self._period_ns):
                self._message = coded(f"SYNC ({self._sync_id:03X}h) {problem}", codes.SYNC_LOST)
            self._intervals.clear()

    # SYNC in simulated time

    def _step(self) -> None:
        """Take frames up to the next SYNC, then those that follow it; another SYNC ends the cycle incomplete."""
        text = f"SYNC ({self._sync_id:03X}h) or its answers have not come for {{:g}} s: has its master ended?"
        self._cycle += 1
        while not self._has_next:
            frame = self._bus.receive(STEPPED_TIMEOUT_S)
            if frame is None:
                self._require_frames(False, text, codes.SYNC_LOST)
            elif frame[0] == self._sync_id:
                self._has_next = True
            else:
                self._take(*frame)
        self._has_next = False
        self._begin_cycle()
        self._collect(0)
        is_complete = all(axis.feedback.is_complete for axis in self._axes)
        self._require_frames(is_complete or self._has_next, text, codes.SYNC_LOST)
