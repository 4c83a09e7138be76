"""A serial line between the daemon and a simulated drive: it passes telegrams of Modbus RTU on, and reads them.

The daemon has a pseudo-terminal of the campaign, the simulated drive its own. Telegrams are taken apart here, after the
Modbus application protocol (V1.1b3, functions 3, 6, 16, 23), with the addresses of the description generic_cia402.
"""

import contextlib
import heapq
import itertools
import os
import select
import struct
import time
import tty
from pathlib import Path

from tools.campaigns.disturbance import TO_DAEMON, TO_DRIVE, Disturbance
from tools.campaigns.witness import Witness

STATUS, POSITION, TORQUE_COMMAND, CONTROL, MODE = 0x0000, 0x0003, 0x0102, 0x0105, 0x0106
VELOCITY_COMMAND, POSITION_COMMAND = 0x0100, 0x0103  # two registers each
READ, WRITE_ONE, WRITE, READ_WRITE = 3, 6, 16, 23
_LENGTHS = {READ: (8, None), WRITE_ONE: (8, 8), WRITE: (None, 8), READ_WRITE: (None, None)}  # request, reply
_PATIENCE_S = 0.05
_STALE_S = 0.02  # bytes that are no telegram are passed on after that


def crc(data: bytes | bytearray) -> bytes:
    """Return the CRC-16 of a telegram."""
    value = 0xFFFF
    for byte in data:
        value ^= byte
        for _ in range(8):
            value = value >> 1 ^ 0xA001 if value & 1 else value >> 1
    return struct.pack("<H", value)


class _Direction:
    """Bytes that go one way, cut into telegrams."""

    def __init__(self, *, is_request: bool) -> None:
        self._is_request = is_request
        self._held = bytearray()
        self._since_s = 0.0

    def feed(self, data: bytes) -> list[bytes]:
        """Return the telegrams that are complete."""
        if data:
            self._since_s = time.monotonic()
        self._held += data
        telegrams = []
        while (size := self._size()) is not None and len(self._held) >= size:
            telegrams.append(bytes(self._held[:size]))
            del self._held[:size]
        if self._held and time.monotonic() - self._since_s > _STALE_S:
            telegrams.append(bytes(self._held))
            self._held.clear()
        return telegrams

    def _size(self) -> int | None:
        held = self._held
        if len(held) < 3:
            return None
        function = held[1]
        if function & 0x80:
            return 5
        if function not in _LENGTHS:
            return len(held)
        fixed = _LENGTHS[function][0 if self._is_request else 1]
        if fixed is not None:
            return fixed
        if not self._is_request:
            return 5 + held[2]
        at = 6 if function == WRITE else 10
        return at + 3 + held[at] if len(held) > at else None


