"""One drive in the cyclic phase: what it last reported, and what it is commanded. No bus, no clock.

A cycle is `begin_cycle`, the frames through `handlers`, `report`, then `encode` and `other_frames`, in this order.
"""

from friction_hil.drive import Command, DriveState, Feedback, Request
from friction_hil.drive.codes import coded
from friction_hil.drive.stop import STANDSTILL_NS
from friction_hil.errors import DriveError
from friction_hil_drivers.canopen import codes
from friction_hil_drivers.canopen.connect.configure import ConfiguredDrive
from friction_hil_drivers.canopen.connect.mapping import MappedPdo
from friction_hil_drivers.canopen.cycle.answer_set import AnswerSet
from friction_hil_drivers.canopen.cycle.health import Handler, NodeCondition, NodeHealth
from friction_hil_drivers.canopen.cycle.side_channel import CyclicSdo
from friction_hil_drivers.canopen.stop.by_sdo import STANDSTILL_COUNTS
from friction_hil_drivers.canopen.wire import cia301
from friction_hil_drivers.canopen.wire.cia301 import Frame
from friction_hil_drivers.cia402 import profile
from friction_hil_drivers.cia402.codec import CommandEncoder, FeedbackDecoder, Measurement
from friction_hil_drivers.cia402.load_encoder import LoadEncoder
from friction_hil_drivers.cia402.temperature import MappedTemperature, TemperatureRead

_STALE_CYCLES = 2  # without feedback after which no controlword follows from the state that was reported last
_LARGEST_STEP = 1 << 30  # of the position counter in a cycle; the counter is not followed further than that
_BLIND_CYCLES = 10  # without feedback after which a stop is confirmed by SDO
_STANDSTILL_PER_S = 0.01  # rad/s (m/s) that counts as standstill where a stop is watched by SDO
_IN_FAULT = (DriveState.FAULT, DriveState.FAULT_REACTION_ACTIVE)
_GOOD = NodeCondition.GOOD
_OPERATION_ENABLED = DriveState.OPERATION_ENABLED


