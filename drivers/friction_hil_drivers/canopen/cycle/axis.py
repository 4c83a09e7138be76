"""One drive in the cyclic phase: what it last reported, and what it is commanded. No bus, no clock.

A cycle is `begin_cycle`, the frames through `handlers`, `report`, then `encode` and `other_frames`, in this order.
"""

from collections.abc import Callable, Mapping

from friction_hil.drive import Command, DriveState, Feedback, Request
from friction_hil.drive.codes import coded
from friction_hil.drive.stop import STANDSTILL_NS
from friction_hil.errors import DriveError
from friction_hil_drivers.canopen import codes
from friction_hil_drivers.canopen.connect.configure import ConfiguredDrive
from friction_hil_drivers.canopen.connect.mapping import MappedPdo
from friction_hil_drivers.canopen.connect.twins import TwinWatch
from friction_hil_drivers.canopen.cycle.monitor import NodeCondition, NodeMonitor
from friction_hil_drivers.canopen.cycle.side_channel import CyclicSdo
from friction_hil_drivers.canopen.cycle.sync_answers import SyncAnswers
from friction_hil_drivers.canopen.stop.by_sdo import STANDSTILL_COUNTS
from friction_hil_drivers.canopen.wire import cia301
from friction_hil_drivers.canopen.wire.cia301 import Frame, decode_heartbeat
from friction_hil_drivers.cia402 import profile
from friction_hil_drivers.cia402.codec import CommandEncoder, FeedbackDecoder, Measurement
from friction_hil_drivers.cia402.load_encoder import LoadEncoder
from friction_hil_drivers.cia402.notices import Notices
from friction_hil_drivers.cia402.profile import emergency_code
from friction_hil_drivers.cia402.temperature import MappedTemperature, TemperatureRead

Handler = Callable[[bytes], None]  # takes the data of a frame

_STALE_CYCLES = 2  # without feedback after which no controlword follows from the state that was reported last
_LARGEST_STEP = 1 << 30  # of the position counter in a cycle; the counter is not followed further than that
_BLIND_CYCLES = 10  # without feedback after which a stop is confirmed by SDO
_NMT_START_NS = 50_000_000  # between two attempts to bring a node back to Operational
_STANDSTILL_PER_S = 0.01  # rad/s (m/s) that counts as standstill where a stop is watched by SDO
_IN_FAULT = (DriveState.FAULT, DriveState.FAULT_REACTION_ACTIVE)
_GOOD = NodeCondition.GOOD
_OPERATION_ENABLED = DriveState.OPERATION_ENABLED


