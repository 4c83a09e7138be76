"""A CiA 402 servo drive on `durand`, an independent CANopen stack: the second opinion about our driver.

durand does NMT, the SDO server, PDOs with their mapping, the SYNC consumer, the EMCY producer and the heartbeat
producer. Added here, from CiA 301, is what a real drive has besides: event timers of RPDOs (1400h:05), heartbeat
consumers (1016h), node guarding (100Ch, 100Dh), the reaction to their loss (6007h, 1029h), refusal of a mapping that
is changed while its PDO is valid; and the servo of `cia402_servo`.

As a process: ``python -m tests.peers.durand_servo --port 41234 --node 1``; it says "ready" on stdout, writes what
happens to ``--log`` as lines of JSON with the time of CLOCK_MONOTONIC, and ends when stdin closes.
"""

import argparse
import contextlib
import heapq
import itertools
import json
import math
import select
import sys
import time
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, TextIO

import can
from durand import Array, DatatypeEnum, MinimalNode, Record, Variable, set_scheduler
from durand.callback_handler import CallbackHandler, FailMode
from durand.network import NetworkABC
from durand.object_dictionary import ObjectDictionary
from durand.scheduler import AbstractScheduler
from durand.services.nmt import StateEnum

from tests.peers.cia402_servo import Servo
from tests.peers.own_group import keep_to_own_group

PDOS = 4
SYNC = 0x080
OPERATIONAL = StateEnum.OPERATIONAL
U8, U16, U32 = DatatypeEnum.UNSIGNED8, DatatypeEnum.UNSIGNED16, DatatypeEnum.UNSIGNED32
I8, I16, I32 = DatatypeEnum.INTEGER8, DatatypeEnum.INTEGER16, DatatypeEnum.INTEGER32
# TPDO and RPDO 1 and 2 of a drive as it is delivered (CiA 402-3): all event-driven, TPDO 2 switched off
DEFAULT_PDOS = (([0x6041], [0x6040]), ([0x6041, 0x6064], [0x6040, 0x607A]))
MILLION, MILLIARD = 1_000_000, 1_000_000_000

Send = Callable[[int, bytes], None]


@dataclass(frozen=True)
class Manners:
    """What differs between drives in the field."""

    counts: int = 65536  # 608Fh, per revolution
    rated_torque: float = 0.64  # 6076h, N m
    is_in_rpm: bool = False  # 606Ch, 60FFh and 60A9h
    timer_at_sync_only: bool = False  # event timers of synchronous RPDOs are looked at when a SYNC comes
    has_rpdo_timers: bool = True  # 1400h:05 ...
    missing: tuple[int, ...] = ()  # objects that the drive lacks


class Agenda(AbstractScheduler):
    """durand's timers, in the time that the servo is told."""

    def __init__(self) -> None:
        self.now_ns = 0
        self._entries: list[tuple[int, int, list[Any]]] = []
        self._numbers = itertools.count()

    def add(self, delay: float, callback: Any, args: Any = (), kwargs: Any = None) -> list[Any]:
        entry = [callback, args, kwargs or {}]
        heapq.heappush(self._entries, (self.now_ns + round(delay * MILLIARD), next(self._numbers), entry))
        return entry

    def cancel(self, entry: list[Any]) -> None:
        entry[0] = None

    def run_until(self, now_ns: int) -> None:
        while self._entries and self._entries[0][0] <= now_ns:
            due_ns, _, (callback, args, kwargs) = heapq.heappop(self._entries)
            self.now_ns = max(self.now_ns, due_ns)
            if callback is not None:
                callback(*args, **kwargs)
        self.now_ns = max(self.now_ns, now_ns)

    @property
    def lock(self) -> Any:
        return contextlib.nullcontext()


class Wire(NetworkABC):
    """Frames to and from durand, without a thread."""

    def __init__(self, send: Send) -> None:
        self._send = send
        self.subscriptions: dict[int, Any] = {}

    def add_subscription(self, cob_id: int, callback: Any) -> None:
        self.subscriptions[cob_id] = callback

    def remove_subscription(self, cob_id: int, callback: Any = None) -> None:
        self.subscriptions.pop(cob_id, None)

    def send(self, cob_id: int, msg: bytes) -> None:
        self._send(cob_id, bytes(msg))


