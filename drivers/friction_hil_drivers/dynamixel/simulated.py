"""Simulated servos that answer Dynamixel requests."""

import itertools
import math
from collections.abc import Mapping
from typing import TYPE_CHECKING

from friction_hil.drive import DriveState
from friction_hil_drivers.dynamixel.codec import ALERT
from friction_hil_drivers.dynamixel.description import DESCRIPTIONS, DynamixelDescription
from friction_hil_drivers.dynamixel.driver import DynamixelLine
from friction_hil_drivers.dynamixel.options import DynamixelOptions
from friction_hil_drivers.dynamixel.packets import (
    BROADCAST,
    CRC,
    FAST_SYNC_READ,
    HEADER,
    PING,
    READ,
    REBOOT,
    STATUS,
    SYNC_READ,
    SYNC_WRITE,
    WRITE,
    Packet,
    Packets,
)
from friction_hil_drivers.serial_line.protocol import COMMANDS
from friction_hil_drivers.serial_line.simulated.drive import RefusedError, RequestError
from friction_hil_drivers.serial_line.simulated.drives import SimulatedSerialDrives
from friction_hil_drivers.serial_line.simulated.server import BOOT_S

if TYPE_CHECKING:
    from friction_hil_drivers.dynamixel.table import Item
    from friction_hil_drivers.serial_line.simulated.drive import SimulatedDrive

INSTRUCTION_ERROR, RANGE_ERROR, LENGTH_ERROR, LIMIT_ERROR, ACCESS_ERROR = 2, 4, 5, 6, 7
_LONGEST = 1017  # the vendor's SDK makes packets of at most 1024 bytes
_UNKNOWN_IDENTITY = bytes(3)  # model number and firmware in the reply to a ping; no real servo has these
_FIRST_IN_RAM = 64  # items at lower addresses keep their numbers without supply, and are written without torque alone
_ENABLED = DriveState.OPERATION_ENABLED


