"""Dynamixel exchanges: instruction packets made from process images, and status packets stored in them."""

from collections.abc import Sequence
from dataclasses import dataclass

from friction_hil_drivers.dynamixel.packets import (
    BROADCAST,
    CRC,
    FAST_SYNC_READ,
    HEADER,
    PREFIX,
    READ,
    REBOOT,
    REQUEST_SIZE,
    STATUS,
    STATUS_SIZE,
    SYNC_READ,
    SYNC_WRITE,
    WRITE,
    Packets,
)
from friction_hil_drivers.dynamixel.table import Item, ItemBlock
from friction_hil_drivers.serial_line.protocol import Exchange, Image, ReplyError, Single

ALERT = 0x80  # bit of the error field: the servo has a hardware error, which the signal `error` reports
# ROBOTIS e-Manual, DYNAMIXEL Protocol 2.0, Status Packet
ERRORS = {
    1: "result fail: it could not carry out the request",
    2: "instruction error: it does not know this instruction",
    3: "CRC error: the request was damaged on the line",
    4: "data range error: it does not accept this value (no goal at all after its bus watchdog tripped)",
    5: "data length error: the value has more bytes than were written",
    6: "data limit error: the value is beyond a limit in its control table",
    7: "access error: this address cannot be read or written (nothing below 64 can while the torque is on)",
}


@dataclass(frozen=True, slots=True)
class Member:
    """Servo that takes part in a request, and the items that are read or written."""

    id: int
    image: Image
    block: ItemBlock
    has_fast_read: bool

    def __str__(self) -> str:
        return str(self.block)

    def put(self, data: bytes) -> None:
        """Store the bytes of the block in the image."""
        first, items = self.block.address, self.block.items
        numbers = [item.number(data[item.address - first : item.end - first]) for item in items]
        self.image.put([item.name for item in items], numbers)


class _Request(Single):
    """Common part of all exchanges; see `friction_hil_drivers.serial_line.protocol.Exchange`."""

    reads: tuple[str, ...] = ()
    writes: tuple[str, ...] = ()
    request_size = reply_size = 0

    def __init__(self, packets: Packets, label: str, members: Sequence[Member], reply_bytes: int) -> None:
        ids = ", ".join(str(member.id) for member in members)
        self.label = self._label = f"{label} of id {ids}"
        self.addressees = frozenset(str(member.id) for member in members)
        self._packets = packets
        self._members = {member.id: member for member in members}  # in the order in which they answer
        self._reply_bytes = reply_bytes  # of data in the status packet of each servo
        self._packet_size = STATUS_SIZE + reply_bytes  # without stuffing
        self._longest = self._packet_size - PREFIX + _stuffing(reply_bytes)
        self._answered: set[int] = set()
        self._failed: dict[int, str] = {}  # by servo: reason why its answer is not used
        self._is_broken = False
        self._noise = 0  # bytes that belonged to no packet

    @property
    def unanswered(self) -> frozenset[str]:
        """See `Exchange`."""
        return frozenset(str(servo) for servo in self._members if servo not in self._answered)

    @property
    def breaker(self) -> int | None:
        """First servo that did not answer, in a request to several; None if all answered."""
        return next(iter(self._missing), None) if len(self._members) > 1 else None

    def _begin(self) -> None:
        self.label, self._is_broken, self._noise = self._label, False, 0
        self._answered.clear()
        self._failed.clear()

    def take(self, received: bytearray) -> bool:
        """Store the received status packets in the images; return True if all servos have answered.

        Each packet is stored when it is complete, even if later ones are lost or damaged. Raises `ReplyError`: a servo
        answered that was not asked; or no answer is missing any more, and one was damaged or a refusal.
        """
        while not self._is_complete:
            before = len(received)
            packet = self._packets.cut(received, self._longest)
            if packet is None:
                self._noise += before - len(received)
                self._check_noise(received, len(self._missing) * self._packet_size)
                self._name_missing()
                return False
            self._noise += packet.skipped
            if not packet.is_whole:
                # only the header was removed; if the sender is known, the bytes of its packet do not count as noise
                is_known = self._blame(packet.id)
                self._noise += len(HEADER) - (self._packet_size if is_known else 0)
            elif packet.instruction == STATUS:  # not so the request itself, on a line that echoes
                self._hear(packet.id, packet.parameters)
        return self._finish()

    @property
    def _is_complete(self) -> bool:
        return len(self._answered) + len(self._failed) == len(self._members)

    @property
    def _missing(self) -> list[int]:
        return [servo for servo in self._members if servo not in self._answered and servo not in self._failed]

    def _check_noise(self, received: bytearray, expected: int) -> None:
        """Stop waiting for packets whose bytes have all arrived, but with a damaged header."""
        kept = len(HEADER) - 1  # last bytes of the noise, which may begin a header
        if self._noise >= expected - kept and HEADER not in received:
            missing = ", ".join(map(str, self._missing))
            raise ReplyError(f"{self._noise} bytes came, but no packet of id {missing}")

    def _blame(self, servo: int) -> bool:
        """Assign a damaged packet to the servo that it names, or to the only missing one; return True if assigned."""
        self._is_broken = True
        missing = self._missing
        if servo not in missing and len(missing) == 1:
            servo = missing[0]
        if servo in missing:
            self._failed[servo] = f"the answer of id {servo} has a wrong CRC"
        return servo in missing

    def _hear(self, servo: int, parameters: bytes) -> None:
        if servo not in self._members or servo in self._answered:
            twice = " twice" if servo in self._answered else ", which was not asked"
            raise ReplyError(f"answered by id {servo}{twice}")
        self._failed.pop(servo, None)  # a damaged packet had been assigned to it
        error, data = parameters[:1], parameters[1:]
        if error and (number := error[0] & ~ALERT):
            self._failed[servo] = (
                f"id {servo} refuses: {ERRORS.get(number, 'not one of the known ones')} (error {number})"
            )
        elif not error or len(data) != self._reply_bytes:
            raise ReplyError(f"id {servo} answered with {len(data)} bytes of data instead of {self._reply_bytes}")
        else:
            self._accept(self._members[servo], data)

    def _accept(self, member: Member, data: bytes) -> None:
        self._answered.add(member.id)
        if self.reads:
            member.put(data)

    def _name_missing(self) -> None:
        """Name the missing servos in ``label`` if others answered: a time-out is reported with the label."""
        if self._answered or self._failed:
            self.label = f"{self._label} ({', '.join(map(str, self._missing))} missing)"

    def _finish(self) -> bool:
        self.label = self._label
        if self._failed:
            raise ReplyError("; ".join(self._failed.values()), is_complete=not self._is_broken)
        return True


