"""The cyclic phase: SYNC, feedback of every drive, command to every drive, in one thread."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from friction_hil.drive import Clock, Command, Feedback, Request
from friction_hil_drivers.canopen import codes
from friction_hil_drivers.canopen.connect.listening import MasterAlarm
from friction_hil_drivers.canopen.connect.watchdogs import feeders
from friction_hil_drivers.canopen.cycle.axis import CanopenAxis
from friction_hil_drivers.canopen.cycle.listener import STEPPED_TIMEOUT_S, Listener
from friction_hil_drivers.canopen.stop.heartbeat_lapse import HeartbeatLapse
from friction_hil_drivers.canopen.stop.last_frames import LastFrames, Timer
from friction_hil_drivers.canopen.wire import cia301
from friction_hil_drivers.canopen.wire.queue_full import QueueFullError

if TYPE_CHECKING:
    from friction_hil_drivers.canopen.wire.frames import FrameBus

_COMMAND_FRACTION = 0.25  # of the period, kept for computing and sending what acts from the next SYNC on
_OPERATIONAL = bytes([cia301.NmtState.OPERATIONAL])

_PROBE_CYCLES = 50  # at least, between two cycles without SYNC
_PROBE = "SYNC was left out for a cycle, to see whether TPDOs come late"
_LISTEN = Request.LISTEN
_TO_POWER = (Request.ENABLE, Request.RESET_FAULT)

_STEPPED_RETURN_S = 0.05  # for a drive that is out of reach


class CyclicExchange(Listener):
    """Frames of every cycle between the daemon and its drives.

    ``period_s``: of the cycle. ``heartbeat_s``: period of the daemon's heartbeat, which it sends as node
    ``master_node``. ``dry_run``: SYNC is sent, and nothing else. ``max_missed``: periods after which a command is too
    old to be sent, and missed exchanges in a row that are bridged. ``alarm`` tells of another master that appears.
    """

    __slots__ = (
        "_alarm",
        "_all_unsent",
        "_axes",
        "_cycles_since_probe",
        "_dry_run",
        "_feeders",
        "_has_new_words",
        "_is_alarm_told",
        "_is_commanding",
        "_is_complete",
        "_is_unsent",
        "_lapse",
        "_max_missed",
        "_next_timer_ns",
        "_oldest_ns",
        "_pairs",
        "_reserve_ns",
        "_sampled_ns",
        "_spare",
        "_spare_command",
        "_spare_feedback",
        "_sync_id",
        "_timers",
        "_unsent",
    )

    def __init__(
        self,
        bus: "FrameBus",
        axes: Sequence[CanopenAxis],
        clock: Clock,
        *,
        period_s: float,
        heartbeat_s: float,
        master_node: int,
        dry_run: bool,
        max_missed: int = 10,
        alarm: MasterAlarm | None = None,
        sync_id: int = cia301.SYNC_ID,
    ) -> None:
        super().__init__(bus, clock, [axis.handlers for axis in axes], [axis.answers for axis in axes])
        self._axes = axes
        self._sync_id = sync_id
        self._dry_run = dry_run
        self._reserve_ns = round(_COMMAND_FRACTION * period_s * 1e9)
        self._alarm = alarm or MasterAlarm()
        self._handlers |= self._alarm.handlers
        half_ns = round(0.5e9 * period_s)  # a cycle that comes a little early sends what is due all the same
        base, beat_ns = cia301.HEARTBEAT_BASE, round(heartbeat_s * 1e9) - half_ns
        self._timers = [Timer(base + master_node, _OPERATIONAL, beat_ns)]
        guarded = {axis.node: axis.watch.beat_s for axis in axes if axis.watch.is_guarded}
        self._timers += [
            Timer(base + node, None, round(beat_s * 1e9) - half_ns, node) for node, beat_s in guarded.items()
        ]
        self._next_timer_ns = self._sampled_ns = 0  # the second one: time of the last feedback
        self._feeders = feeders([axis.watch for axis in axes])
        self._pairs = list(zip(axes, self._feeders, strict=True))
        # commanding: from the first command on; before, the loop may pause, and no drive has power
        # new words: a controlword that was sent is not in force yet; complete: every axis has answered every SYNC
        self._is_commanding = self._has_new_words = self._is_complete = self._is_alarm_told = False
        self._max_missed = max_missed
        self._unsent = 0  # cycles in a row in which the bus took no frames
        self._is_unsent = [False] * len(axes)  # the last command to each axis
        self._all_unsent = [True] * len(axes)
        self._oldest_ns = round(max_missed * period_s * 1e9)
        self._cycles_since_probe = 0
        self._lapse = HeartbeatLapse()
        self._spare = axes[0].copy()
        self._spare_feedback, self._spare_command = Feedback(), Command(Request.ENABLE)

    def start(self) -> None:
        """Begin the cyclic phase. The drives watch the daemon from its first command on."""
        now = self._clock.now_ns()
        for axis in self._axes:
            axis.start(now, is_real=self._clock.is_real)

    def receive(self, feedback: Sequence[Feedback], end_ns: int) -> None:
        """Send SYNC and collect all feedback until it is complete, or too late; ``end_ns``: time of the next SYNC.

        ``feedback`` is overwritten, one for each axis.
        """
        frame = self._bus.receive(0.0)
        if frame is not None:
            self._take_waiting(frame)
        now_ns = self._sampled_ns = self._clock.now_ns()
        self._cycles_since_probe += 1
        why_no_sync = _PROBE if not self._is_complete and self._is_probe_due() else self._send_sync()
        for axis in self._axes:
            axis.begin_cycle(now_ns, why_no_sync)
        self._is_complete = self._collect(end_ns - self._reserve_ns)
        if not self._clock.is_real:
            self._require_answers()
        alarm = self._alarm.message
        is_none_taken = bool(why_no_sync)  # drives take RPDOs over at SYNC
        for axis, target, is_unsent in zip(self._axes, feedback, self._is_unsent, strict=True):
            axis.report(target, now_ns)
            target.is_setpoint_lost = is_unsent or is_none_taken
            if alarm and not target.message:
                target.message = alarm
            elif alarm and not self._is_alarm_told:  # beside what it may have caused, e.g. a restart
                target.notices.append(alarm)
        self._is_alarm_told = bool(alarm)

    def _send_sync(self) -> str:
        """Send SYNC, at which drives take over what their RPDOs carried; return why it was not sent, "" if it was."""
        try:
            self._bus.send(self._sync_id, b"")
        except QueueFullError as error:
            return f"SYNC was not sent: {error}"
        if self._has_new_words:
            self._has_new_words = False
            for feeder in self._feeders:
                feeder.taken_over()
        return ""

    def _is_probe_due(self) -> bool:
        """Return True if SYNC is to be left out, to see whether TPDOs are late (see `sync_answers`)."""
        if self._cycles_since_probe < _PROBE_CYCLES or not self._clock.is_real:
            return False
        if not any(axis.answers.is_doubtful for axis in self._axes):
            return False
        self._cycles_since_probe = 0
        return True

    def send(self, commands: Sequence[Command]) -> None:
        """Send one command to each axis, and the daemon's heartbeat when it is due; a dry run sends nothing.

        A drive that RPDOs do not reach is stopped by SDO. Commands that are too old, because the daemon was held up
        after their feedback, are not sent: the next cycle computes new ones.
        """
        now_ns = self._clock.now_ns()
        try:
            if not self._dry_run:
                self._send_commands(commands, now_ns)
            if now_ns >= self._next_timer_ns and self._is_commanding:
                self._feed(now_ns)
        except QueueFullError as error:  # what the drives did not get is a missed exchange
            self._unsent += 1
            if self._unsent > self._max_missed:
                for axis in self._axes:
                    axis.note_unsent(str(error))
        else:
            self._unsent = 0

    def _send_commands(self, commands: Sequence[Command], now_ns: int) -> None:
        """Send the RPDOs of each axis that they reach, and what else is due.

        Before the RPDOs of an axis, its watchdog RPDO is sent when it is due, with the controlword in force.
        """
        age_ns, send = now_ns - self._sampled_ns, self._bus.send
        is_too_old = age_ns > self._oldest_ns and self._clock.is_real
        is_unsent = self._is_unsent
        is_unsent[:] = self._all_unsent  # until it is sent: a full queue may end this before
        for k, ((axis, feeder), command) in enumerate(zip(self._pairs, commands, strict=True)):
            request = command.request
            if request is _LISTEN:
                is_unsent[k] = False
                continue
            self._is_commanding = True
            if is_too_old and request in _TO_POWER:
                axis.note_dropped(age_ns * 1e-6)
                continue
            if axis.is_reachable:
                frames = axis.encode(command)
                if feeder.left > 1:
                    feeder.left -= 1
                elif feeder.can_id and (word := feeder.next()) is not None:
                    send(feeder.can_id, word)
                for can_id, data in frames:
                    send(can_id, data)
                if axis.controlword != feeder.sent:
                    feeder.note(axis.controlword)
                    self._has_new_words = True
            if axis.needs_other_frames:
                for can_id, data in axis.other_frames(request, now_ns):
                    send(can_id, data)
            is_unsent[k] = not axis.is_reachable  # then it has had at most an SDO, which carries no set-point

    def _feed(self, now_ns: int) -> None:
        """Send the heartbeat and the remote frames of node guarding when due, unless the drives are to miss them."""
        for timer in self._timers:
            if now_ns >= timer.next_ns and not self._lapse.is_due(self._axes, now_ns):
                if timer.data is None:
                    self._bus.send_remote(timer.can_id, 1)
                else:
                    self._bus.send(timer.can_id, timer.data)
                timer.next_ns = now_ns + timer.period_ns
        self._next_timer_ns = min(timer.next_ns for timer in self._timers)

    def last_frames(self) -> LastFrames | None:
        """Return what the drives wait for while they are left; None where none has begun to watch, or time stands."""
        if self._dry_run or not self._is_commanding or not self._clock.is_real:
            return None
        return LastFrames(self._axes, self._timers)

    def warm_caches(self) -> None:
        """Decode and encode as in a cycle, on a copy of the first axis; nothing is sent."""
        axis, now = self._spare, self._sampled_ns
        axis.begin_cycle(now)
        for tpdo in axis.drive.tpdos:
            axis.handlers[tpdo.cob_id](bytes(tpdo.layout.size))
        axis.report(self._spare_feedback, now)
        if not self._dry_run:
            axis.encode(self._spare_command)

    def _patience_s(self, axis: int) -> float:
        return STEPPED_TIMEOUT_S if self._axes[axis].is_reachable else _STEPPED_RETURN_S

    def _require_answers(self) -> None:
        """End a run in simulated time whose drives have stopped answering."""
        is_complete = all(axis.answers.is_complete or not axis.is_reachable for axis in self._axes)
        text = "not every drive has answered SYNC for {:g} s: are they still running, and is 1005h of each "
        self._require_frames(is_complete, f"{text}{self._sync_id:03X}h (bus.sync_cob_id)?", codes.SYNC_NOT_ANSWERED)