@dataclass
class Watch:
    """A deadline that begins with the first sign of life."""

    due_ns: int | None = None
    limit_ns: int = 0

    def feed(self, now_ns: int, limit_ns: int) -> None:
        self.due_ns = now_ns + limit_ns if limit_ns else None

    def is_over(self, now_ns: int) -> bool:
        """True once, when the deadline has passed."""
        if self.due_ns is None or now_ns < self.due_ns:
            return False
        self.due_ns = None
        return True


@dataclass
class Watches:
    """Everything by which the drive notices that its master has gone."""

    rpdos: list[Watch] = field(default_factory=lambda: [Watch() for _ in range(PDOS)])
    heartbeats: dict[int, Watch] = field(default_factory=dict)
    guarding: Watch = field(default_factory=Watch)
    toggle: int = 0


class DurandServo:
    """One drive: durand's node, the servo, and the watches between them. Time is what the caller says it is.

    Parameters
    ----------
    node : int
    send : callable
        Takes the identifier and the data of a frame of the drive.
    log : callable, optional
        Takes a time (ns) and a text for everything that happens to the drive.
    """

    def __init__(
        self, node: int, send: Send, manners: Manners | None = None, log: Callable[[int, str], None] | None = None
    ) -> None:
        self.manners = manners or Manners()
        self.node_id = node
        self._log = log or (lambda now_ns, text: None)
        self._live: dict[int, Callable[[], int]] = {}  # objects that show what is at this moment
        self._next_event_ns = [0] * PDOS
        self._agenda = Agenda()
        self._wire = Wire(send)
        self._watches = Watches()
        self.servo = Servo(self._on_servo, self.manners.rated_torque)

        set_scheduler(self._agenda)
        self.od = ObjectDictionary()
        # durand would swallow what goes wrong in here
        self.od.update_callbacks = defaultdict(lambda: CallbackHandler(FailMode.FIRST_FAIL))
        self.node = MinimalNode(self._wire, node, self.od)
        self._add_communication()
        self._add_profile()
        self.node.nmt.state_callbacks.add(self._on_nmt)

    # The bus

    def receive(self, can_id: int, data: bytes, *, is_remote: bool = False) -> None:
        """Take a frame from the bus."""
        set_scheduler(self._agenda)
        if is_remote:
            self._guard(can_id)
            return
        if can_id == SYNC:
            self._sample()
            self._check_timers(at_sync=True)
        self._feed_watches(can_id, data)
        callback = self._wire.subscriptions.get(can_id)
        if callback is not None:
            callback(can_id, bytes(data))

    def advance_to(self, now_ns: int) -> None:
        """Let time pass, and notice what is overdue at its end."""
        set_scheduler(self._agenda)
        self.servo.advance_to(now_ns)
        self._agenda.run_until(now_ns)
        self._check_timers(at_sync=False)
        self._send_events()

    @property
    def now_ns(self) -> int:
        return self._agenda.now_ns

    # The object dictionary

    def _variable(self, index: int, kind: Any, access: str, value: int = 0, subindex: int | None = None) -> None:
        if index in self.manners.missing:
            return
        variable = Variable(kind, access, value)
        if subindex is None:
            self.od[index] = variable
            return
        if index not in self.od:
            self.od[index] = Record()
        self.od[index][subindex] = variable

    def _on_write(self, index: int, action: Callable[[Any], None], subindex: int = 0) -> None:
        self.od.update_callbacks[(index, subindex)].add(action)

    def _add_communication(self) -> None:
        od, node = self.od, self.node_id
        od[0x1000] = Variable(U32, "ro", 0x00020192)
        od[0x1008] = Variable(DatatypeEnum.VISIBLE_STRING, "ro", b"durand servo")
        for subindex, value in enumerate((0x7EE7, 0x0402, 1, 1000 + node), 1):
            self._variable(0x1018, U32, "ro", value, subindex)
        if 0x1016 not in self.manners.missing:
            od[0x1016] = Array(Variable(U32, "rw", 0), length=2)
        self._variable(0x100C, U16, "rw")
        self._variable(0x100D, U8, "rw")
        self._variable(0x1029, U8, "rw", 0, 1)
        for number in range(PDOS):
            for base in (0x1400, 0x1800) if self.manners.has_rpdo_timers else (0x1800,):
                od[base + number][5] = Variable(U16, "rw", 0)
            for parameter, mapping in ((0x1400, 0x1600), (0x1800, 0x1A00)):
                refuse = self._mapping_guard(parameter + number)
                for subindex in range(9):
                    od.validate_callbacks[(mapping + number, subindex)].add(refuse)
            self.node.rpdo[number].enable = False
            self.node.tpdo[number].enable = False

    def _mapping_guard(self, parameter: int) -> Callable[[Any], None]:
        """Return a check that refuses a new mapping while the PDO is valid (CiA 301, 7.4.1: 06010000h or similar)."""

        def refuse(_value: Any) -> None:
            if not self.od.read(parameter, 1) & 1 << 31:
                raise ValueError("the PDO is valid")

        return refuse

    def _add_profile(self) -> None:
        m, servo = self.manners, self.servo
        read_only = {0x603F: U16, 0x6041: U16, 0x6061: I8, 0x6062: I32, 0x6064: I32, 0x606C: I32, 0x6077: I16}
        writable = {0x6040: U16, 0x6060: I8, 0x6071: I16, 0x607A: I32, 0x60B2: I16, 0x60FF: I32}
        for index, kind in read_only.items():
            self._variable(index, kind, "ro")
        for index, kind in writable.items():
            self._variable(index, kind, "rw")
        self._variable(0x6007, I16, "rw", 1)
        self._variable(0x605A, I16, "rw", 2)
        self._variable(0x6076, U32, "ro", round(m.rated_torque * 1e3))
        self._variable(0x60A9, U32, "ro", 0x00B44700 if m.is_in_rpm else 0x00B50300)
        self._variable(0x6502, U32, "ro", 0x380)
        self._variable(0x608F, U32, "ro", m.counts, 1)
        self._variable(0x608F, U32, "ro", 1, 2)
        self._variable(0x60C2, U8, "rw", 1, 1)
        self._variable(0x60C2, I8, "rw", -3, 2)
        for index, action in {
            0x6040: servo.control,
            0x6060: self._set_mode,
            0x605A: self._set_quick_stop,
            0x607A: lambda value: servo.target_position(value * self._radian),
            0x60FF: lambda value: setattr(servo.targets, "velocity", value * self._velocity_unit),
            0x6071: lambda value: setattr(servo.targets, "torque", value * m.rated_torque / 1000.0),
            0x60B2: lambda value: setattr(servo.targets, "offset", value * m.rated_torque / 1000.0),
        }.items():
            if index not in m.missing:
                self._on_write(index, action)
        for subindex in (1, 2):
            self._on_write(0x60C2, self._set_period, subindex)
        for index, value in (
            (0x6041, lambda: servo.statusword),
            (0x6064, lambda: self._wrapped(servo.mechanics.position / self._radian)),
            (0x606C, lambda: round(servo.mechanics.velocity / self._velocity_unit)),
            (0x6077, self._torque),
            (0x6062, lambda: self._wrapped(servo.targets.position / self._radian)),
        ):
            if index not in m.missing:
                self._live[index] = value
                self.od.set_read_callback(index, 0, value)
        for number, (tpdo, rpdo) in enumerate(DEFAULT_PDOS):
            self.node.tpdo[number].mapping = [(index, 0) for index in tpdo]
            self.node.rpdo[number].mapping = [(index, 0) for index in rpdo]
            self.node.rpdo[number].enable = True
        self.node.tpdo[0].enable = True

    @property
    def _radian(self) -> float:
        """Radians per count."""
        return 2.0 * math.pi / self.manners.counts

    @property
    def _velocity_unit(self) -> float:
        """rad/s per unit of 606Ch and 60FFh."""
        return math.pi / 30.0 if self.manners.is_in_rpm else self._radian

    @staticmethod
    def _wrapped(counts: float) -> int:
        return (round(counts) + 2**31) % 2**32 - 2**31

    def _torque(self) -> int:
        return round(self.servo.torque / self.manners.rated_torque * 1000.0)

    def _set_mode(self, mode: int) -> None:
        self.servo.mode = mode if mode in (8, 9, 10) else 0
        self.od.write(0x6061, 0, self.servo.mode)

    def _set_quick_stop(self, option: int) -> None:
        self.servo.machine.quick_stop_option = option

    def _set_period(self, _value: int) -> None:
        self.servo.period_s = max(1e-4, self.od.read(0x60C2, 1) * 10.0 ** self.od.read(0x60C2, 2))

    def _sample(self) -> None:
        """Bring the objects of TPDOs up to date, as the drive samples them at SYNC."""
        if self.node.nmt.state is not OPERATIONAL:
            return
        for index, value in self._live.items():
            if index != 0x6062:
                self.od.write(index, 0, value())

    def _on_servo(self, now_ns: int, text: str) -> None:
        """Report a change of the state, and send it where a TPDO is event-driven."""
        self._log(now_ns, text)
        if 0x6041 in self._live and self.node.nmt.state is OPERATIONAL:
            self.od.write(0x6041, 0, self.servo.statusword)

    def _send_events(self) -> None:
        """Send event-driven TPDOs whose event timer (1800h:05) has passed."""
        if self.node.nmt.state is not OPERATIONAL:
            return
        for number, tpdo in enumerate(self.node.tpdo):
            timer_ns = self.od.read(0x1800 + number, 5) * MILLION
            if (
                timer_ns
                and tpdo.enable
                and tpdo.transmission_type >= 254
                and self.now_ns >= self._next_event_ns[number]
            ):
                self._next_event_ns[number] = self.now_ns + timer_ns
                for index, _ in tpdo.mapping:
                    if index in self._live:
                        self.od._data[(index, 0)] = self._live[index]()
                tpdo._deactivate_mapping()
                tpdo._activate_mapping()  # takes the values; sends with type 255

    # Watches

    def _feed_watches(self, can_id: int, data: bytes) -> None:
        now = self.now_ns
        if self.node.nmt.state is OPERATIONAL and self.manners.has_rpdo_timers:
            for number, watch in enumerate(self._watches.rpdos):
                if self.od.read(0x1400 + number, 1) & 0x800007FF == can_id:
                    watch.feed(now, self.od.read(0x1400 + number, 5) * MILLION)
        if 0x700 < can_id <= 0x77F and 0x1016 not in self.manners.missing:
            for subindex in (1, 2):
                value = self.od.read(0x1016, subindex)
                if value and value >> 16 == can_id - 0x700:
                    self._watches.heartbeats.setdefault(subindex, Watch()).feed(now, (value & 0xFFFF) * MILLION)

    def _guard(self, can_id: int) -> None:
        """Answer node guarding, and begin life guarding with it."""
        if can_id != 0x700 + self.node_id or 0x100C in self.manners.missing:
            return
        self._wire.send(can_id, bytes([self.node.nmt.state | self._watches.toggle]))
        self._watches.toggle ^= 0x80
        life_ns = self.od.read(0x100C, 0) * self.od.read(0x100D, 0) * MILLION
        self._watches.guarding.feed(self.now_ns, life_ns)

    def _check_timers(self, *, at_sync: bool) -> None:
        now = self.now_ns
        for number, watch in enumerate(self._watches.rpdos):
            is_synchronous = self.od.read(0x1400 + number, 2) <= 240
            waits = self.manners.timer_at_sync_only and is_synchronous and not at_sync
            if self.node.nmt.state is OPERATIONAL and not waits and watch.is_over(now):
                self._lose(0x8250, f"RPDO {number + 1} is overdue")
        if at_sync:
            return
        for subindex, watch in self._watches.heartbeats.items():
            if self.od.read(0x1016, subindex) == 0:
                watch.due_ns = None
            elif watch.is_over(now):
                self._lose(0x8130, "a heartbeat is overdue", is_communication_error=True)
        if self._watches.guarding.is_over(now):
            self._lose(0x8130, "node guarding is overdue", is_communication_error=True)

    def _lose(self, code: int, text: str, *, is_communication_error: bool = False) -> None:
        """React to the loss of the master: EMCY, 6007h, and for communication errors 1029h."""
        self._log(self.now_ns, text)
        self.node.emcy.set(code, 0x11)
        self._abort_connection(code)
        if is_communication_error and self.node.nmt.state is OPERATIONAL and 0x1029 not in self.manners.missing:
            behaviour = self.od.read(0x1029, 1)
            if behaviour in (0, 2):
                self.node.nmt.set_state(StateEnum.STOPPED if behaviour else StateEnum.PRE_OPERATIONAL)

    def _abort_connection(self, code: int) -> None:
        option = 0 if 0x6007 in self.manners.missing else self.od.read(0x6007, 0)
        if option == 1 and self.servo.machine.is_powered:
            if 0x603F not in self.manners.missing:
                self.od.write(0x603F, 0, code)
            self.servo.fail()
        elif option == 2:
            self.servo.disable()
        elif option == 3:
            self.servo.quick_stop()

    def _on_nmt(self, state: StateEnum) -> None:
        self._log(self.now_ns, f"NMT {state.name}")
        for watch in self._watches.rpdos:
            watch.due_ns = None
        if state is StateEnum.INITIALISATION:
            self.servo.disable()
            self._watches.heartbeats.clear()
            self._watches.guarding = Watch()
        elif state is StateEnum.STOPPED:
            self._abort_connection(0x8130)