class _Servo:
    """Control table of one simulated drive."""

    def __init__(self, drive: "SimulatedDrive", description: DynamixelDescription) -> None:
        self._drive = drive
        self._items = [item for block in description.blocks(description.signals) for item in block.items]
        signals = description.signals
        self._fixed = {
            name: float(signal.simulated) for name, signal in signals.items() if signal.simulated is not None
        }
        self._goals = [name for name in signals if name in COMMANDS]
        self._kept = frozenset(item.name for item in self._items if item.address < _FIRST_IN_RAM)
        self._up_at_s = -math.inf  # end of a reboot
        position = signals["position"]
        self._turn = 1.0 / position.scale if position.unit == "turn" else 0.0  # numbers of the position
        self._is_locked = False  # the bus watchdog was set, and locks the goals when it trips
        self._forgotten = 0.0  # whole turns of the position before the last reboot

    @property
    def alert(self) -> int:
        """Alert bit of the error field: set while the servo has an error."""
        has_error = any(item.name == "error" for item in self._items)
        return ALERT if has_error and self._drive.read("error") else 0

    @property
    def identity(self) -> bytes:
        """Model number and firmware, as in the reply to a ping."""
        if not {"model_number", "firmware"} <= self._fixed.keys():
            return _UNKNOWN_IDENTITY
        return b"".join(i.pack(self._fixed[i.name]) for i in self._items if i.name in ("model_number", "firmware"))

    @property
    def is_up(self) -> bool:
        """True unless the servo is rebooting."""
        if not self._drive.is_on and self._drive.time_s >= self._up_at_s > -math.inf:
            self._drive.switch_on(self._kept)
            self._up_at_s = -math.inf
            if self._turn:  # after power-on the position lies within one turn
                self._forgotten = math.floor(self._drive.read("position") / self._turn) * self._turn
        return self._up_at_s == -math.inf

    def reboot(self) -> None:
        """Begin a reboot, which ends torque and errors; in the meantime the servo answers nothing."""
        self._drive.switch_off()
        # with pace sync no time would pass on a line whose only servo does not answer
        self._up_at_s = self._drive.time_s + (0.0 if self._drive.is_paced_by_requests else BOOT_S)

    def fed(self) -> None:
        """Reset the bus watchdog, as any instruction does."""
        self._drive.fed()

    def read(self, address: int, size: int) -> bytes:
        """Return bytes of the table. Raises `RequestError`: one of the bytes belongs to no item."""
        end = address + size
        items = [item for item in self._items if item.address < end and address < item.end]
        if sum(min(item.end, end) - max(item.address, address) for item in items) != size or not size:
            raise RequestError(ACCESS_ERROR)
        if any(item.name == "position" for item in items):
            self._drive.sample()
        data = b"".join(item.pack(self._number(item.name)) for item in items)
        skipped = address - items[0].address
        return data[skipped : skipped + size]

    def _number(self, name: str) -> float:
        fixed = self._fixed.get(name)
        if fixed is not None:
            return fixed
        return self._drive.read(name) - (self._forgotten if name == "position" else 0.0)

    def write(self, address: int, data: bytes) -> None:
        """Write bytes of the table.

        Raises `RequestError`: a byte belongs to no item, an item is written only in part, or the drive refuses the
        number.
        """
        end = address + len(data)
        items = [item for item in self._items if item.address < end and address < item.end]
        if any(item.address < address or item.end > end for item in items):
            raise RequestError(LENGTH_ERROR)
        if sum(item.size for item in items) != len(data) or not data:
            raise RequestError(ACCESS_ERROR)
        numbers = {item.name: item.number(data[item.address - address : item.end - address]) for item in items}
        for item in items:
            self._check(item, numbers[item.name])
        was = self._drive.state
        try:
            for name, number in numbers.items():
                self._drive.write(name, number)
        except RefusedError:
            raise RequestError(RANGE_ERROR) from None
        if self._drive.state is _ENABLED is not was:  # goals of the time without torque act now
            for name in self._goals:
                self._drive.write(name, self._drive.read(name))

    def _check(self, item: "Item", number: float) -> None:
        """Refuse a number that the servo keeps out, whatever its signal takes otherwise."""
        if item.name in self._kept and self._drive.state is _ENABLED:
            raise RequestError(ACCESS_ERROR)
        if item.name == "watchdog":
            self._is_locked = number != 0.0
        elif item.name in self._goals and self._is_locked and self._drive.read("watchdog") < 0.0:
            raise RequestError(RANGE_ERROR)  # after the bus watchdog has tripped, until it is switched off
        if item.limit is not None and abs(number) > item.limit:
            raise RequestError(LIMIT_ERROR)