class SerialWire:
    """Connects the daemon's line with the drive's, and shows what passes to a witness.

    Parameters
    ----------
    daemon : Path
        Name of the line that the daemon opens; created.
    drive : Path
        Line of the simulated drive.
    witness : Witness
    turns : int
        Added to every position that the daemon sees: counts.
    """

    def __init__(self, daemon: Path, drive: Path, witness: Witness, turns: int = 0) -> None:
        self._master, slave = os.openpty()
        tty.setraw(slave)
        daemon.symlink_to(os.ttyname(slave))
        self._slave = slave  # kept open: the line stays when the daemon has gone
        self._drive = os.open(drive, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        tty.setraw(self._drive)
        os.set_blocking(self._master, False)
        self._witness = witness
        self._requests, self._replies = _Direction(is_request=True), _Direction(is_request=False)
        self._turns = turns
        self._read_from: int | None = None  # first register of the reply to come
        self._unit = 0
        self._asking: tuple[bytes, float] | None = None
        self._waiting: list[bytes] = []  # questions of the campaign
        self._held: list[bytes] = []  # requests of the daemon while a question of the campaign is out
        self._is_open = False  # a request of the daemon waits for its reply
        self._due: list[tuple[float, int, str, bytes]] = []
        self._number = itertools.count()
        self.disturbances: list[Disturbance] = []
        self._looked_s = 0.0
        self.frozen: bytes | None = None  # position that the daemon goes on seeing
        self.is_freezing = False
        self.jump = 0
        self.began_s: float | None = None
        self.cycles = 0
        self.frames = 0
        self.last_of_daemon_s: float | None = None

    def poll(self, timeout_s: float) -> None:
        """Pass on what has arrived or becomes due within ``timeout_s``."""
        if self._due:
            timeout_s = max(0.0, min(timeout_s, self._due[0][0] - time.monotonic()))
        began_s = time.monotonic()
        if began_s - self._looked_s > _STALE_S:  # telegrams that wait are of different times
            self._witness.forget_times()
        ready, _, _ = select.select([self._master, self._drive], [], [], timeout_s)
        self._looked_s = time.monotonic()
        for descriptor in (self._master, self._drive):
            data = b""
            if descriptor in ready:
                with contextlib.suppress(OSError):  # the other end has gone
                    data = os.read(descriptor, 4096)
            if descriptor == self._master:
                for telegram in self._requests.feed(data):
                    self._request(telegram)
            else:
                for telegram in self._replies.feed(data):
                    self._reply(telegram)
        now_s = time.monotonic()
        while self._due and self._due[0][0] <= now_s:
            _, _, direction, data = heapq.heappop(self._due)
            self._put(direction, data)
        self._ask_now()

    def _request(self, telegram: bytes) -> None:
        self.frames += 1
        self.last_of_daemon_s = time.monotonic()
        self._unit = telegram[0]
        if self._asking is not None:
            self._held.append(telegram)
            return
        self._forward(telegram)

    def _forward(self, telegram: bytes) -> None:
        self._is_open = True
        values = self._written(telegram)
        if not values and not (telegram[1:2] == bytes([READ]) and len(telegram) == 8):
            self._witness.unread += 1
        if telegram[1] in (READ, READ_WRITE):
            self._read_from = struct.unpack_from(">H", telegram, 2)[0]
        now_s = time.monotonic()
        controlword = values.get(CONTROL, self._witness.controlword)
        if TORQUE_COMMAND in values:
            if controlword is not None and controlword & 0x0F in (0x06, 0x07, 0x0F):
                self.began_s = now_s if self.began_s is None else self.began_s
            self.cycles += self.began_s is not None
            torque = float(struct.unpack(">h", struct.pack(">H", values[TORQUE_COMMAND]))[0])
            position, velocity = (_long(values, at) for at in (POSITION_COMMAND, VELOCITY_COMMAND))
            self._witness.command(now_s, torque, controlword, position, velocity)
        elif CONTROL in values:
            self._witness.command(now_s, None, controlword)
        self._pass(TO_DRIVE, self._turned_request(telegram))

    def _reply(self, telegram: bytes) -> None:
        if self._asking is not None:
            self._asking = None
            if telegram[1] == READ and len(telegram) >= 7:
                self._witness.status(time.monotonic(), struct.unpack_from(">H", telegram, 3)[0])
            for held in self._held:
                self._forward(held)
            self._held.clear()
            return
        self.frames += 1
        self._is_open = False
        if telegram[1] in (READ, READ_WRITE) and self._read_from is not None and len(telegram) >= 7:
            count = telegram[2] // 2
            if self._read_from <= STATUS < self._read_from + count:
                at = 3 + 2 * (STATUS - self._read_from)
                self._witness.status(time.monotonic(), struct.unpack_from(">H", telegram, at)[0])
            if self._read_from <= POSITION <= self._read_from + count - 2:
                at = 3 + 2 * (POSITION - self._read_from)
                telegram = self._turned_reply(telegram, at)
                if crc(telegram[:-2]) == telegram[-2:]:
                    self._witness.feedback(time.monotonic(), struct.unpack_from(">i", telegram, at)[0])
        self._pass(TO_DAEMON, telegram)

    def _written(self, telegram: bytes) -> dict[int, int]:
        """Return the registers that a request writes."""
        if len(telegram) < 8 or crc(telegram[:-2]) != telegram[-2:]:
            return {}
        function = telegram[1]
        if function == WRITE_ONE:
            address, value = struct.unpack_from(">HH", telegram, 2)
            return {address: value}
        at = {WRITE: 2, READ_WRITE: 6}.get(function)
        if at is None:
            return {}
        address, count, size = struct.unpack_from(">HHB", telegram, at)
        if size != 2 * count or len(telegram) < at + 7 + size:
            return {}
        words = struct.unpack_from(f">{count}H", telegram, at + 5)
        return dict(zip(range(address, address + count), words, strict=True))

    def _turned_request(self, telegram: bytes) -> bytes:
        values = self._written(telegram)
        at = {WRITE: 7, READ_WRITE: 11}.get(telegram[1])
        if not self._turns or at is None or not {0x0103, 0x0104} <= set(values):
            return telegram
        changed, at = bytearray(telegram[:-2]), at + 2 * (0x0103 - min(values))
        value = struct.unpack_from(">i", changed, at)[0] - self._turns
        struct.pack_into(">I", changed, at, value & 0xFFFFFFFF)
        return bytes(changed) + crc(changed)

    def _turned_reply(self, telegram: bytes, at: int) -> bytes:
        """Return a reply with the position that the daemon is to see."""
        if crc(telegram[:-2]) != telegram[-2:] or not (self._turns or self.jump or self.is_freezing):
            return telegram
        changed = bytearray(telegram[:-2])
        if self.is_freezing:
            self.frozen = self.frozen or bytes(changed[at : at + 4])
            changed[at : at + 4] = self.frozen
        value = struct.unpack_from(">i", changed, at)[0] + self._turns + self.jump
        struct.pack_into(">I", changed, at, value & 0xFFFFFFFF)
        return bytes(changed) + crc(changed)

    def _pass(self, direction: str, telegram: bytes) -> None:
        pieces = [(0.0, telegram)]
        for disturbance in self.disturbances:
            pieces = [
                (before + delay, data) for before, part in pieces for delay, data in disturbance.apply(direction, part)
            ]
        for delay_s, data in pieces:
            if delay_s > 0.0:
                heapq.heappush(self._due, (time.monotonic() + delay_s, next(self._number), direction, data))
            else:
                self._put(direction, data)

    def _put(self, direction: str, data: bytes) -> None:
        with contextlib.suppress(OSError):  # the other end has gone, or does not read any more
            os.write(self._drive if direction == TO_DRIVE else self._master, data)

    # What the campaign itself sends

    def noise(self, direction: str, data: bytes) -> None:
        """Put bytes on the line."""
        self._put(direction, data)

    def write(self, address: int, value: int) -> None:
        """Write a register of the drive behind the daemon's back, between two of its requests."""
        self._enqueue(struct.pack(">BBHH", self._unit, WRITE_ONE, address, value & 0xFFFF))

    def ask(self) -> None:
        """Read the state of the drive behind the daemon's back, unless a question is out."""
        if not (self._waiting or self._asking):
            self._enqueue(struct.pack(">BBHH", self._unit, READ, STATUS, 1))

    def _enqueue(self, body: bytes) -> None:
        self._waiting.append(body + crc(body))

    def _ask_now(self) -> None:
        now_s = time.monotonic()
        if self._asking is not None and now_s - self._asking[1] > _PATIENCE_S:
            self._asking = None
            for held in self._held:
                self._forward(held)
            self._held.clear()
        quiet_s = now_s - (self.last_of_daemon_s or 0.0)
        if self._waiting and self._asking is None and (not self._is_open or quiet_s > _PATIENCE_S):
            telegram = self._waiting.pop(0)
            self._asking = (telegram, now_s)
            self._put(TO_DRIVE, telegram)

    def close(self) -> None:
        """Close both lines."""
        for descriptor in (self._master, self._slave, self._drive):
            os.close(descriptor)


def _long(values: dict[int, int], address: int) -> int | None:
    """Return what two registers hold together; None where they are not written."""
    if not {address, address + 1} <= set(values):
        return None
    long: int = struct.unpack(">i", struct.pack(">HH", values[address], values[address + 1]))[0]
    return long
