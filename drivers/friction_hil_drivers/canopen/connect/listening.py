"""Other masters on the bus, by what they send: heard before anything is sent, and during a run. No clock, no bus.

A frame of another master is told from the daemon's own, which some buses deliver to it as well, by counting: each
frame that the daemon sends comes back once, where frames come back at all.
"""

import time
from collections import Counter
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

from friction_hil.drive import DriveState
from friction_hil.drive.codes import coded
from friction_hil.errors import DriveError
from friction_hil_drivers.canopen import codes
from friction_hil_drivers.canopen.connect.mapping import PdoRecord
from friction_hil_drivers.canopen.connect.twins import IDENTITY, SETTLE_S, SURE_REQUESTS, NodeAnswers
from friction_hil_drivers.canopen.sdo.conversation import FIRST_ANSWER_S, Conversation, device_types
from friction_hil_drivers.canopen.wire import cia301
from friction_hil_drivers.cia402 import objects, profile
from friction_hil_drivers.cia402.access import ObjectReader
from friction_hil_drivers.cia402.preparation import why_powered

if TYPE_CHECKING:
    from friction_hil_drivers.canopen.sdo.client import SdoClient
    from friction_hil_drivers.canopen.wire.cia301 import Frame
    from friction_hil_drivers.canopen.wire.frames import FrameBus

# Two periods of a master that sends at least every 150 ms, as SYNC, PDOs and heartbeats usually are
LISTEN_S = 0.3
_HEARTBEAT_MS = 10  # for a moment, of a node that sends none
_HEARTBEAT_WAIT_S = 0.1
_LISTEN_STEP_S = 0.005
_ALL_NODES = 0
_MOST_CONSUMERS = 16
_MOST_ECHOES = 64  # own frames of one identifier that may be under way; the others were lost
_NMT_NAMES = {command.value: command.name.lower().replace("_", " ") for command in cia301.NmtCommand}