class DynamixelResponder:
    """Answers requests for the simulated drives on one line; see `Responder` of `serial_line.simulated.server`.

    Raises `UsageError`: the vendor's SDK is not installed.
    """

    request_end = b""

    def __init__(
        self,
        drives: "Mapping[str, SimulatedDrive]",
        descriptions: Mapping[str, DynamixelDescription],
        options: Mapping[str, DynamixelOptions],
    ) -> None:
        self._packets = Packets()
        self.by_address = {options[axis].id: _Servo(drives[axis], descriptions[axis]) for axis in drives}
        self._present = dict(self.by_address)  # those that are not rebooting
        self._has_fast_read = {options[axis].id: descriptions[axis].fast_sync_read for axis in drives}

    def take(self, received: bytearray) -> bytes | None:
        """Remove one whole request and return its reply, ``b""`` if none is due; None if the request is incomplete."""
        while (packet := self._packets.cut(received, _LONGEST)) is not None:
            if packet.is_whole and packet.instruction != STATUS:
                return self._answer(packet)
        return None

    def forget(self) -> None:
        """Do nothing: the next request is recognised by its header."""

    def _answer(self, packet: Packet) -> bytes:
        self._present = {servo: each for servo, each in self.by_address.items() if each.is_up}
        if packet.id == BROADCAST:
            for each in self._present.values():
                each.fed()
            return self._answer_all(packet)
        servo = self._present.get(packet.id)
        if servo is None:
            return b""
        servo.fed()
        p = packet.parameters
        try:
            if packet.instruction == PING:
                return self._status(packet.id, servo.identity)
            if packet.instruction == REBOOT:
                reply = self._status(packet.id)
                servo.reboot()
                return reply
            if packet.instruction == READ:
                if len(p) != 4:
                    raise RequestError(LENGTH_ERROR)
                return self._status(packet.id, servo.read(_word(p, 0), _word(p, 2)))
            if packet.instruction != WRITE:
                raise RequestError(INSTRUCTION_ERROR)
            if len(p) < 2:
                raise RequestError(LENGTH_ERROR)
            servo.write(_word(p, 0), p[2:])
            return self._status(packet.id)
        except RequestError as error:
            return self._status(packet.id, error=error.number)

    def _answer_all(self, packet: Packet) -> bytes:
        p = packet.parameters
        if packet.instruction == PING:
            return b"".join(self._status(servo, self._present[servo].identity) for servo in sorted(self._present))
        if packet.instruction == REBOOT:
            for each in self._present.values():
                each.reboot()
        if packet.instruction == WRITE and len(p) > 2:
            for servo in self._present:
                self._write(servo, _word(p, 0), p[2:])
        if len(p) <= 4:
            return b""
        address, size, rest = _word(p, 0), _word(p, 2), p[4:]
        if packet.instruction == SYNC_READ:
            # each servo waits for the answer of the one before it: after one that is missing, none answers
            answering = itertools.takewhile(self._present.__contains__, rest)
            return b"".join(self._read(servo, address, size) for servo in answering)
        if packet.instruction == FAST_SYNC_READ:
            return self._read_fast(address, size, rest)
        if packet.instruction == SYNC_WRITE:
            for k in range(0, len(rest) - size, size + 1):
                self._write(rest[k], address, rest[k + 1 : k + 1 + size])
        return b""

    def _read(self, servo: int, address: int, size: int) -> bytes:
        try:
            return self._status(servo, self.by_address[servo].read(address, size))
        except RequestError as error:
            return self._status(servo, error=error.number)

    def _read_fast(self, address: int, size: int, servos: bytes) -> bytes:
        """Return the packet that the servos write together; it ends before the first missing servo."""
        length = 1 + len(servos) * (2 + size + CRC)
        if length > _LONGEST:
            return b""
        packet = bytearray(HEADER + bytes((BROADCAST,)) + length.to_bytes(2, "little") + bytes((STATUS,)))
        for k, servo in enumerate(servos):
            if servo not in self._present or not self._has_fast_read[servo]:
                return bytes(packet) if k else b""
            error, data = 0, bytes(size)
            try:
                data = self.by_address[servo].read(address, size)
            except RequestError as refusal:
                error = refusal.number
            packet += bytes((error | self.by_address[servo].alert, servo)) + data
            packet += self._packets.crc(packet).to_bytes(CRC, "little")
        return bytes(packet)

    def _write(self, servo: int, address: int, data: bytes) -> None:
        """Write bytes of a servo that does not answer, so that a refusal is not reported."""
        if servo in self._present:
            try:
                self.by_address[servo].write(address, data)
            except RequestError:
                return

    def _status(self, servo: int, data: bytes = b"", error: int = 0) -> bytes:
        return self._packets.pack(servo, STATUS, bytes((error | self.by_address[servo].alert,)) + data)


def _word(data: bytes, offset: int) -> int:
    return int.from_bytes(data[offset : offset + 2], "little")


class SimulatedDynamixelDrives(SimulatedSerialDrives):
    """Simulated servos that answer Dynamixel requests."""

    description_type = DynamixelDescription
    descriptions = DESCRIPTIONS
    protocol = DynamixelLine
    responder = DynamixelResponder
