"""A simulated CANopen node: NMT, heartbeats, SYNC and PDOs around a CiA 402 device (CiA 301)."""

import time
from collections.abc import Callable
from functools import partial

from friction_hil_drivers.canopen.simulated.disturbances import DisturbedWire, ShownValues
from friction_hil_drivers.canopen.simulated.heartbeat import Consumer, LifeGuard, Producer
from friction_hil_drivers.canopen.simulated.manners import Manners
from friction_hil_drivers.canopen.simulated.pdo import Rpdo, Tpdo, pdo_numbers
from friction_hil_drivers.canopen.simulated.scenario import Event, Timeline
from friction_hil_drivers.canopen.simulated.slow_sdo import SlowSdoServer
from friction_hil_drivers.canopen.wire import cia301
from friction_hil_drivers.canopen.wire.cia301 import NmtCommand, NmtState
from friction_hil_drivers.cia402.access import Abort, AbortError
from friction_hil_drivers.cia402.simulated.dictionary import Dictionary
from friction_hil_drivers.cia402.simulated.drive import SimulatedCia402Drive
from friction_hil_drivers.cia402.simulated.emergency import Emergencies

COMMUNICATION, HEARTBEAT_LOST, RPDO_TOO_SHORT, RPDO_TIMEOUT, SYNC_LOST = 0x8100, 0x8130, 0x8210, 0x8250, 0x8700
_CONNECTION_ERRORS = (COMMUNICATION, HEARTBEAT_LOST, RPDO_TIMEOUT, SYNC_LOST)
_PATIENT_SYNCS = 10  # cycle periods (1006h) without SYNC that count as its loss
_BEHAVIOUR = {0: NmtState.PRE_OPERATIONAL, 2: NmtState.STOPPED}  # 1029h:01; 1: no change
_OPERATIONAL = NmtState.OPERATIONAL
_POLL_NS = 1_000_000
_LOCKED_PERIODS = 10  # without SYNC after which the drive's clock runs free again
_S, _US = 1_000_000_000, 1_000  # ns


