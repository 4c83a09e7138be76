"""A wire between the bus of the daemon and the bus of the drives: it passes frames on, disturbs and witnesses them.

Both are udp_multicast buses on this machine, each with a group and port of its own. Nothing of the product's codecs is
used: mappings are learned from the SDO transfers that pass (`tools.campaigns.frame_recorder`).
"""

import contextlib
import heapq
import itertools
import select
import socket
import struct
import time
from collections.abc import Mapping
from dataclasses import dataclass

import can
from can.interfaces.udp_multicast.utils import pack_message, unpack_message

from tools.campaigns.disturbance import TO_DAEMON, TO_DRIVE, Disturbance
from tools.campaigns.frame_recorder import Frame, Recorder
from tools.campaigns.witness import Witness

SYNC = 0x080
CONTROLWORD, STATUSWORD, TARGET_TORQUE, TORQUE_OFFSET = 0x6040, 0x6041, 0x6071, 0x60B2
POSITION, TARGET_POSITION, TARGET_VELOCITY = 0x6064, 0x607A, 0x60FF
_RPDOS = (0x200, 0x300, 0x400, 0x500)
_TORQUES = (TARGET_TORQUE, TORQUE_OFFSET)
_BUFFER_BYTES = 4 << 20
_SO_TIMESTAMPNS, _STAMP = 35, struct.Struct("@qq")  # asm-generic/socket.h; timespec
_PATIENCE_S = 0.02  # for the answer to a question of the campaign


@dataclass(frozen=True, slots=True)
class Bus:
    """A multicast group and port."""

    group: str
    port: int

    @property
    def keys(self) -> dict[str, object]:
        """Keys of a configuration's ``bus``."""
        return {"interface": "udp_multicast", "channel": self.group, "port": self.port, "hop_limit": 0}


class _End:
    """Sockets at one of the two buses; what they send they do not hear."""

    def __init__(self, bus: Bus) -> None:
        self._to = (bus.group, bus.port)
        self._sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._sender.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, 0)
        self._sender.bind(("", 0))
        self._own_port = self._sender.getsockname()[1]
        self._receiver = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._receiver.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        self._receiver.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEPORT, 1)
        self._receiver.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER_BYTES)
        self._receiver.bind((bus.group, bus.port))
        member = struct.pack("@4sI", socket.inet_aton(bus.group), socket.INADDR_ANY)
        self._receiver.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, member)
        self._receiver.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)
        self._receiver.setblocking(False)

    def fileno(self) -> int:
        return self._receiver.fileno()

    def receive(self) -> Frame | None:
        """Return the next frame of somebody else; None if there is none."""
        while True:
            try:
                data, told, _, source = self._receiver.recvmsg(4096, socket.CMSG_SPACE(_STAMP.size))
            except BlockingIOError:
                return None
            if source[1] != self._own_port:
                with contextlib.suppress(Exception):  # a datagram that is no frame
                    message = unpack_message(data, check=True)
                    return Frame(_arrived_s(told), message.arbitration_id, bytes(message.data), message.is_remote_frame)

    def send(self, frame: Frame) -> None:
        message = can.Message(
            timestamp=time.time(),
            arbitration_id=frame.can_id,
            data=frame.data,
            is_extended_id=frame.can_id > 0x7FF,
            is_remote_frame=frame.is_remote,
        )
        self._sender.sendto(pack_message(message), self._to)

    def close(self) -> None:
        self._sender.close()
        self._receiver.close()