# As a process


def serve(bus: can.BusABC, servos: list[DurandServo], is_stopping: Callable[[], bool], *, sync_ns: int | None) -> None:
    """Serve drives on a bus; with ``sync_ns`` time passes only at SYNC, otherwise it is that of the frames.

    A frame acts at the time at which the kernel received it: a late wake-up of this process trips no watch while
    frames wait.
    """
    offset_ns = time.time_ns() - time.monotonic_ns()
    now_ns = 0 if sync_ns else time.monotonic_ns()
    while not is_stopping():
        message = bus.recv(0.0) or bus.recv(0.001)
        if sync_ns is None:
            stamp = time.monotonic_ns() if message is None else round(message.timestamp * 1e9) - offset_ns
            now_ns = max(now_ns, stamp)
        elif message is not None and message.arbitration_id == SYNC:
            now_ns += sync_ns
        for servo in servos:
            servo.advance_to(now_ns)
            if message is not None and not message.is_extended_id and not message.is_error_frame:
                servo.receive(message.arbitration_id, bytes(message.data), is_remote=message.is_remote_frame)


def _log(file: TextIO | None, node: int) -> Callable[[int, str], None]:
    def write(now_ns: int, text: str) -> None:
        if file is not None:
            file.write(json.dumps({"ns": now_ns, "node": node, "what": text}) + "\n")
            file.flush()

    return write


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--group", default="239.74.163.2")
    parser.add_argument("--port", type=int, required=True)
    parser.add_argument("--node", type=int, action="append", required=True)
    parser.add_argument("--log")
    parser.add_argument("--sync-us", type=int, help="time passes only at SYNC, by this much")
    parser.add_argument("--missing", type=lambda text: int(text, 16), action="append", default=[])
    parser.add_argument("--rpm", action="store_true")
    parser.add_argument("--timer-at-sync-only", action="store_true")
    return parser.parse_args()


def main() -> None:
    options = _arguments()
    manners = Manners(
        is_in_rpm=options.rpm, timer_at_sync_only=options.timer_at_sync_only, missing=tuple(options.missing)
    )

    def send(can_id: int, data: bytes) -> None:
        bus.send(can.Message(arbitration_id=can_id, data=data, is_extended_id=False))

    with contextlib.ExitStack() as opened:
        file = opened.enter_context(open(options.log, "w")) if options.log else None
        bus = opened.enter_context(
            can.Bus(interface="udp_multicast", channel=options.group, port=options.port, hop_limit=0, fd=False)
        )
        keep_to_own_group(bus)
        servos = []
        for node in options.node:
            servo = DurandServo(node, send, manners, _log(file, node))
            start_ns = 0 if options.sync_us else time.monotonic_ns()
            servo.servo.now_ns = start_ns
            servos.append(servo)
        print("ready", flush=True)
        sync_ns = options.sync_us * 1000 if options.sync_us else None
        serve(bus, servos, lambda: bool(select.select([sys.stdin], [], [], 0.0)[0]), sync_ns=sync_ns)


if __name__ == "__main__":
    main()
