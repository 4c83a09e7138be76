"""Checks of recorded CAN traffic against CiA 301 and CiA 402: the bus as a bystander sees it.

Nothing of the product's codecs is used here. The recorder follows NMT commands, heartbeats and the SDO transfers that
configure PDOs, and holds each frame against what is in force at its time. `Recorder.violations` lists what is wrong,
each with its rule, so that a test may ask for some of them only:

=========== ==========================================================================================================
identifier  a frame outside the pre-defined connection set and of no PDO that was configured, or of a PDO switched off
length      a PDO with another length than its mapping
sync        a SYNC with a counter where 1019h demands none, or without, or with a wrong one
order       two different synchronous PDOs of one kind in a cycle; an RPDO before the TPDOs of its node
nmt         a PDO to or from a node that is not Operational
control     a controlword that skips a step of the state machine
sdo         an answer that belongs to no request, two requests at a time, a wrong toggle bit
heartbeat   a heartbeat that is later than one and a half of the period in 1017h
=========== ==========================================================================================================
"""

import struct
from collections.abc import Iterable
from dataclasses import dataclass, field

SYNC_ID = 0x080
PRE_OPERATIONAL, OPERATIONAL, STOPPED = 127, 5, 4
_NMT_TARGETS = {0x01: OPERATIONAL, 0x02: STOPPED, 0x80: PRE_OPERATIONAL, 0x81: PRE_OPERATIONAL, 0x82: PRE_OPERATIONAL}
_TPDO_IDS, _RPDO_IDS = (0x180, 0x280, 0x380, 0x480), (0x200, 0x300, 0x400, 0x500)
_CONTROLWORD, _STATUSWORD = 0x60400010, 0x60410010
_LATE = 1.5  # periods of a heartbeat
_RETRY_S = 0.2  # a client may ask again after that
_READY, _SWITCHED_ON, _ENABLED = 0x21, 0x23, 0x27  # statusword & 6Fh


@dataclass(frozen=True)
class Frame:
    """A frame on the bus."""

    time_s: float
    can_id: int
    data: bytes = b""
    is_remote: bool = False

    def __str__(self) -> str:
        return f"{self.time_s:.6f} {self.can_id:03X}h [{self.data.hex()}]"


@dataclass(frozen=True)
class Violation:
    """Something that the standards do not allow."""

    rule: str
    text: str
    frame: Frame

    def __str__(self) -> str:
        return f"{self.rule}: {self.text}: {self.frame}"