class OtherMasters:
    """What others send that commands our nodes, or that only a master sends.

    ``nodes``: our nodes. ``master_node``: node number of the daemon's own heartbeat. ``sync_id``: identifier of SYNC.
    """

    def __init__(self, nodes: Collection[int], master_node: int, sync_id: int = cia301.SYNC_ID) -> None:
        self._nodes = frozenset(nodes)
        self._echoes: Counter[int] = Counter()
        self._heard: dict[str, int] = {}  # frames, by what they are
        self._states: dict[int, int] = {}  # last NMT state that a node reported
        self._identifiers: set[int] = set()
        self._answers = {node: NodeAnswers() for node in nodes}
        self._sync_id = sync_id
        self._own_heartbeat = cia301.HEARTBEAT_BASE + master_node
        self._watched: dict[int, str] = {
            sync_id: f"SYNC ({sync_id:03X}h)",
            self._own_heartbeat: f"heartbeat of node {master_node}, which is the daemon's own number",
        }
        for node in nodes:
            for number, base in enumerate(cia301.RPDO_BASES, 1):
                self._watched[base + node] = f"RPDO {number} ({base + node:03X}h) to node {node}"
            self._watched[cia301.SDO_REQUEST_BASE + node] = f"SDO requests to node {node}"

    def watch_rpdo(self, can_id: int, node: int) -> None:
        """Watch an identifier that a node has given to one of its RPDOs."""
        self._watch(can_id, f"an RPDO ({can_id:03X}h) to node {node}")

    def watch_heartbeat(self, master: int, node: int) -> None:
        """Watch the heartbeat of a node that one of ours watches: that of its master."""
        what = f"heartbeat of node {master}, which node {node} watches as its master's"
        self._watch(cia301.HEARTBEAT_BASE + master, what)

    def _watch(self, can_id: int, what: str) -> None:
        self._watched.setdefault(can_id, what)
        if can_id in self._identifiers:
            self._count(self._watched[can_id])

    def requested(self, can_id: int, data: bytes | bytearray) -> None:
        """Note an SDO request of our own."""
        answers = self._answers.get(can_id - cia301.SDO_REQUEST_BASE)
        if answers is not None:
            answers.requested(data)

    def sent(self, can_id: int) -> None:
        """Note a frame of our own, which the bus will deliver."""
        if self._echoes[can_id] < _MOST_ECHOES:
            self._echoes[can_id] += 1

    def take(self, frame: "Frame") -> None:
        """Take a frame from the bus."""
        can_id, data = frame
        if self._echoes[can_id] > 0:
            self._echoes[can_id] -= 1
            return
        self._identifiers.add(can_id)
        node = can_id - cia301.HEARTBEAT_BASE
        if node in self._nodes and data:
            self._states[node] = data[0] & 0x7F
        if can_id == cia301.NMT_ID:
            self._take_nmt(data)
        elif can_id in self._watched:
            self._count(self._watched[can_id])
            self.requested(can_id, data)
        elif can_id - cia301.SDO_RESPONSE_BASE in self._answers:
            self._answers[can_id - cia301.SDO_RESPONSE_BASE].answered(data)

    def _take_nmt(self, data: bytes) -> None:
        if len(data) == 2 and (data[1] == _ALL_NODES or data[1] in self._nodes):
            whom = "all nodes" if data[1] == _ALL_NODES else f"node {data[1]}"
            self._count(f"NMT {_NMT_NAMES.get(data[0], f'command {data[0]:02X}h')} to {whom}")

    def _count(self, what: str) -> None:
        self._heard[what] = self._heard.get(what, 0) + 1

    def answers_of(self, node: int) -> NodeAnswers:
        """Return the count of the SDO answers of one of our nodes."""
        return self._answers[node]

    def uses_sdo_of(self, node: int) -> bool:
        """Return True if SDO requests of another master to one of our nodes were heard."""
        return cia301.SDO_REQUEST_BASE + node in self._identifiers

    @property
    def uses_sdo(self) -> bool:
        """True if another master was heard to use the SDO server of any node."""
        return any(cia301.SDO_REQUEST_BASE < can_id < cia301.SDO_REQUEST_BASE + 0x80 for can_id in self._identifiers)

    def state_of(self, node: int) -> int | None:
        """Return the NMT state in the last heartbeat of one of our nodes, None where none was heard."""
        return self._states.get(node)

    @property
    def heard_nodes(self) -> list[int]:
        """Our nodes whose heartbeats were heard."""
        return sorted(self._states)

    def has_heard(self, can_id: int) -> bool:
        """Return True if a frame with an identifier was heard."""
        return can_id in self._identifiers

    @property
    def commanding(self) -> set[int]:
        """Identifiers of frames that act on our drives: SYNC, NMT, RPDOs, and the heartbeat that they watch."""
        rpdos = {can_id for can_id in self._watched if can_id < cia301.SDO_RESPONSE_BASE}
        return {cia301.NMT_ID, self._sync_id, self._own_heartbeat, *rpdos}

    @property
    def has_sync(self) -> bool:
        """True if another master sends SYNC."""
        return self._sync_id in self._identifiers

    @property
    def words(self) -> str:
        """What was heard of others, "" for nothing: ``SYNC (080h), RPDO 1 (205h) to node 5``."""
        return ", ".join(self._heard)


class MasterAlarm:
    """Fault of a run in which another master appears, for the cyclic phase.

    ``others``: as it was when the cyclic phase began; without it, nothing is told.
    """

    def __init__(self, others: OtherMasters | None = None) -> None:
        self._others = others or OtherMasters((), 0)
        self.message = ""  # the fault, "" for none
        watched = set() if others is None else others.commanding
        # for each identifier on which only a master sends: takes the data of a frame
        self.handlers = {can_id: partial(self._on_frame, can_id) for can_id in watched}

    def _on_frame(self, can_id: int, data: bytes) -> None:
        others = self._others
        if not self.message:
            others.take((can_id, data))
            if others.words:
                text = f"another master has appeared on the bus: {others.words}"
                self.message = coded(text, codes.MASTER_APPEARED)


def those_that_answer(nodes: Sequence[int]) -> str:
    """Return the nodes that answer, in words."""
    return f"nodes that answer: {', '.join(map(str, nodes))}" if nodes else "no node answers at all"


def would_disturb(nodes: Sequence[int], bus: str, otherwise: str) -> DriveError:
    """Return why nodes are not read whose only SDO server another master uses; ``otherwise`` is a second remedy."""
    listed = ", ".join(map(str, nodes))
    text = (
        f"another master reads or writes node {listed} on {bus} by SDO, and a node has one SDO server: requests from "
        "here would make its transfers fail"
    )
    return DriveError(text, f"stop that master, or its SDO, {otherwise}", codes.WOULD_DISTURB)


def count_sent(bus: "FrameBus", others: OtherMasters) -> None:
    """Let ``others`` know of each data frame that is sent on a bus which delivers it back."""
    send = bus.send

    def counted(can_id: int, data: bytes | bytearray) -> None:
        send(can_id, data)
        others.sent(can_id)

    bus.send = counted  # type: ignore[method-assign]