class CanWire:
    """Connects the daemon's bus with the drives', and shows what passes to a witness for each node.

    Parameters
    ----------
    daemon, drives : Bus
    witnesses : mapping of int to Witness
        By node number.
    mapped : mapping of int to list of int, optional
        Words (index, subindex, bits) of PDOs by identifier, where no SDO transfer tells them.
    turns : int, optional
        Added to every position that the daemon sees, and taken away from its targets: counts.

    Attributes
    ----------
    began_s : float or None
        Time of the daemon's first SYNC or, beside a master, of its first offset.
    cycles : int
        SYNCs or offsets of the daemon.
    disturbances : list of Disturbance
        Applied to all that passes.
    """

    def __init__(
        self,
        daemon: Bus,
        drives: Bus,
        witnesses: Mapping[int, Witness],
        mapped: Mapping[int, list[int]] | None = None,
        turns: int = 0,
    ) -> None:
        self._daemon, self._drives = _End(daemon), _End(drives)
        self._witnesses = dict(witnesses)
        self._mapped = dict(mapped or {})
        self._is_sidecar = bool(mapped)
        self._turns = turns
        self._recorder = Recorder(grace=1 << 30)
        self._known: dict[int, list[int]] = {}  # mappings by identifier, kept over a reboot of the drive
        self._torques: dict[int, dict[int, int]] = {}  # node: objects that make its torque
        self._due: list[tuple[float, int, str, Frame]] = []
        self._number = itertools.count()
        self._last_due: dict[int, float] = {}
        self._asked: dict[int, tuple[int, bytes, float]] = {}  # node: index, request, time
        self.disturbances: list[Disturbance] = []
        self.began_s: float | None = None
        self.cycles = 0
        self.frames = 0

    def poll(self, timeout_s: float) -> None:
        """Pass on what has arrived or becomes due within ``timeout_s``."""
        if self._due:
            timeout_s = max(0.0, min(timeout_s, self._due[0][0] - time.monotonic()))
        select.select([self._daemon, self._drives], [], [], timeout_s)
        is_active = True
        while is_active:
            is_active = False
            for end, direction in ((self._daemon, TO_DRIVE), (self._drives, TO_DAEMON)):
                if (frame := end.receive()) is not None:
                    is_active = True
                    self.frames += 1
                    self._take(frame, direction)
            self._deliver()

    def _deliver(self) -> None:
        now_s = time.monotonic()
        while self._due and self._due[0][0] <= now_s:
            _, _, direction, frame = heapq.heappop(self._due)
            (self._drives if direction == TO_DRIVE else self._daemon).send(frame)

    def _take(self, frame: Frame, direction: str) -> None:
        if self._is_answer_to_campaign(frame, direction):
            return
        self._recorder.take(frame)
        self._recorder.violations.clear()
        self._witness(frame, direction)
        frame = self._turned(frame)
        pieces = [(0.0, frame.data)]
        for disturbance in self.disturbances:
            pieces = [
                (before + delay, data) for before, part in pieces for delay, data in disturbance.apply(direction, part)
            ]
        for delay_s, data in pieces:
            passed = Frame(frame.time_s, frame.can_id, data, frame.is_remote)
            now_s = time.monotonic()
            due_s = now_s + delay_s
            if frame.can_id in self._mapped:
                # nobody can tell another master's old set-point from a new one; CAN keeps the order of an identifier
                due_s = self._last_due[frame.can_id] = max(due_s, self._last_due.get(frame.can_id, 0.0))
            if due_s > now_s:
                heapq.heappush(self._due, (due_s, next(self._number), direction, passed))
            else:
                (self._drives if direction == TO_DRIVE else self._daemon).send(passed)

    # What frames say

    def _witness(self, frame: Frame, direction: str) -> None:
        of_daemon = direction == TO_DRIVE
        if of_daemon and (frame.can_id == SYNC or (self._is_sidecar and frame.can_id in self._mapped)):
            self.began_s = frame.time_s if self.began_s is None else self.began_s
            self.cycles += 1
        node = frame.can_id & 0x7F
        witness = self._witnesses.get(node)
        if witness is None or frame.is_remote:
            return
        function = frame.can_id & 0x780
        if function == 0x080 and len(frame.data) == 8 and not of_daemon:
            if code := struct.unpack_from("<H", frame.data)[0]:
                witness.emergencies.append(code)
            return
        values = self._values(frame)
        torque = self._torque(node, values)
        if of_daemon and function in _RPDOS and not values:
            witness.unread += 1
        if of_daemon and (torque is not None or CONTROLWORD in values):
            controlword = values.get(CONTROLWORD, witness.controlword)
            position, velocity = values.get(TARGET_POSITION), values.get(TARGET_VELOCITY)
            witness.command(frame.time_s, torque, controlword, position, velocity)
        elif torque is not None and function in (0x580, 0x600):  # the drive says it, or a master on its bus writes it
            witness.took(frame.time_s, torque)
        if not of_daemon and POSITION in values:
            witness.feedback(frame.time_s, values[POSITION])
        if not of_daemon and STATUSWORD in values:
            witness.status(frame.time_s, values[STATUSWORD])

    def _torque(self, node: int, values: dict[int, int]) -> float | None:
        """Return the torque of a drive: target and offset, of which one may be written or read at a time."""
        known = self._torques.setdefault(node, {})
        given = {index: values[index] for index in _TORQUES if index in values}
        known.update(given)
        return float(sum(known.values())) if given else None

    def _values(self, frame: Frame) -> dict[int, int]:
        """Return the objects in a PDO or an expedited SDO transfer, by index."""
        function = frame.can_id & 0x780
        if function in (0x580, 0x600) and len(frame.data) == 8:
            command = frame.data[0]
            is_write = function == 0x600 and command >> 5 == 1
            is_read = function == 0x580 and command >> 5 == 2
            if not (is_write or is_read) or not command & 0x02:
                return {}
            index, subindex = struct.unpack_from("<HB", frame.data, 1)
            size = 4 - (command >> 2 & 0x03) if command & 0x01 else 4
            return {index: _number(index, frame.data[4 : 4 + size])} if subindex == 0 else {}
        words = self._words(frame.can_id)
        values, at = {}, 0
        for word in words:
            size = (word & 0xFF) // 8
            data = frame.data[at : at + size]
            if len(data) == size:
                values[word >> 16] = _number(word >> 16, data)
            at += size
        return values

    def _words(self, can_id: int) -> list[int]:
        """Return the mapping of a PDO, with subindex 0 entries alone."""
        if can_id in self._mapped:
            return self._mapped[can_id]
        node = self._recorder.nodes.get(can_id & 0x7F)
        for pdo in () if node is None else node.pdos.values():
            if pdo.cob_id == can_id and pdo.is_valid and pdo.mapping is not None:
                self._known[can_id] = pdo.mapping
                return pdo.mapping
        return self._known.get(can_id, [])

    def _turned(self, frame: Frame) -> Frame:
        """Return the frame with the positions that the daemon is to see."""
        if not self._turns:
            return frame
        function, data = frame.can_id & 0x780, bytearray(frame.data)
        if function in (0x580, 0x600):
            found = self._values(frame)
            places = [(index, 4) for index in found if index in (POSITION, TARGET_POSITION)]
        else:
            places, at = [], 0
            for word in self._words(frame.can_id):
                if word >> 16 in (POSITION, TARGET_POSITION) and at + 4 <= len(data):
                    places.append((word >> 16, at))
                at += (word & 0xFF) // 8
        for index, at in places:
            value = struct.unpack_from("<i", data, at)[0] + (self._turns if index == POSITION else -self._turns)
            struct.pack_into("<I", data, at, value & 0xFFFFFFFF)
        return Frame(frame.time_s, frame.can_id, bytes(data), frame.is_remote)

    # What the campaign itself sends

    def send(self, direction: str, can_id: int, data: bytes) -> None:
        """Send a frame of the campaign."""
        (self._drives if direction == TO_DRIVE else self._daemon).send(Frame(time.monotonic(), can_id, data))

    def both(self, can_id: int, data: bytes) -> None:
        """Send a frame of the campaign on both buses, as a node beside the daemon would."""
        self.send(TO_DRIVE, can_id, data)
        self.send(TO_DAEMON, can_id, data)

    def ask(self, node: int, index: int) -> None:
        """Read an object of a drive behind the daemon's back, unless a question waits for its answer."""
        self._request(node, index, struct.pack("<BHB4x", 0x40, index, 0))

    def write(self, node: int, index: int, value: int, size: int) -> None:
        """Write an object of a drive behind the daemon's back."""
        data = (value & (1 << 8 * size) - 1).to_bytes(4, "little")
        self._request(node, index, struct.pack("<BHB", 0x23 | (4 - size) << 2, index, 0) + data)

    def _request(self, node: int, index: int, request: bytes) -> None:
        now_s = time.monotonic()
        if node in self._asked and now_s - self._asked[node][2] < _PATIENCE_S:
            return
        self._asked[node] = (index, request, now_s)
        self.send(TO_DRIVE, 0x600 + node, request)

    def _is_answer_to_campaign(self, frame: Frame, direction: str) -> bool:
        node = frame.can_id & 0x7F
        asked = self._asked.get(node)
        if direction == TO_DRIVE or frame.can_id & 0x780 != 0x580 or asked is None or len(frame.data) != 8:
            return False
        if struct.unpack_from("<H", frame.data, 1)[0] != asked[0]:
            return False
        del self._asked[node]
        for index, value in self._values(frame).items():
            if index == STATUSWORD and node in self._witnesses:
                self._witnesses[node].status(frame.time_s, value)
            if index in _TORQUES and node in self._witnesses:
                self._witnesses[node].took(frame.time_s, float(value))
        return True

    def close(self) -> None:
        """Leave both buses."""
        self._daemon.close()
        self._drives.close()


def _arrived_s(told: list[tuple[int, int, bytes]]) -> float:
    """Return when the kernel took a datagram, on the campaign's clock: this process may look later."""
    now_s = time.monotonic()
    for level, kind, data in told:
        if (level, kind) == (socket.SOL_SOCKET, _SO_TIMESTAMPNS):
            seconds, ns = _STAMP.unpack(data[: _STAMP.size])
            arrived_s: float = seconds + 1e-9 * ns
            return now_s - max(0.0, time.time() - arrived_s)
    return now_s


def _number(index: int, data: bytes) -> int:
    return int.from_bytes(data, "little", signed=index not in (CONTROLWORD, STATUSWORD))