class CanopenAxis:
    """State of one drive from cycle to cycle.

    ``heartbeat_s``: period of the drive's heartbeat, s; three missing ones are a loss.
    """

    # every cycle runs through these: in a __dict__ of that size, attributes would take twice as long
    __slots__ = (
        "_asked",
        "_decoder",
        "_encoder",
        "_health",
        "_heard_ns",
        "_heartbeat_s",
        "_load",
        "_mapped_temperature",
        "_measured",
        "_missed",
        "_mode",
        "_sdo",
        "_state",
        "_status",
        "_temperature",
        "answers",
        "begin_cycle",
        "controlword",
        "drive",
        "facts",
        "handlers",
        "is_reachable",
        "needs_other_frames",
        "node",
        "watch",
    )

    def __init__(self, drive: ConfiguredDrive, node: int, heartbeat_s: float) -> None:
        self.drive, self.facts, self.watch = drive, drive.facts, drive.watch
        self.node = node
        self._heartbeat_s = heartbeat_s
        self._health = NodeHealth(node, drive.error, heartbeat_s)
        self.answers = AnswerSet(drive.tpdos, drive.mode, self._health)
        self.begin_cycle = self.answers.begin_cycle
        is_mapped = drive.temperature is not None and any(drive.temperature.entry in pdo.entries for pdo in drive.tpdos)
        self._temperature = TemperatureRead(None if is_mapped else drive.temperature, drive.first_temperature)
        self._mapped_temperature: MappedTemperature | None = None
        if drive.temperature is not None and is_mapped:
            self._mapped_temperature = MappedTemperature(drive.tpdos, drive.temperature)
        self._load = None if drive.load_encoder is None else LoadEncoder(drive.tpdos, drive.load_encoder)
        moved = 1e-9 * STANDSTILL_NS * _STANDSTILL_PER_S * abs(drive.units.counts_per_unit)
        self._sdo = CyclicSdo(node, max(STANDSTILL_COUNTS, moved), drive.axis_number, self._temperature)
        self._decoder = FeedbackDecoder(drive.tpdos, drive.units, drive.mode, drive.period_s)
        self._encoder = CommandEncoder({pdo.cob_id: pdo for pdo in drive.rpdos}, drive.mode, drive.units)
        # RPDOs have an effect: False for a node that restarted, left Operational, or has been silent for the time of
        # three heartbeats; nothing but SDO and NMT is sent to it
        self.is_reachable = True
        self.needs_other_frames = False  # as of the last `report`: `other_frames` may have something to send
        self._measured = Measurement()  # of the last complete cycle
        self._missed = 0  # cycles in a row without feedback
        self._heard_ns = 0  # time of the last feedback
        self._mode = int(drive.mode)
        self._status = ""  # statusword of a drive that is not enabled, in words
        self.controlword = profile.DISABLE_VOLTAGE  # encoded last
        # the controlword follows from these alone, as long as the request is not to reset a fault
        self._state: DriveState | None = None
        self._asked: Request | None = None
        self.handlers: dict[int, Handler] = {
            **self.answers.handlers,
            **self._health.handlers,
            cia301.HEARTBEAT_BASE + node: self._on_heartbeat,
            cia301.SDO_RESPONSE_BASE + node: self._on_sdo,
        }

    @property
    def pdos(self) -> tuple[MappedPdo, ...]:
        """All PDOs of a cycle."""
        return (*self.drive.tpdos, *self.drive.rpdos)

    @property
    def state(self) -> DriveState:
        """State of the drive; UNKNOWN if neither TPDOs nor SDO tell it."""
        read = self._sdo.state
        if not self.is_reachable or (self._missed and read is not DriveState.UNKNOWN):
            return read
        return self._measured.state

    @property
    def is_proved_unpowered(self) -> bool:
        """True if the drive has reported, a moment ago, that it has no power."""
        is_told = self.is_reachable and self._missed <= _BLIND_CYCLES and self._measured.state.is_unpowered
        return is_told or self._sdo.is_proved_unpowered

    @property
    def fresh_state(self) -> DriveState:
        """State that the TPDOs of the last cycle have shown, UNKNOWN if these did not come."""
        return self._measured.state if self.is_reachable and not self._missed else DriveState.UNKNOWN

    def idle_frames(self, controlword: int, counts: int) -> list[Frame]:
        """Return the RPDOs with a controlword, the position ``counts`` as target, and neither velocity nor torque."""
        command = Command(position=counts / self.drive.units.counts_per_unit)
        return self._encoder.encode(controlword, command)

    def disabling_frames(self) -> list[Frame]:
        """Return what keeps the timer of the drive's event-driven RPDO from running out, and disables the drive."""
        if self.watch.rpdo_id:
            return [(self.watch.rpdo_id, profile.DISABLE_VOLTAGE.to_bytes(2, "little"))]
        return self.idle_frames(profile.DISABLE_VOLTAGE, self._measured.counts or 0)

    def copy(self) -> "CanopenAxis":
        """Return another axis for the same drive, as it was before its first cycle."""
        return CanopenAxis(self.drive, self.node, self._heartbeat_s)

    def start(self, now_ns: int, *, is_real: bool = True) -> None:
        """Begin the cyclic phase; in simulated time no TPDO comes late, and one that is lost is not waited for."""
        self._heard_ns = now_ns
        self._health.now_ns = now_ns
        self.answers.start(is_real=is_real)
        self._temperature.start(now_ns)

    def _on_heartbeat(self, data: bytes) -> None:
        is_answering = not self._missed and self._measured.counts is not None
        if self._health.take_heartbeat(data, is_answering=is_answering):
            self._measured = self._measured._replace(state=DriveState.UNKNOWN)
            self._sdo.end_stop()  # what was read before the restart does not count

    def _on_sdo(self, data: bytes) -> None:
        self._sdo.take(data, self._health.now_ns)

    # Feedback

    def report(self, feedback: Feedback, now_ns: int) -> None:
        """Write the drive's feedback; without all TPDOs the values stay those of the last complete cycle."""
        health, answers, sdo = self._health, self.answers, self._sdo
        is_fresh = answers.is_complete or answers.end()
        if is_fresh:
            self._take_measurement(now_ns)
        else:
            self._missed += 1
        if is_fresh and health.condition is _GOOD and now_ns <= health.lost_ns:
            is_reachable = True
        else:
            health.judge(now_ns, is_answering=is_fresh)
            is_alive = is_fresh or now_ns - self._heard_ns <= health.patience_ns
            is_reachable = health.condition is _GOOD and is_alive
        self.is_reachable = feedback.is_reachable = is_reachable
        state, _, feedback.position, feedback.velocity, feedback.torque, _, _ = self._measured
        feedback.is_fresh, feedback.status = is_fresh, self._status
        is_asking = sdo.is_stopping or sdo.error_code.attempts_left > 0
        if is_fresh and is_reachable:
            feedback.state, feedback.missing = state, ""
            self.needs_other_frames = is_asking or now_ns >= sdo.temperature.due_ns
        else:
            feedback.state, feedback.missing = self.state, "" if is_fresh else answers.why_missing()
            self.needs_other_frames = is_asking or not is_reachable or self._missed > _BLIND_CYCLES
        feedback.temperature = self._temperature.value
        if self._load is not None:
            feedback.load_position = self._load.position
        health.report(feedback)
        if health.fault and is_fresh and is_reachable and self._asked is Request.DISABLE and not state.is_powered:
            health.end_fault()  # a daemon that waits may start the drive again

    def _take_measurement(self, now_ns: int) -> None:
        """Decode the TPDOs of this cycle."""
        frames, before = self.answers.frames, self._measured
        if self._load is not None:
            self._load.take(frames)
        if self._mapped_temperature is not None:
            self._temperature.value = self._mapped_temperature.take(frames)
        measured = self._decoder.decode(frames, before, (now_ns - self._heard_ns) * 1e-9)
        was, now = before.counts, measured.counts
        if was is not None and now is not None and not -_LARGEST_STEP <= now - was <= _LARGEST_STEP:
            measured = measured._replace(counts=was)  # the counter is followed from where it was
        self._measured, self._missed, self._heard_ns = measured, 0, now_ns
        state = measured.state
        if measured.statusword != before.statusword or state is not before.state:
            self._take_statusword(measured, before)
        if state is _OPERATION_ENABLED:
            if measured.mode != self._mode and self.drive.rpdos:
                wanted = self.drive.mode
                text = f"the drive is in mode {measured.mode} and not in {wanted.name} ({wanted.value})"
                self._health.note_fault(coded(text, codes.WRONG_MODE))
        elif state in _IN_FAULT and not self._health.error and (code := self._sdo.error_code.code):
            self._health.error = profile.error_text(code)  # no emergency message told the reason

    def _take_statusword(self, measured: Measurement, before: Measurement) -> None:
        """React to a statusword that has changed; the reason of a fault is read, and forgotten once it is enabled."""
        is_enabled = measured.state is _OPERATION_ENABLED
        if measured.state is not before.state:
            if is_enabled:
                self._health.error = ""
            elif measured.state in _IN_FAULT and not self._health.error and self.drive.rpdos:
                self._sdo.error_code.begin()
        self._status = "" if is_enabled else profile.status_words(measured.statusword)
        self._health.notices.take_statusword(measured.statusword, is_enabled=is_enabled)

    # Commands

    def encode(self, command: Command) -> list[Frame]:
        """Encode a command for the drive's RPDOs.

        Raises `ValueError`: a value is not finite; `DriveError`: the axis is only listened to.
        """
        if command.request is not self._asked or self._measured.state is not self._state or self._missed:
            self.controlword = self._next_controlword(command.request)
        return self._encoder.encode(self.controlword, command)

    def _next_controlword(self, request: Request) -> int:
        """Return the controlword for a request; to stop, none follows from a state that is not known any more."""
        if not self.drive.rpdos:
            raise DriveError(f"{self.facts.name}: a drive that is only listened to gets no command")
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
        is_blind_stop = self._missed > _BLIND_CYCLES and request in (Request.QUICK_STOP, Request.DISABLE)
        return self._sdo.frames(
            now_ns,
            self._health.condition,
            is_out_of_reach=is_blind_stop or not self.is_reachable,
            is_answering=not self._missed,
        )

    def note_unsent(self, error: str) -> None:
        """Note that the bus takes no frames any more."""
        self._health.note_fault(error)

    def note_dropped(self, age_ms: float) -> None:
        """Note that a command was too old to be sent."""
        text = f"a command was not sent because it was {age_ms:.0f} ms old"
        self._health.notices.add(coded(text, codes.COMMANDS_TOO_OLD))