def heard_by(bus: "FrameBus", others: OtherMasters, end: float, now: Callable[[], float]) -> None:
    """Let ``others`` hear all frames on the bus until ``end``."""
    while (left := end - now()) > 0.0:
        frame = bus.receive(left)
        if frame is not None:
            others.take(frame)


def ask_identities(clients: Sequence["SdoClient"], bus: "FrameBus", others: OtherMasters) -> None:
    """Ask nodes who they are, and wait for second ones; a `DriveError` for a silent one names those that answer."""
    for client in clients:
        try:
            for entry in IDENTITY:
                client.peek(entry)
        except DriveError as error:
            if error.code != codes.NO_ANSWER or others.uses_sdo:
                raise
            talk = Conversation(bus, answer_s=FIRST_ANSWER_S, attempts=1, heard=others.take)
            text = f"{error.detail} {those_that_answer(sorted(device_types(talk)))}"
            raise DriveError(text, code=error.code) from error
    heard_by(bus, others, time.monotonic() + SETTLE_S, time.monotonic)


def require_one_node(client: "SdoClient", bus: "FrameBus", others: OtherMasters, node: int, bus_name: str) -> None:
    """Raise a `DriveError` for a number that two nodes have, as far as the answers since the last call show it."""
    answers = others.answers_of(node)
    if answers.is_doubtful:
        answers.begin()
        for entry in SURE_REQUESTS:
            client.peek(entry)
        heard_by(bus, others, time.monotonic() + SETTLE_S, time.monotonic)
        if (refusal := answers.refusal(node, bus_name)) is not None:
            raise refusal
    answers.begin()


@dataclass(frozen=True, slots=True)
class Look:
    """What a drive says of itself before anything is written to it."""

    refusal: str  # why the drive must not be touched, "" where it may be
    heartbeat_ms: int  # period of its heartbeat, 0 for none


def look(access: ObjectReader, node: int, others: OtherMasters) -> Look:
    """Read a drive's state, without which a `DriveError` is raised, and what commands it; nothing is written."""
    statusword = access.read(objects.STATUSWORD)
    state = profile.drive_state(statusword)
    refusal = why_powered(state)
    if state is DriveState.UNKNOWN:
        refusal = f"reports statusword {statusword:04X}h, which does not say whether it has power"
    for number in range(cia301.PDO_COUNT):
        cob_id = access.find(PdoRecord(True, number, node).cob_id)
        if cob_id is not None and not cob_id & cia301.PDO_INVALID:
            others.watch_rpdo(cob_id & 0x7FF, node)
    count = access.find(cia301.CONSUMER_HEARTBEAT_COUNT) or 0
    for entry in cia301.consumer_heartbeats(min(count, _MOST_CONSUMERS)):
        master, time_ms = cia301.watched_node(access.find(entry) or 0)
        if master and time_ms:
            others.watch_heartbeat(master, node)
    return Look(refusal, access.find(cia301.PRODUCER_HEARTBEAT) or 0)


def ask_nmt_state(
    client: "SdoClient", bus: "FrameBus", others: OtherMasters, node: int, now: Callable[[], float] = time.monotonic
) -> None:
    """Let a node of which no heartbeat was heard send some (1017h), until ``others`` knows its state.

    Nothing is raised where the node has no heartbeat, or refuses: its state stays unknown then.
    """
    found = client.find(cia301.PRODUCER_HEARTBEAT)
    if found is None or not client.try_write(cia301.PRODUCER_HEARTBEAT, _HEARTBEAT_MS):
        return
    end = now() + _HEARTBEAT_WAIT_S
    while others.state_of(node) is None and (left := end - now()) > 0.0:
        heard_by(bus, others, now() + min(_LISTEN_STEP_S, left), now)
    client.try_write(cia301.PRODUCER_HEARTBEAT, found)


def unknown_nmt_state(node: int) -> str:
    """Return the message for a node whose NMT state could not be restored."""
    text = (
        f"node {node} is in Pre-operational now; whether it was Operational before is not known, because it sends no "
        "heartbeat: if its master expects it Operational, send NMT start"
    )
    return coded(text, codes.NMT_STATE_UNKNOWN)


def kept_out_of_operational(node: int) -> str:
    """Return the message for a node that is not started again, because it was not read back without power."""
    text = f"node {node} was Operational and stays Pre-operational: it was not read back without power"
    return coded(text, codes.NOT_RESTORED)