class Order:
    """Reading order of the servos of a line: those that broke the chain come last, the most recent at the end."""

    def __init__(self) -> None:
        self.breaks = 0  # times that a chain was broken
        self._last: dict[int, int] = {}  # by servo: number of the last break that it caused
        self._asked: _Request | None = None

    def ask(self, request: _Request) -> None:
        """Note a new request, and the servo that broke the chain of the previous one."""
        if self._asked is not None and (breaker := self._asked.breaker) is not None:
            self.breaks += 1
            self._last[breaker] = self.breaks
        self._asked = request

    def key(self, servo: int) -> int:
        """Return the sorting key of a servo."""
        return self._last.get(servo, 0)


class Read(_Request):
    """Read the same bytes of one servo or of several (Sync Read); each answers with a packet of its own.

    A servo answers after the one before it in the request. If one does not answer, none of those after it does
    (ROBOTIS-GIT/DynamixelSDK issue 364). The servo that broke the chain therefore comes last in the next request.
    """

    def __init__(self, packets: Packets, members: Sequence[Member], order: Order) -> None:
        block = members[0].block
        super().__init__(packets, f"read {block}", members, block.size)
        self.reads = _names(members)
        self._order = order
        self._known_breaks = 0
        self._others: dict[frozenset[str], Exchange | None] = {}
        self._span = _words(block.address, block.size)
        self._request = self._pack()
        self.request_size = len(self._request)
        self.reply_size = len(members) * (PREFIX + self._longest)

    def _pack(self) -> bytes:
        servos = bytes(self._members)
        if len(servos) == 1:
            return self._packets.pack(servos[0], READ, self._span)
        return self._packets.pack(BROADCAST, SYNC_READ, self._span + servos)

    def encode(self) -> bytes:
        """Return the request."""
        self._order.ask(self)
        if self._known_breaks != self._order.breaks:
            self._known_breaks = self._order.breaks
            self._members = {servo: self._members[servo] for servo in sorted(self._members, key=self._order.key)}
            self._request = self._pack()
        self._begin()
        return self._request

    def without(self, addressees: frozenset[str]) -> Exchange | None:
        """Return the exchange that reads the same bytes of all other servos; each is made once."""
        if addressees not in self._others:
            rest = [member for servo, member in self._members.items() if str(servo) not in addressees]
            self._others[addressees] = read_exchange(self._packets, rest, self._order) if rest else None
        return self._others[addressees]