class CanopenAxis:
    """State of one drive from cycle to cycle.

    Parameters
    ----------
    drive : ConfiguredDrive
        Result of the configuration.
    node : int
        Node number of the drive.
    heartbeat_s : float
        Period of the drive's heartbeat, s; three missing ones are a loss.

    Attributes
    ----------
    handlers : mapping of int to callable
        By identifier: takes the data of a frame of this drive.
    is_complete : bool
        Every TPDO of this cycle arrived, and none of an earlier one is missing.
    is_reachable : bool
        RPDOs have an effect. Nothing but SDO and NMT is sent to a node for which this is false: it restarted, left
        Operational, or has been silent for the time of three heartbeats.
    needs_other_frames : bool
        `other_frames` may have something to send; as of the last `report`.
    controlword : int
        Controlword that was encoded last.
    """

    # every cycle runs through these: with a __dict__ of that size, attributes would take twice as long
    __slots__ = (
        "_answers",
        "_arrived",
        "_asked",
        "_comes_late",
        "_decoder",
        "_drive",
        "_encoder",
        "_error",
        "_every_tpdo",
        "_frames",
        "_heard_ns",
        "_heartbeat_s",
        "_is_commanded",
        "_is_plain",
        "_is_reported",
        "_left_ns",
        "_load",
        "_mapped_temperature",
        "_measured",
        "_message",
        "_missed",
        "_mode",
        "_monitor",
        "_nmt_start_ns",
        "_notices",
        "_now_ns",
        "_sdo",
        "_short",
        "_state",
        "_status",
        "_temperature",
        "_twin",
        "_waits_for_older",
        "_why_no_sync",
        "controlword",
        "drive",
        "facts",
        "handlers",
        "is_complete",
        "is_reachable",
        "needs_other_frames",
        "node",
        "tpdos",
        "watch",
    )

    def __init__(self, drive: ConfiguredDrive, node: int, heartbeat_s: float) -> None:
        self._drive = self.drive = drive
        self._heartbeat_s = heartbeat_s
        self.facts = drive.facts
        self.node = node
        self.tpdos = drive.tpdos
        self.watch = drive.watch
        self._monitor = NodeMonitor(node, heartbeat_s)
        self._answers = SyncAnswers(len(drive.tpdos))
        moved = 1e-9 * STANDSTILL_NS * _STANDSTILL_PER_S * abs(drive.units.counts_per_unit)
        self._load = None if drive.load_encoder is None else LoadEncoder(drive.tpdos, drive.load_encoder)
        temperature = drive.temperature
        self._mapped_temperature: MappedTemperature | None = None
        if temperature is not None and any(temperature.entry in pdo.entries for pdo in drive.tpdos):
            self._mapped_temperature = MappedTemperature(drive.tpdos, temperature)
            temperature = None
        self._temperature = TemperatureRead(temperature, drive.first_temperature)
        self._sdo = CyclicSdo(node, max(STANDSTILL_COUNTS, moved), drive.axis_number, self._temperature)
        self._notices = Notices()
        self._now_ns = self._heard_ns = self._left_ns = self._nmt_start_ns = 0
        self._decoder = FeedbackDecoder(drive.tpdos, drive.units, drive.mode, drive.period_s)
        self._encoder = CommandEncoder({pdo.cob_id: pdo for pdo in drive.rpdos}, drive.mode, drive.units)
        self._mode = int(drive.mode)
        self._is_commanded = bool(drive.rpdos)
        self._frames = [b""] * len(drive.tpdos)  # last data of each TPDO
        self._arrived = 0  # TPDOs of this cycle: bit n for TPDO n
        self._every_tpdo = (1 << len(drive.tpdos)) - 1
        self.is_complete = False
        self.is_reachable = True
        self.needs_other_frames = False
        self._twin = TwinWatch(node)
        self._is_plain = False  # TPDOs of this cycle are not counted in `_answers`, as long as each comes once
        self._is_reported = False  # the feedback of this cycle is closed
        self._why_no_sync = ""
        self._waits_for_older = True
        self._short = ""  # a TPDO of this cycle had too few bytes
        self._comes_late = False  # TPDOs of the cycle before arrived after its end
        self._missed = 0  # cycles in a row without feedback
        self._measured = Measurement()  # of the last complete cycle
        self._error = drive.error
        self._message = ""
        self._status = ""  # statusword of a drive that is not enabled, in words
        self.controlword = profile.DISABLE_VOLTAGE
        # the controlword follows from these alone, as long as the request is not to reset a fault
        self._state: DriveState | None = None
        self._asked: Request | None = None
        self.handlers = self._make_handlers()

    def _make_handlers(self) -> Mapping[int, Handler]:
        handlers = {pdo.cob_id: self._tpdo_handler(number, pdo.layout.size) for number, pdo in enumerate(self.tpdos)}
        handlers[cia301.EMERGENCY_BASE + self.node] = self._on_emergency
        handlers[cia301.HEARTBEAT_BASE + self.node] = self._on_heartbeat
        handlers[cia301.SDO_RESPONSE_BASE + self.node] = self._on_sdo
        return handlers

    @property
    def pdos(self) -> tuple[MappedPdo, ...]:
        """All PDOs of a cycle."""
        return (*self.tpdos, *self._drive.rpdos)

    @property
    def state(self) -> DriveState:
        """State of the drive; UNKNOWN if neither TPDOs nor SDO tell it."""
        read = self._sdo.stop.state if self._sdo.is_stopping else DriveState.UNKNOWN
        if not self.is_reachable or (self._missed and read is not DriveState.UNKNOWN):
            return read
        return self._measured.state

    @property
    def is_proved_unpowered(self) -> bool:
        """True if the drive has reported, a moment ago, that it has no power."""
        if self._sdo.is_stopping and self._sdo.stop.is_proved:
            return True
        return self.is_reachable and self._missed <= _BLIND_CYCLES and self._measured.state.is_unpowered

    @property
    def fresh_state(self) -> DriveState:
        """State that the TPDOs of the last cycle have shown, UNKNOWN if these did not come."""
        return self._measured.state if self.is_reachable and not self._missed else DriveState.UNKNOWN

    @property
    def is_doubtful(self) -> bool:
        """True if only a cycle without SYNC shows whether the TPDOs are those of the last SYNC."""
        return self._answers.is_doubtful

    def idle_frames(self, controlword: int, counts: int) -> list[Frame]:
        """Return the RPDOs with a controlword, the position ``counts`` as target, and neither velocity nor torque."""
        command = Command(position=counts / self._drive.units.counts_per_unit)
        return self._encoder.encode(controlword, command)

    def disabling_frames(self) -> list[Frame]:
        """Return what keeps the timer of the drive's event-driven RPDO from running out, and disables the drive."""
        if self.watch.rpdo_id:
            return [(self.watch.rpdo_id, profile.DISABLE_VOLTAGE.to_bytes(2, "little"))]
        return self.idle_frames(profile.DISABLE_VOLTAGE, self._measured.counts or 0)

    def copy(self) -> "CanopenAxis":
        """Return another axis for the same drive, as it was before its first cycle."""
        return CanopenAxis(self._drive, self.node, self._heartbeat_s)

    def start(self, now_ns: int, *, is_real: bool = True) -> None:
        """Begin the cyclic phase; in simulated time no TPDO comes late, and one that is lost is not waited for."""
        self._now_ns = self._heard_ns = now_ns
        self._waits_for_older = is_real
        self._temperature.start(now_ns)

    def begin_cycle(self, now_ns: int, why_no_sync: str = "") -> None:
        """Forget the TPDOs that arrived before this cycle; ``why_no_sync`` is the reason for one without SYNC."""
        self._now_ns = now_ns
        if self._twin.is_suspected and (fault := self._twin.judge()):
            self._note_fault(fault)
        if self._is_plain and not self.is_complete:
            self._count_answers()
        self._arrived = 0
        self._is_plain = not why_no_sync and (self._is_plain or self._answers.is_settled)
        if not self._is_plain:
            self._answers.begin_cycle(has_sync=not why_no_sync)
        self._why_no_sync = why_no_sync
        self._short = ""
        self.is_complete = self._is_reported = False

    # Frames of the node

    def _count_answers(self) -> None:
        """Count this cycle in `_answers`, which is needed once a TPDO is missing."""
        self._is_plain = False
        self._answers.begin_cycle(has_sync=True)
        for number in range(len(self.tpdos)):
            if self._arrived >> number & 1:
                self._answers.take(number)

    def _tpdo_handler(self, number: int, size: int) -> Handler:
        """Return what takes a TPDO; a closure is called faster than a partial."""
        bit = 1 << number

        def take(data: bytes) -> None:
            if self._is_plain and len(data) == size:
                if self._arrived & bit:  # it has answered the last SYNC already
                    self._twin.take(f"TPDO {number + 1}")
                    return
            elif not self._is_counted(number, size, data):
                return
            self._comes_late = self._is_reported
            self._frames[number] = data  # the last one, if older ones came in this cycle too
            arrived = self._arrived = self._arrived | bit
            if arrived == self._every_tpdo:
                self.is_complete = self._is_plain or not (self._answers.open and self._waits_for_older)

        return take

    def _is_counted(self, number: int, size: int, data: bytes) -> bool:
        """Count a TPDO; return True if it answers a SYNC and can be decoded."""
        if self._is_plain:
            self._count_answers()
        is_too_short = len(data) != size and self._is_too_short(number, size, data)
        if self._answers.take(number):
            return not is_too_short
        self._twin.take(f"TPDO {number + 1}")
        return False

    def _is_too_short(self, number: int, size: int, data: bytes) -> bool:
        """Tell of a TPDO that has not the bytes of its mapping; return True if it has too few."""
        text = f"TPDO {number + 1} of node {self.node} has {len(data)} bytes instead of {size}"
        self._notices.add(coded(text, codes.PDO_LENGTH))
        if len(data) >= size:
            return False
        self._short = text
        return True

    def _on_emergency(self, data: bytes) -> None:
        self._notices.take_emergency(data)
        if code := emergency_code(data):  # 0000h does not say why the drive was in fault
            self._error = profile.error_text(code)

    def _on_heartbeat(self, data: bytes) -> None:
        state = decode_heartbeat(data)
        if state is not None and (fault := self._monitor.take(state, self._now_ns)):
            self._left_ns = self._now_ns
            if self._monitor.condition is NodeCondition.RESTARTED:
                self._twin.booted(is_answering=not self._missed and self._measured.counts is not None)
                self._measured = self._measured._replace(state=DriveState.UNKNOWN)
                self._sdo.end_stop()  # what was read before the restart does not count
            self._note_fault(fault)

    def _on_sdo(self, data: bytes) -> None:
        self._sdo.take(data, self._now_ns)

    def _note_fault(self, fault: str) -> None:
        """Keep the first fault, which is the cause; tell those that follow."""
        if not self._message:
            self._message = fault
        elif fault != self._message:
            self._notices.add(fault)

    # Feedback

    def report(self, feedback: Feedback, now_ns: int) -> None:
        """Write the drive's feedback; without all TPDOs the values stay those of the last complete cycle."""
        if self._is_plain and not self.is_complete:
            self._count_answers()
        is_fresh = self.is_complete or self._is_usable()
        self._is_reported = True
        if is_fresh:
            self._take_measurement(now_ns)
        else:
            self._missed += 1
        monitor = self._monitor
        if fault := monitor.check(now_ns):
            self._note_fault(fault)
        if not is_fresh:
            self._twin.missed()
        elif monitor.condition is not _GOOD and self._left_ns < self._now_ns:
            if fault := self._twin.answered():
                monitor.is_another()
                self._note_fault(fault)
            monitor.answered()  # a node sends synchronous TPDOs in Operational only
        is_reachable = monitor.condition is _GOOD and (is_fresh or now_ns - self._heard_ns <= monitor.patience_ns)
        self.is_reachable = is_reachable
        state, _, feedback.position, feedback.velocity, feedback.torque, _, _ = self._measured
        feedback.is_fresh = is_fresh
        if self._load is not None:
            feedback.load_position = self._load.position
        is_asking = self._sdo.is_stopping or self._sdo.error_code.attempts_left > 0
        if is_fresh and is_reachable:
            feedback.state, feedback.missing = state, ""
            self.needs_other_frames = is_asking or now_ns >= self._temperature.due_ns
        else:
            feedback.state, feedback.missing = self.state, "" if is_fresh else self._missing()
            self.needs_other_frames = is_asking or not is_reachable or self._missed > _BLIND_CYCLES
        feedback.error, feedback.status = self._error, self._status
        feedback.message = self._message
        is_over = is_fresh and is_reachable and self._asked is Request.DISABLE and not state.is_powered
        if self._message and is_over and not self._twin.is_found:
            self._message = ""  # it was reported and is over: a daemon that waits may start the drive again
        feedback.is_reachable = is_reachable
        feedback.temperature = self._temperature.value
        if self._temperature.notice:
            self._notices.add(self._temperature.notice)
            self._temperature.notice = ""
        if self._notices.waiting:
            feedback.notices += self._notices.waiting
            self._notices.waiting.clear()

    def _is_usable(self) -> bool:
        """True if every TPDO came; those of an earlier SYNC, as far as that is known, do not count."""
        return self._arrived == self._every_tpdo and not self._answers.is_late and not self._why_no_sync

    def _take_measurement(self, now_ns: int) -> None:
        """Decode the TPDOs of this cycle."""
        if self._load is not None:
            self._load.take(self._frames)
        if self._mapped_temperature is not None:
            self._temperature.value = self._mapped_temperature.take(self._frames)
        before = self._measured
        measured = self._decoder.decode(self._frames, before, (now_ns - self._heard_ns) * 1e-9)
        state_before, was, _, _, _, _, statusword_before = before
        state, now, _, _, _, mode, statusword = measured
        if was is not None and now is not None and not -_LARGEST_STEP <= now - was <= _LARGEST_STEP:
            measured = measured._replace(counts=was)  # the counter is followed from where it was
        self._measured = measured
        self._missed, self._heard_ns = 0, now_ns
        if statusword != statusword_before or state is not state_before:
            self._take_statusword(measured, before)
        if state is _OPERATION_ENABLED:
            if mode != self._mode and self._is_commanded:
                self._note_fault(self._wrong_mode(mode))
        elif state in _IN_FAULT:
            self._take_error_code()

    def _take_statusword(self, measured: Measurement, before: Measurement) -> None:
        """React to a statusword that has changed."""
        if measured.state is not before.state:
            self._change_state(measured.state)
        is_enabled = measured.state is _OPERATION_ENABLED
        self._status = "" if is_enabled else profile.status_words(measured.statusword)
        self._notices.take_statusword(measured.statusword, is_enabled=is_enabled)

    def _change_state(self, state: DriveState) -> None:
        """React to a new state: the reason of a fault is read, and forgotten once the drive is enabled."""
        if state is DriveState.OPERATION_ENABLED:
            self._error = ""
        elif state in _IN_FAULT and not self._error and self._drive.rpdos:
            self._sdo.error_code.begin()

    def _take_error_code(self) -> None:
        """Take 603Fh where no emergency message told the reason."""
        if not self._error and (code := self._sdo.error_code.code):
            self._error = profile.error_text(code)

    # Commands

    def encode(self, command: Command) -> list[Frame]:
        """Encode a command for the drive's RPDOs.

        Raises
        ------
        ValueError
            A value is not finite.
        DriveError
            The axis is only listened to.
        """
        if not self._is_commanded:
            raise DriveError(f"{self.facts.name}: a drive that is only listened to gets no command")
        if command.request is not self._asked or self._measured.state is not self._state or self._missed:
            self.controlword = self._next_controlword(command.request)
        return self._encoder.encode(self.controlword, command)

    def _next_controlword(self, request: Request) -> int:
        """Return the controlword for a request; to stop, none follows from a state that is not known any more."""
        self._asked = None
        if self._missed > _STALE_CYCLES:
            if request is Request.QUICK_STOP:
                return profile.QUICK_STOP
            if request is Request.DISABLE:
                return profile.DISABLE_VOLTAGE
        state = self._measured.state
        word = profile.next_controlword(state, request, self.controlword)
        if request is not Request.RESET_FAULT:
            self._asked, self._state = request, state
        return word

    def other_frames(self, request: Request, now_ns: int) -> list[Frame]:
        """Return what is to be sent beside the RPDO: a stop by SDO, reading of 603Fh and of the temperature."""
        frames: list[Frame] = []
        is_blind_stop = self._missed > _BLIND_CYCLES and request in (Request.QUICK_STOP, Request.DISABLE)
        is_out_of_reach = not self.is_reachable or is_blind_stop
        if is_out_of_reach:
            if not self._sdo.is_stopping:
                self._sdo.begin_stop(now_ns)
        elif self._sdo.is_stopping and not self._missed:
            self._sdo.end_stop()
        frame = self._sdo.next(now_ns)
        if is_out_of_reach and self._needs_nmt_start and now_ns >= self._nmt_start_ns:
            self._nmt_start_ns = now_ns + _NMT_START_NS
            # its configuration is in force: RPDOs reach it again, and a stopped node has no SDO
            frames.append((cia301.NMT_ID, bytes((cia301.NmtCommand.START, self.node))))
        if frame is not None:
            frames.append(frame)
        return frames

    @property
    def _needs_nmt_start(self) -> bool:
        """True if the node has left Operational, or, where no heartbeat tells, answers as if it were Stopped."""
        condition = self._monitor.condition
        if condition is NodeCondition.NOT_OPERATIONAL:
            return True
        return condition is not NodeCondition.RESTARTED and self._sdo.is_stopping and self._sdo.stop.is_unanswered

    def note_unsent(self, error: str) -> None:
        """Note that the bus takes no frames any more."""
        self._note_fault(error)

    def note_dropped(self, age_ms: float) -> None:
        """Note that a command was too old to be sent."""
        self._notices.add(coded(f"a command was not sent because it was {age_ms:.0f} ms old", codes.COMMANDS_TOO_OLD))

    # Messages

    def _wrong_mode(self, found: int) -> str:
        """Fault of an enabled drive that is not in the mode that was set."""
        mode = self._drive.mode
        return coded(f"the drive is in mode {found} and not in {mode.name} ({mode.value})", codes.WRONG_MODE)

    def _missing(self) -> str:
        """Why the feedback of this cycle is not complete."""
        if self._short:
            return self._short
        if self._answers.is_late:
            text = f"the TPDOs of node {self.node} answer SYNC {self._answers.lag} cycles late"
            return coded(text, codes.FEEDBACK_LATE)
        if self._why_no_sync:
            return self._why_no_sync
        lost = [f"TPDO {number + 1}" for number in range(len(self.tpdos)) if not self._arrived >> number & 1]
        text = f"{' and '.join(lost)} of node {self.node} did not arrive in time"
        if self._comes_late:
            return coded(f"{text}: it arrived too late in its cycle", codes.FEEDBACK_LATE)
        return text