@dataclass
class Pdo:
    """A PDO as its parameters say; None: not seen on the bus yet."""

    name: str
    is_receive: bool
    cob_id: int
    is_valid: bool | None = None
    kind: int | None = None
    count: int | None = None
    words: dict[int, int] = field(default_factory=dict)
    cycle: int = -1  # in which it was sent last
    data: bytes = b""

    @property
    def mapping(self) -> list[int] | None:
        """Words of the mapping, None as long as they are not known."""
        if self.count is None or any(k not in self.words for k in range(1, self.count + 1)):
            return None
        return [self.words[k] for k in range(1, self.count + 1)]

    @property
    def size(self) -> int | None:
        """Length by the mapping, bytes."""
        mapping = self.mapping
        return None if mapping is None else sum(word & 0xFF for word in mapping) // 8

    @property
    def is_synchronous(self) -> bool:
        """True if it belongs to SYNC."""
        return self.kind is not None and self.kind <= 240

    def find(self, data: bytes, wanted: int) -> int | None:
        """Return the 16 bit value of an object in the PDO's data."""
        at = 0
        for word in self.mapping or ():
            if word == wanted and at % 8 == 0 and at // 8 + 2 <= len(data):
                return int(struct.unpack_from("<H", data, at // 8)[0])
            at += word & 0xFF
        return None


@dataclass
class Request:
    """An SDO transfer that waits for its answer."""

    frame: Frame
    index: int
    subindex: int
    is_upload: bool
    data: bytes = b""  # of an expedited download
    toggle: int | None = None  # of the segment that is out; None: the transfer has just begun


@dataclass
class Node:
    """A node as the bus shows it."""

    number: int
    nmt: int | None = None
    left_cycle: int = -1  # in which it left Operational
    pdos: dict[int, Pdo] = field(default_factory=dict)  # by index of the communication record
    request: Request | None = None
    segmented: Request | None = None
    status: int | None = None  # state bits of the latest statusword
    heartbeat_s: float = 0.0  # 1017h, 0: none
    beat_s: float | None = None
    uses_sync_counter: bool = False

    def pdo(self, index: int) -> Pdo:
        """Return the PDO of a communication record."""
        if index not in self.pdos:
            is_receive = index < 0x1800
            number = index - (0x1400 if is_receive else 0x1800)
            bases = _RPDO_IDS if is_receive else _TPDO_IDS
            cob_id = bases[number] + self.number if number < 4 else -1
            self.pdos[index] = Pdo(f"{'RPDO' if is_receive else 'TPDO'} {number + 1}", is_receive, cob_id)
        return self.pdos[index]


class Recorder:
    """Takes frames in the order of their times, and keeps what is wrong with them.

    Parameters
    ----------
    grace : int
        SYNC periods for which PDOs may still go to a node that has just left Operational: nobody can know at once.
    has_clock : bool
        False where time is simulated: then the times of frames say nothing.
    """

    def __init__(self, *, grace: int = 2, has_clock: bool = True) -> None:
        self.violations: list[Violation] = []
        self.counts: dict[str, int] = {}
        self.nodes: dict[int, Node] = {}
        self._grace = grace
        self._has_clock = has_clock
        self._cycle = 0
        self._sync_overflow = 0  # 1019h
        self._sync_count: int | None = None

    def take_all(self, frames: Iterable[Frame]) -> "Recorder":
        """Take some frames, and return this recorder."""
        for frame in frames:
            self.take(frame)
        return self

    def of(self, *rules: str) -> list[str]:
        """Return the violations of some rules, of all without any."""
        return [str(each) for each in self.violations if not rules or each.rule in rules]

    def take(self, frame: Frame) -> None:
        """Hold one frame against the standards."""
        function, number = frame.can_id & 0x780, frame.can_id & 0x7F
        pdo = self._pdo_of(frame.can_id)
        if frame.is_remote:
            self._count("remote")
            if function != 0x700:
                self._blame("identifier", "a remote frame that is no node guarding", frame)
        elif frame.can_id == 0x000:
            self._nmt(frame)
        elif frame.can_id == SYNC_ID:
            self._sync(frame)
        elif pdo is not None:
            self._pdo(*pdo, frame)
        elif function == 0x080 or frame.can_id == 0x100:
            self._count("emergency")
            if len(frame.data) != 8:
                self._blame("length", "an emergency message of other than 8 bytes", frame)
        elif function == 0x580 and number:
            self._answer(self._node(number), frame)
        elif function == 0x600 and number:
            self._ask(self._node(number), frame)
        elif function == 0x700 and number:
            self._heartbeat(self._node(number), frame)
        else:
            self._blame("identifier", "no such identifier is in use", frame)

    # What the frames say

    def _nmt(self, frame: Frame) -> None:
        self._count("nmt")
        if len(frame.data) != 2 or frame.data[0] not in _NMT_TARGETS:
            self._blame("nmt", "not an NMT command", frame)
            return
        state, number = _NMT_TARGETS[frame.data[0]], frame.data[1]
        for node in self.nodes.values() if number == 0 else [self._node(number)]:
            self._set_nmt(node, state)

    def _set_nmt(self, node: Node, state: int) -> None:
        if node.nmt == OPERATIONAL and state != OPERATIONAL:
            node.left_cycle = self._cycle
        node.nmt = state

    def _sync(self, frame: Frame) -> None:
        self._count("sync")
        self._cycle += 1
        if self._sync_overflow < 2:
            if frame.data:
                self._blame("sync", "a counter, which 1019h does not ask for", frame)
            return
        if len(frame.data) != 1:
            self._blame("sync", f"no counter, with 1019h = {self._sync_overflow}", frame)
            return
        count = frame.data[0]
        expected = None if self._sync_count is None else self._sync_count % self._sync_overflow + 1
        if not 1 <= count <= self._sync_overflow or expected not in (None, count):
            self._blame("sync", f"counter {count} after {self._sync_count}", frame)
        self._sync_count = count

    def _pdo(self, node: Node, pdo: Pdo, frame: Frame) -> None:
        self._count(pdo.name[:4].lower())
        if pdo.is_valid is False:
            self._blame("identifier", f"{pdo.name} of node {node.number} is switched off", frame)
        if pdo.size is not None and len(frame.data) != pdo.size:
            self._blame("length", f"{pdo.name} of node {node.number} has {pdo.size} bytes by its mapping", frame)
        has_grace = node.left_cycle >= 0 and self._cycle - node.left_cycle <= self._grace
        if node.nmt != OPERATIONAL and not has_grace:
            self._blame("nmt", f"{pdo.name} of node {node.number} in NMT state {node.nmt}", frame)
        if pdo.is_synchronous:
            # the later one counts; repeating the same says nothing new
            if pdo.cycle == self._cycle and self._cycle and frame.data != pdo.data:
                self._blame("order", f"{pdo.name} of node {node.number} twice in a cycle", frame)
            pdo.cycle, pdo.data = self._cycle, frame.data
        if pdo.is_receive:
            self._check_order(node, pdo, frame)
            word = pdo.find(frame.data, _CONTROLWORD)
            if word is not None:
                self._control(node, word, frame)
        else:
            word = pdo.find(frame.data, _STATUSWORD)
            if word is not None:
                node.status = word & 0x6F

    def _check_order(self, node: Node, pdo: Pdo, frame: Frame) -> None:
        if not pdo.is_synchronous:
            return
        for other in node.pdos.values():
            if not other.is_receive and other.is_valid and other.kind == 1 and other.cycle != self._cycle:
                self._blame("order", f"{pdo.name} of node {node.number} before its {other.name}", frame)

    def _control(self, node: Node, word: int, frame: Frame) -> None:
        if word & 0x86 != 0x06 or not word & 0x01:
            return  # fault reset, disable voltage, quick stop, shutdown: allowed everywhere
        is_enable = word & 0x08
        allowed = (_SWITCHED_ON, _ENABLED) if is_enable else (_READY, _SWITCHED_ON, _ENABLED)
        if node.status not in allowed:
            name = "enable operation" if is_enable else "switch on"
            at = "no state seen yet" if node.status is None else f"statusword {node.status:02X}h"
            self._blame("control", f"{name} ({word:04X}h) for node {node.number} at {at}", frame)

    def _heartbeat(self, node: Node, frame: Frame) -> None:
        self._count("heartbeat")
        if len(frame.data) != 1:
            self._blame("length", "a heartbeat of other than one byte", frame)
            return
        state = frame.data[0] & 0x7F
        if state == 0:
            self._boot(node)
            return
        self._set_nmt(node, state)
        period = node.heartbeat_s
        if self._has_clock and period and node.beat_s is not None and frame.time_s - node.beat_s > _LATE * period:
            self._blame("heartbeat", f"{frame.time_s - node.beat_s:.3f} s after the one before, not {period} s", frame)
        node.beat_s = frame.time_s

    def _boot(self, node: Node) -> None:
        left = self._cycle if node.nmt == OPERATIONAL else -1
        self.nodes[node.number] = Node(node.number, PRE_OPERATIONAL, left_cycle=left)

    # SDO

    def _ask(self, node: Node, frame: Frame) -> None:
        self._count("sdo request")
        if len(frame.data) != 8:
            self._blame("sdo", "a request of other than 8 bytes", frame)
            return
        command = frame.data[0]
        if command == 0x80:
            node.request = node.segmented = None
            return
        waits = node.request is not None and (
            frame.time_s - node.request.frame.time_s < _RETRY_S or not self._has_clock
        )
        if waits:
            self._blame("sdo", f"a request to node {node.number} while another one waits for its answer", frame)
        specifier = command >> 5
        if specifier in (0, 3):  # segments
            transfer = node.segmented
            if transfer is None:
                self._blame("sdo", "a segment without a transfer", frame)
                return
            expected = 0 if transfer.toggle is None else transfer.toggle ^ 0x10
            if command & 0x10 != expected:
                self._blame("sdo", "the toggle bit does not alternate", frame)
            node.request = transfer
            transfer.frame, transfer.toggle = frame, command & 0x10
            return
        index, subindex = struct.unpack_from("<HB", frame.data, 1)
        data = b""
        if specifier == 1 and command & 0x02:
            data = frame.data[4 : 8 - (command >> 2 & 0x03) if command & 0x01 else 8]
        node.segmented = None
        node.request = Request(frame, index, subindex, specifier == 2, data)

    def _answer(self, node: Node, frame: Frame) -> None:
        self._count("sdo answer")
        request, node.request = node.request, None
        if request is None or len(frame.data) != 8:
            self._blame("sdo", f"an answer of node {node.number} that belongs to no request", frame)
            return
        command, specifier = frame.data[0], frame.data[0] >> 5
        is_segment = request.toggle is not None and command != 0x80
        if is_segment:
            if command & 0x10 != request.toggle:
                self._blame("sdo", "a segment with the other toggle bit", frame)
            if specifier == 0 and command & 0x01:
                node.segmented = None
            return
        if (request.index, request.subindex) != struct.unpack_from("<HB", frame.data, 1):
            self._blame("sdo", f"an answer for another object than {request.index:04X}h:{request.subindex:02X}", frame)
            return
        if command == 0x80:
            node.segmented = None
        elif specifier == 2 and request.is_upload:
            self._uploaded(node, request, frame.data)
        elif specifier == 3 and not request.is_upload:
            if request.data:
                self._learn(node, request.index, request.subindex, request.data)
            else:
                node.segmented = request
        else:
            self._blame("sdo", "an answer of the other direction", frame)

    def _uploaded(self, node: Node, request: Request, answer: bytes) -> None:
        if answer[0] & 0x02:
            size = 4 - (answer[0] >> 2 & 0x03) if answer[0] & 0x01 else 4
            self._learn(node, request.index, request.subindex, answer[4 : 4 + size])
        else:
            node.segmented = request

    def _learn(self, node: Node, index: int, subindex: int, data: bytes) -> None:
        """Take note of an object that was written, and accepted, or read."""
        value = int.from_bytes(data, "little")
        area = index & 0xFC00
        if area in (0x1400, 0x1800) and index & 0x200 == 0:
            pdo = node.pdo(index)
            if subindex == 1:
                pdo.cob_id, pdo.is_valid = value & 0x7FF, not value >> 31
            elif subindex == 2:
                pdo.kind = value
        elif area in (0x1400, 0x1800):
            pdo = node.pdo(index - 0x200)
            if subindex == 0:
                pdo.count = value
            else:
                pdo.words[subindex] = value
        elif index == 0x1017:
            node.heartbeat_s, node.beat_s = value * 1e-3, None
        elif index == 0x1019:
            self._sync_overflow, self._sync_count = value, None
        elif index == 0x6041:
            node.status = value & 0x6F

    # Helpers

    def _node(self, number: int) -> Node:
        return self.nodes.setdefault(number, Node(number))

    def _pdo_of(self, can_id: int) -> tuple[Node, Pdo] | None:
        """Return the PDO that has an identifier: one that was configured, else that of the connection set."""
        fallback = None
        for node in self.nodes.values():
            for pdo in node.pdos.values():
                if pdo.cob_id == can_id:
                    if pdo.is_valid:
                        return node, pdo
                    fallback = node, pdo
        if fallback is None and 0x180 < can_id < 0x580 and can_id & 0x7F:
            number, base = can_id & 0x7F, can_id & 0x780
            is_receive = base in _RPDO_IDS
            place = (_RPDO_IDS if is_receive else _TPDO_IDS).index(base)
            node = self._node(number)
            fallback = node, node.pdo((0x1400 if is_receive else 0x1800) + place)
        return fallback

    def _count(self, kind: str) -> None:
        self.counts[kind] = self.counts.get(kind, 0) + 1

    def _blame(self, rule: str, text: str, frame: Frame) -> None:
        self.violations.append(Violation(rule, text, frame))