class FastRead(Read):
    """Read the same bytes of several servos (Fast Sync Read), which write one packet together, in their order.

    The packet is not stuffed. Each servo ends its part with the CRC of all bytes up to there, so that a part can be
    checked and used before the next one arrives, and also if that is lost.
    """

    def __init__(self, packets: Packets, members: Sequence[Member], order: Order) -> None:
        super().__init__(packets, members, order)
        block = members[0].block
        self.label = self._label = f"{self._label} (fast)"
        self._part = 2 + block.size + CRC  # error, ID, data, CRC
        length = 1 + len(members) * self._part
        self._head = HEADER + bytes((BROADCAST,)) + length.to_bytes(2, "little") + bytes((STATUS,))
        self._heard = self._crc = 0
        self.reply_size = PREFIX + length

    def _pack(self) -> bytes:
        return self._packets.pack(BROADCAST, FAST_SYNC_READ, self._span + bytes(self._members))

    def encode(self) -> bytes:
        """Return the request."""
        self._heard, self._crc = (
            0,
            self._packets.crc(self._head),
        )  # number of parts, and the CRC of all bytes up to there
        return super().encode()

    def take(self, received: bytearray) -> bool:
        """Store the received parts in the images; see `_Request.take`."""
        before = len(received)
        if not self._find_head(received):
            self._noise += before - len(received)
            self._check_noise(received, self.reply_size)
            return False
        ids = tuple(self._members)
        while not self._is_complete:
            start = len(self._head) + self._heard * self._part
            part = received[start : start + self._part]
            if len(part) < self._part:
                self._name_missing()
                return False
            self._crc = self._packets.crc(part[:-CRC], self._crc)
            is_whole = self._crc == int.from_bytes(part[-CRC:], "little") and part[1] == ids[self._heard]
            self._crc = self._packets.crc(part[-CRC:], self._crc)
            if is_whole:
                self._hear(ids[self._heard], bytes(part[:1] + part[2:-CRC]))
            else:
                self._blame(ids[self._heard])
            self._heard += 1
        del received[: self.reply_size]
        return self._finish()

    def _find_head(self, received: bytearray) -> bool:
        """Remove the bytes before the packet; return True if its first bytes have arrived."""
        while (start := received.find(HEADER)) >= 0:
            del received[:start]
            if len(received) < len(self._head):
                return False
            if received.startswith(self._head):
                return True
            del received[: len(HEADER)]
        del received[: max(0, len(received) - len(HEADER) + 1)]
        return False


class Write(_Request):
    """Write bytes of one servo, which acknowledges the request."""

    def __init__(self, packets: Packets, member: Member) -> None:
        super().__init__(packets, f"write {member.block}", (member,), 0)
        self._member = member
        self.writes = _names((member,))
        size = member.block.size
        self.request_size = REQUEST_SIZE + 2 + size + _stuffing(size)
        self.reply_size = STATUS_SIZE

    def encode(self) -> bytes:
        """Return the request with the image's numbers. Raises `ValueError`: a number is not finite."""
        self._begin()
        member = self._member
        data = _words(member.block.address) + _packed(member, self.label)
        return self._packets.pack(member.id, WRITE, data)


class Reboot(_Request):
    """Restart one servo, which acknowledges the request and then answers nothing for a moment."""

    def __init__(self, packets: Packets, member: Member) -> None:
        super().__init__(packets, "reboot", (member,), 0)
        self.request_size = REQUEST_SIZE
        self.reply_size = STATUS_SIZE

    def encode(self) -> bytes:
        """Return the request."""
        self._begin()
        (servo,) = self._members
        return self._packets.pack(servo, REBOOT)


class SyncWrite(_Request):
    """Write the same items of several servos with one request; none of them answers."""

    def __init__(self, packets: Packets, members: Sequence[Member]) -> None:
        block = members[0].block
        super().__init__(packets, f"write {block}", members, 0)
        self.writes = _names(members)
        self._span = _words(block.address, block.size)
        # no ID is FDh or FFh, so that only the data of a servo may have to be stuffed
        self.request_size = REQUEST_SIZE + 4 + len(members) * (1 + block.size + _stuffing(block.size))

    def encode(self) -> bytes:
        """Return the request with the images' numbers. Raises `ValueError`: a number is not finite."""
        parts = [self._span]
        for servo, member in self._members.items():
            parts += bytes((servo,)), _packed(member, self.label)
        return self._packets.pack(BROADCAST, SYNC_WRITE, b"".join(parts))


def read_exchange(packets: Packets, members: Sequence[Member], order: Order) -> Exchange:
    """Return the exchange that reads the same bytes of some servos: a fast one if all of them support it."""
    is_fast = len(members) > 1 and all(member.has_fast_read for member in members)
    return FastRead(packets, members, order) if is_fast else Read(packets, members, order)


def alike(members: Sequence[Member]) -> list[list[Member]]:
    """Group members whose blocks have the same address and size: one request serves each group."""
    groups: dict[tuple[int, int], list[Member]] = {}
    for member in members:
        groups.setdefault((member.block.address, member.block.size), []).append(member)
    return list(groups.values())


def _names(members: Sequence[Member]) -> tuple[str, ...]:
    items: list[Item] = [item for member in members for item in member.block.items]
    return tuple(dict.fromkeys(item.name for item in items))


def _packed(member: Member, label: str) -> bytes:
    try:
        return member.block.pack(member.image.values)
    except ValueError as error:
        raise ValueError(f"{label}: id {member.id}: {error}") from None


def _words(*numbers: int) -> bytes:
    return b"".join(number.to_bytes(2, "little") for number in numbers)


def _stuffing(size: int) -> int:
    """Return the largest number of bytes that stuffing can add to ``size`` bytes: one for each FF FF FD."""
    return size // 3