class SimulatedNode:
    """One node on the bus.

    Frames come in through `receive`, time through `advance_to`; frames go out through ``send``, which is called with
    identifier and data. `poll` is to be called when `needs_poll` is true: after a SYNC (once all nodes have sent their
    PDOs), and regularly between frames.

    ``number``: node number, 1 to 127. ``dictionary``: of a node with that number. ``make_drive``: makes the device from
    the dictionary and the emergencies. ``sync_steps``: integration steps of a time of its own that passes by so many at
    each SYNC and stands still in between, so that the node's behaviour is a function of the frames; None: time comes
    from `advance_to`. ``lock_steps``: then, integration steps between two SYNCs, to which the drive locks its clock as
    real drives do, so that a SYNC that comes late by some microseconds does not shift the instants at which it samples
    and interpolates; None: SYNCs are taken as they come. ``manners``: what it does differently from a node that does
    everything well. ``clock``: returns real time, ns, in which SDO answers are late.
    """

    def __init__(
        self,
        number: int,
        dictionary: Dictionary,
        make_drive: Callable[[Dictionary, Emergencies], SimulatedCia402Drive],
        send: Callable[[int, bytes], None],
        sync_steps: int | None = None,
        lock_steps: int | None = None,
        manners: Manners | None = None,
        clock: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        self.number = number
        self._manners = Manners() if manners is None else manners
        self.state = NmtState.BOOT_UP
        self.now_ns = 0
        self._polled_ns = 0
        self._has_sync = False  # a SYNC came; received PDOs are still to take effect
        self._steps = 0  # integration steps done
        self._sync_steps = sync_steps
        self._lock_steps = lock_steps
        self._locked_until_ns = 0
        self._is_ahead = False  # integrated up to the coming SYNC
        for event in self._manners.events:
            if event.do == "write":
                dictionary.check(event.index or 0, event.subindex or 0, event.value or 0)
        self._timeline = Timeline(self._manners.events)
        self._wire = DisturbedWire(send, self._tpdo_number) if self._manners.events else None
        self._send = send if self._wire is None else self._wire.send
        self._is_deaf = False
        self._has_ticked = False  # time passed at a SYNC that a deaf node did not hear
        self.dictionary = dictionary
        self._emergencies = Emergencies(dictionary, self._send_emergency)
        self.drive = make_drive(dictionary, self._emergencies)
        self._sdo = SlowSdoServer(
            dictionary,
            partial(self._send, cia301.SDO_RESPONSE_BASE + number),
            self._manners.sdo_delay_s,
            self._manners.sdo,
            clock,
        )
        self.notes = dictionary.notes  # about the file that it follows
        self._producer = Producer(dictionary)
        self._consumer = Consumer(dictionary)
        self._guard = LifeGuard(dictionary)
        self._shown = ShownValues(dictionary, self._manners.events)
        self._rpdos = [
            Rpdo(number, dictionary) for number in pdo_numbers(dictionary, Rpdo.parameter_base, Rpdo.mapping_base)
        ]
        self._tpdos = [
            Tpdo(number, dictionary) for number in pdo_numbers(dictionary, Tpdo.parameter_base, Tpdo.mapping_base)
        ]
        self._sync_id = dictionary.of(cia301.SYNC_COB_ID)
        self._sync_id.on_write = self._write_sync_id
        self._sync_period = dictionary.of(cia301.COMMUNICATION_CYCLE_PERIOD)
        self._sync_period.on_write = self._forget_sync
        self._emergency_id = dictionary.of(cia301.EMERGENCY_COB_ID)
        self._emergency_id.on_write = self._write_emergency_id
        self._behaviour = dictionary.of(cia301.COMMUNICATION_ERROR_BEHAVIOUR)
        self._sync_deadline_ns: int | None = None
        self._handlers: dict[int, Callable[[bytes], None]] = {}
        self._connect()

    def boot(self) -> None:
        """Send the boot-up message and be pre-operational."""
        self.state = NmtState.PRE_OPERATIONAL
        self._send(cia301.HEARTBEAT_BASE + self.number, bytes([NmtState.BOOT_UP]))
        self._producer.restart(self.now_ns)

    @property
    def sync_id(self) -> int:
        """Identifier of SYNC (1005h)."""
        return int(self._sync_id.value) & 0x7FF

    def listens_to(self, can_id: int) -> bool:
        """True if the node takes frames with this identifier."""
        return can_id in self._handlers

    def receive(self, can_id: int, data: bytes) -> None:
        """Take a frame from the bus; those of other identifiers are ignored."""
        if self._is_deaf:
            if self._sync_steps is not None and can_id == self._sync_id.value & 0x7FF:
                self._tick()
                self._has_ticked = True
            return
        handler = self._handlers.get(can_id)
        if handler is not None:
            handler(data)

    def receive_remote(self, can_id: int) -> None:
        """Take a remote frame: the request of node guarding. A node that sends heartbeats does not answer it."""
        is_request = can_id == cia301.HEARTBEAT_BASE + self.number and not self._is_deaf
        if not is_request or not self._guard.is_supported or self._producer.is_on:
            return
        self._send(can_id, self._guard.answer(self.state, self.now_ns))
        self._restore_connection()

    def advance_to(self, now_ns: int) -> None:
        """Let time pass until ``now_ns`` after the start, unless time is counted in SYNCs."""
        if self._sync_steps is None:
            self.now_ns = max(self.now_ns, now_ns)
            if now_ns < self._locked_until_ns:
                return
            steps = now_ns * self.drive.servo.steps_per_second // _S - self._steps
            if steps > 0:
                self.drive.advance(steps)
                self._steps += steps

    def prepare(self) -> None:
        """Integrate up to the coming SYNC before it comes, where the clock is locked.

        This changes no result: synchronous PDOs take effect at a SYNC anyway.
        """
        if self._lock_steps is not None and self.now_ns < self._locked_until_ns and not self._is_ahead:
            self.drive.advance(self._lock_steps)
            self._steps += self._lock_steps
            self._is_ahead = True

    def needs_poll(self, now_ns: int) -> bool:
        """True if `poll` is to be called."""
        if self._has_sync or now_ns - self._polled_ns >= _POLL_NS:
            return True
        return self._has_ticked or (self._wire is not None and self._wire.is_due)

    def poll(self) -> None:
        """Apply the PDOs received before a SYNC; serve timers, ramps and event-driven PDOs."""
        is_sync, self._has_sync = self._has_sync, False
        if is_sync:
            for rpdo in self._rpdos:
                if rpdo.pending is not None:
                    rpdo.write(rpdo.pending)
                    rpdo.pending = None
        if self._wire is not None:
            self._has_ticked = False
            self._wire.pass_time(self.now_ns)
            for event, begins in self._timeline.take(self.now_ns):
                self._act(event, begins=begins)
        self._check_timers(is_sync=is_sync)
        self._update()

    @property
    def answers_in_s(self) -> float | None:
        """Real time until `answer` is to be called, s; None if no SDO answer is late."""
        return self._sdo.due_in_s

    def answer(self) -> None:
        """Send the SDO answers that were late and are due."""
        if self.state is not NmtState.STOPPED:
            self._sdo.poll()

    def _update(self) -> None:
        self.drive.update(self.now_ns)
        if self.state is _OPERATIONAL:
            for tpdo in self._event_driven:
                if (data := tpdo.at_time(self.now_ns)) is not None:
                    self._send(tpdo.can_id, data)

    # Frames

    def _on_nmt(self, data: bytes) -> None:
        if len(data) < 2 or data[1] not in (0, self.number):
            return
        match data[0]:
            case NmtCommand.START:
                self._change_state(NmtState.OPERATIONAL)
            case NmtCommand.STOP:
                self._change_state(NmtState.STOPPED)
            case NmtCommand.ENTER_PRE_OPERATIONAL:
                self._change_state(NmtState.PRE_OPERATIONAL)
            case NmtCommand.RESET_COMMUNICATION:
                self._leave_operational()
                self._reset(0x1FFF)
            case NmtCommand.RESET_NODE:
                self._reset(0xFFFF)
        self._update()

    def _on_sdo(self, data: bytes) -> None:
        if self.state is not NmtState.STOPPED:
            self._sdo.request(data)
            self._load()
            self._update()

    def _on_heartbeat(self, node: int, _: bytes) -> None:
        self._consumer.heard(node, self.now_ns)
        self._restore_connection()

    def _restore_connection(self) -> None:
        if self._consumer.are_all_present and not self._guard.is_missing:
            self.drive.connection_restored(HEARTBEAT_LOST)

    def _on_rpdo(self, rpdo: Rpdo, data: bytes) -> None:
        if self.state is not _OPERATIONAL:
            return
        if len(data) < rpdo.size:
            rpdo.is_too_short = True
            self._emergencies.report(RPDO_TOO_SHORT)
            self._update()
            return
        if rpdo.is_too_short:
            rpdo.is_too_short = False
            if not any(other.is_too_short for other in self._rpdos):
                self._emergencies.clear(RPDO_TOO_SHORT)
        if rpdo.event_timer_ns:
            rpdo.deadline_ns = self.now_ns + rpdo.event_timer_ns
        if rpdo.is_late:
            rpdo.is_late = False
            if not any(other.is_late for other in self._rpdos):
                self.drive.connection_restored(RPDO_TIMEOUT)
        if rpdo.is_synchronous:
            rpdo.pending = data
        else:
            rpdo.write(data)
            self._update()

    def _tick(self) -> None:
        """Let time pass at a SYNC."""
        if self._sync_steps is not None:
            self.drive.advance(self._sync_steps)
            self._steps += self._sync_steps
            self.now_ns = self._steps * _S // self.drive.servo.steps_per_second
        elif self._lock_steps is not None:
            self.prepare()
            self._is_ahead = False
            self._locked_until_ns = (
                self.now_ns + _LOCKED_PERIODS * self._lock_steps * _S // self.drive.servo.steps_per_second
            )

    def _on_sync(self, _: bytes) -> None:
        self._tick()
        self._has_sync = True
        if self._wire is not None:
            self._wire.pass_time(self.now_ns)
        if self.state is not _OPERATIONAL:
            return
        self._timeline.start(self.now_ns)
        for tpdo in self._synchronous:
            if (data := tpdo.at_sync()) is not None:
                self._send(tpdo.can_id, data)
        if self._sync_period.value:
            if self._sync_deadline_ns is None:
                self.drive.connection_restored(SYNC_LOST)
            self._sync_deadline_ns = self.now_ns + _PATIENT_SYNCS * self._sync_period.value * _US

    def _send_emergency(self, data: bytes) -> None:
        cob_id = self._emergency_id.value
        if self.state in (NmtState.OPERATIONAL, NmtState.PRE_OPERATIONAL) and not cob_id & cia301.PDO_INVALID:
            self._send(cob_id & 0x7FF, data)

    # Events

    def _tpdo_number(self, can_id: int) -> int | None:
        """Return the number of the TPDO that is sent with an identifier."""
        return next((n for n, tpdo in enumerate(self._tpdos, 1) if tpdo.exists and tpdo.can_id == can_id), None)

    def _act(self, event: Event, *, begins: bool) -> None:
        """Begin or end an event of the scenario."""
        match event.do:
            case "pre_operational" | "stopped" | "operational":
                self._change_state(NmtState[event.do.upper()])
                self._send_heartbeat()
            case "reboot":
                self._reboot(event, begins=begins)
            case "mute" | "deaf" | "unplug":
                self._cut(is_mute=begins and event.do != "deaf", is_deaf=begins and event.do != "mute")
            case "disable":
                self.drive.disable()
            case "emergency":
                (self._emergencies.report if begins else self._emergencies.clear)(event.code or 0)
            case "fault":
                self.drive.fault(event.code or 0, self.now_ns)
            case "write":
                self.dictionary.change(event.index or 0, event.subindex or 0, event.value or 0)
            case "statusword" | "freeze_encoder" | "jump_encoder":
                self._shown.change(event, begins=begins)
            case _:
                assert self._wire is not None
                self._wire.change(event, begins=begins)

    def _reboot(self, event: Event, *, begins: bool) -> None:
        """Lose the supply and, when it is back, boot."""
        is_off = begins and event.for_s is not None
        self._cut(is_mute=is_off, is_deaf=is_off)
        if is_off:
            self.drive.reset()
            self._set_state(NmtState.BOOT_UP)
        elif begins or self.state is NmtState.BOOT_UP:
            self._reset(0xFFFF)

    def _cut(self, *, is_mute: bool, is_deaf: bool) -> None:
        """Cut or mend the wires."""
        assert self._wire is not None
        self._wire.is_mute, self._is_deaf = is_mute, is_deaf

    # States and supervision

    def _change_state(self, state: NmtState) -> None:
        if state is self.state:
            return
        self._leave_operational()
        if state is _OPERATIONAL:
            self.drive.connection_restored(*_CONNECTION_ERRORS)
        self._set_state(state)

    def _leave_operational(self) -> None:
        """Report a lost connection to a powered drive: without PDOs it gets no set-points."""
        is_noticed = self._manners.nmt_stops_drive and self.state is _OPERATIONAL
        if is_noticed and self.drive.state.is_powered:
            self.drive.connection_lost(COMMUNICATION, self.now_ns)

    def _set_state(self, state: NmtState) -> None:
        self.state = state
        self._sync_deadline_ns = None
        for rpdo in self._rpdos:
            rpdo.stop()
        for tpdo in self._tpdos:
            tpdo.start()
        if state is NmtState.STOPPED:
            self._sdo.reset()

    def _reset(self, last_index: int) -> None:
        """Return objects up to ``last_index`` to their defaults: those of the communication, or of the whole node."""
        self.dictionary.reset(0x1000, last_index)
        if last_index > 0x1FFF:
            self._emergencies.reset()
            self.drive.reset()
        self._sdo.reset()
        self._consumer.reset()
        self._guard.reset()
        for pdo in (*self._rpdos, *self._tpdos):
            pdo.load()
        self._set_state(NmtState.PRE_OPERATIONAL)
        self._connect()
        self.boot()

    def _check_timers(self, *, is_sync: bool) -> None:
        now_ns = self._polled_ns = self.now_ns
        if self._producer.is_due(now_ns):
            self._producer.sent(now_ns)
            self._send_heartbeat()
        for _ in self._consumer.take_lost(now_ns):
            self._lose_connection(HEARTBEAT_LOST)
        if not self._producer.is_on and self._guard.is_overdue(now_ns):
            self._lose_connection(HEARTBEAT_LOST)
        if self.state is not _OPERATIONAL:
            return
        is_watching_all = is_sync or not self._manners.timer_at_sync_only
        for rpdo in self._rpdos:
            if rpdo.is_synchronous and not is_watching_all:
                continue
            if rpdo.deadline_ns is not None and now_ns >= rpdo.deadline_ns:
                rpdo.deadline_ns = None
                rpdo.is_late = True
                self.drive.connection_lost(RPDO_TIMEOUT, now_ns)
        if self._sync_deadline_ns is not None and now_ns >= self._sync_deadline_ns:
            self._sync_deadline_ns = None
            self.drive.connection_lost(SYNC_LOST, now_ns)

    def _send_heartbeat(self) -> None:
        if self._producer.is_on:
            self._send(cia301.HEARTBEAT_BASE + self.number, bytes([self.state]))

    def _lose_connection(self, code: int) -> None:
        """React to a lost heartbeat: the drive by 6007h, the node by 1029h."""
        self.drive.connection_lost(code, self.now_ns)
        behaviour = _BEHAVIOUR.get(self._behaviour.value)
        if self.state is _OPERATIONAL and behaviour is not None:
            self._set_state(behaviour)

    # Parameters

    def _write_sync_id(self, value: int) -> None:
        if value & ~0x7FF or value == 0:  # bit 30, of a producer, is not supported
            raise AbortError(Abort.VALUE)

    def _write_emergency_id(self, value: int) -> None:
        if not value & cia301.PDO_INVALID and (value & ~0x7FF or value == 0):
            raise AbortError(Abort.VALUE)

    def _forget_sync(self, _: int) -> None:
        self._sync_deadline_ns = None

    def _load(self) -> None:
        """Apply the communication parameters that were written."""
        for pdo in (*self._rpdos, *self._tpdos):
            if pdo.is_stale:
                pdo.load()
        self._connect()

    def _connect(self) -> None:
        """Set the handler of each identifier, and which PDOs are sent with SYNC and which by event."""
        self._synchronous = [tpdo for tpdo in self._tpdos if tpdo.exists and tpdo.is_synchronous]
        self._event_driven = [tpdo for tpdo in self._tpdos if tpdo.exists and not tpdo.is_synchronous]
        self._handlers = {rpdo.can_id: partial(self._on_rpdo, rpdo) for rpdo in self._rpdos if rpdo.exists}
        for node in self._consumer.nodes:
            self._handlers[cia301.HEARTBEAT_BASE + node] = partial(self._on_heartbeat, node)
        self._handlers[self._sync_id.value & 0x7FF] = self._on_sync
        self._handlers[cia301.SDO_REQUEST_BASE + self.number] = self._on_sdo
        self._handlers[cia301.NMT_ID] = self._on_nmt
