"""Simulated drives that answer Modbus requests."""

import math
import struct
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

from pymodbus.exceptions import ModbusException
from pymodbus.framer import FramerRTU, FramerSocket
from pymodbus.pdu import DecodePDU, ModbusPDU
from pymodbus.pdu import bit_message as bits
from pymodbus.pdu import register_message as registers

from friction_hil.drive.encoder import unwrap
from friction_hil_drivers.modbus.description import DESCRIPTIONS, ModbusDescription
from friction_hil_drivers.modbus.driver import ModbusLine
from friction_hil_drivers.modbus.framing import REFUSED
from friction_hil_drivers.modbus.options import ModbusOptions
from friction_hil_drivers.modbus.registers import RegisterField, Table
from friction_hil_drivers.serial_line.simulated.drive import RefusedError, RequestError
from friction_hil_drivers.serial_line.simulated.drives import SimulatedSerialDrives

if TYPE_CHECKING:
    from friction_hil_drivers.serial_line.simulated.drive import SimulatedDrive

ILLEGAL_FUNCTION, ILLEGAL_ADDRESS, ILLEGAL_VALUE = 1, 2, 3
_BROADCAST = 0
_CRC = 2
_HEADER = 7  # of a TCP frame: transaction, protocol, length, unit
_READS: dict[int, Table] = {1: "coil", 2: "discrete", 3: "holding", 4: "input"}
_WRITES: dict[int, Table] = {5: "coil", 6: "holding", 15: "coil", 16: "holding"}
_BOTH = 23
_REQUESTS: dict[int, type[ModbusPDU]] = {
    1: bits.ReadCoilsRequest,
    2: bits.ReadDiscreteInputsRequest,
    3: registers.ReadHoldingRegistersRequest,
    4: registers.ReadInputRegistersRequest,
    5: bits.WriteSingleCoilRequest,
    6: registers.WriteSingleRegisterRequest,
    15: bits.WriteMultipleCoilsRequest,
    16: registers.WriteMultipleRegistersRequest,
    _BOTH: registers.ReadWriteMultipleRegistersRequest,
}
_COIL_VALUES = (b"\xff\x00", b"\x00\x00")


class _RegisterSpace:
    """Registers and coils of one drive."""

    def __init__(self, drive: "SimulatedDrive", description: ModbusDescription) -> None:
        self._drive = drive
        self._description = description
        self._at: dict[
            tuple[Table, int], tuple[RegisterField, int]
        ] = {}  # signal at an address, and index of the register in it
        for name in description.signals:
            field = description.field(name)
            for k in range(field.end - field.address):
                self._at[field.table, field.address + k] = field, k
        tables = {table for table, _ in self._at}
        self._functions = {function for function, table in _READS.items() if table in tables or table == "holding"}
        self._functions |= {f for f in description.write_functions if _WRITES[f] in tables}
        if description.read_write_multiple:
            self._functions.add(_BOTH)
        self._half_written: dict[str, list[int]] = {}

    def answer(self, pdu: bytes) -> bytes:
        """Carry out a request and return the PDU of the reply."""
        try:
            if pdu[0] not in self._functions:
                raise RequestError(ILLEGAL_FUNCTION)
            request = _REQUESTS[pdu[0]]()
            try:
                request.decode(pdu[1:])
            except (ValueError, IndexError, struct.error, ModbusException):
                raise RequestError(ILLEGAL_VALUE) from None
            data = self._carry_out(request, pdu)
        except RequestError as reply:
            return bytes((pdu[0] | REFUSED, reply.number))
        return pdu[:1] + data

    def _carry_out(self, request: ModbusPDU, pdu: bytes) -> bytes:
        """Write, then read; return the reply after the function code."""
        if isinstance(request, registers.ReadWriteMultipleRegistersRequest):
            self._check(len(request.write_registers), request.write_count, pdu[9], len(pdu) - 10)
            found = self._found("holding", request.read_address, request.read_count)
            self._sample(found)
            self._write("holding", request.write_address, request.write_registers)
            return registers.ReadHoldingRegistersResponse(registers=self._words(found)).encode()
        function = request.function_code
        if function in _READS:
            found = self._found(_READS[function], request.address, request.count)
            self._sample(found)
            words = self._words(found)
            if function in (1, 2):
                return bits.ReadCoilsResponse(bits=[bool(word) for word in words]).encode()
            return registers.ReadHoldingRegistersResponse(registers=words).encode()
        if function == 16:
            self._check(len(request.registers), request.count, pdu[5], len(pdu) - 6)
        is_broken = function == 15 and not pdu[5] == len(pdu) - 6 == (request.count + 7) // 8
        if is_broken or (function == 5 and pdu[3:5] not in _COIL_VALUES):
            raise RequestError(ILLEGAL_VALUE)
        self._write(_WRITES[function], request.address, request.registers or [int(bit) for bit in request.bits])
        return pdu[1:5]

    def _check(self, given: int, count: int, byte_count: int, sent: int) -> None:
        if not 0 < given == count <= self._description.max_write_registers or not byte_count == sent == 2 * count:
            raise RequestError(ILLEGAL_VALUE)

    def _found(self, table: Table, address: int, count: int) -> list[tuple[RegisterField, int] | None]:
        """Return the registers at these addresses; None for unused ones that the drive allows to be read.

        Raises `RequestError`: the drive refuses to read one of the addresses.
        """
        description = self._description
        if table in ("holding", "input") and not 0 < count <= description.max_read_registers:
            raise RequestError(ILLEGAL_VALUE)
        found = list(self._fields(table, address, count))
        refuses_gaps = description.max_gap_registers == 0 and description.alignment == 1
        if not any(found) or (refuses_gaps and not all(found)):
            raise RequestError(ILLEGAL_ADDRESS)
        return found

    def _fields(self, table: Table, address: int, count: int) -> Iterator[tuple[RegisterField, int] | None]:
        alignment = self._description.alignment
        if address % alignment or count % alignment:
            raise RequestError(ILLEGAL_ADDRESS)
        for k in range(count):
            yield self._at.get((table, address + k))

    def _sample(self, found: Sequence[tuple[RegisterField, int] | None]) -> None:
        if any(entry is not None and entry[0].name == "position" for entry in found):
            self._drive.sample()

    def _words(self, found: Sequence[tuple[RegisterField, int] | None]) -> list[int]:
        fields = {entry[0].name: entry[0] for entry in found if entry is not None}
        words = {name: field.words(self._drive.read(name)) for name, field in fields.items()}
        return [0 if entry is None else words[entry[0].name][entry[1]] for entry in found]

    def _write(self, table: Table, address: int, words: Sequence[int]) -> None:
        found = list(self._fields(table, address, len(words)))
        if not any(found) or (self._description.alignment == 1 and not all(found)):
            raise RequestError(ILLEGAL_ADDRESS)
        for entry, word in zip(found, words, strict=True):
            if entry is not None:
                self._write_word(*entry, word)

    def _write_word(self, field: RegisterField, k: int, word: int) -> None:
        """Write one register; a number in two registers takes effect when the second is written."""
        if field.name not in self._half_written:
            self._half_written[field.name] = field.words(self._drive.read(field.name))
        words = self._half_written[field.name]
        words[k] = word
        if k < len(words) - 1:
            return
        del self._half_written[field.name]
        try:
            number = field.number(words)
            if not math.isfinite(number):
                raise RefusedError(f"{field.name} cannot be {number}")
            self._drive.write(field.name, self._unwrapped(number) if field.name == "position_command" else number)
        except RefusedError:
            raise RequestError(ILLEGAL_VALUE) from None

    def _unwrapped(self, command: float) -> float:
        """Return the commanded position nearest to the present one, of all that wrap to the same number."""
        actual, target = (self._description.signals[name] for name in ("position", "position_command"))
        if target.counter_bits is None or actual.unit != target.unit:
            return command
        present = round(self._drive.read("position") * actual.scale / target.scale)
        return float(unwrap(present, int(command), target.counter_bits))


class ModbusResponder:
    """Answers requests for the simulated drives on one line; see `Responder` of `serial_line.simulated.server`."""

    request_end = b""

    def __init__(
        self,
        drives: "Mapping[str, SimulatedDrive]",
        descriptions: Mapping[str, ModbusDescription],
        options: Mapping[str, ModbusOptions],
    ) -> None:
        self.by_address = {options[axis].unit: _RegisterSpace(drives[axis], descriptions[axis]) for axis in drives}
        self._is_tcp = next(iter(options.values())).line.is_tcp
        self._rtu = FramerRTU(DecodePDU(True))
        self._tcp = FramerSocket(DecodePDU(True))

    def take(self, received: bytearray) -> bytes | None:
        """Remove one whole request and return the reply; None if the request is not complete.

        The reply is empty if none is due: the request was for none of these drives, or damaged.
        """
        return self._take_tcp(received) if self._is_tcp else self._take_rtu(received)

    def forget(self) -> None:
        """Do nothing: no state is kept between requests."""

    def _take_rtu(self, received: bytearray) -> bytes | None:
        if len(received) < 2 + _CRC:
            return None
        is_frame = _has_crc(received)
        kind = _REQUESTS.get(received[1])
        # the length of an unknown function is unknown too: bytes with a correct CRC are a complete request
        size = (len(received) if is_frame else 0) if kind is None else kind.calculateRtuFrameSize(bytes(received))
        if not 0 < size <= len(received):
            return None
        frame = bytes(received[:size])
        if not _has_crc(frame):
            received.clear()
            return b""
        del received[:size]
        unit, pdu = frame[0], frame[1:-_CRC]
        if unit == _BROADCAST:
            for space in self.by_address.values():
                space.answer(pdu)
            return b""
        reply = self._answer(unit, pdu)
        return self._rtu.encode(reply, unit, 0) if reply else b""

    def _take_tcp(self, received: bytearray) -> bytes | None:
        if len(received) < _HEADER:
            return None
        transaction, protocol, length = (int.from_bytes(received[k : k + 2], "big") for k in (0, 2, 4))
        if protocol or length < 2:
            received.clear()
            return b""
        end = _HEADER - 1 + length
        if len(received) < end:
            return None
        unit, pdu = received[6], bytes(received[_HEADER:end])
        del received[:end]
        reply = self._answer(unit, pdu)
        return self._tcp.encode(reply, unit, transaction) if reply else b""

    def _answer(self, unit: int, pdu: bytes) -> bytes:
        return self.by_address[unit].answer(pdu) if unit in self.by_address else b""


def _has_crc(frame: bytes | bytearray) -> bool:
    return FramerRTU.check_CRC(bytes(frame[:-_CRC]), int.from_bytes(frame[-_CRC:], "big"))


class SimulatedModbusDrives(SimulatedSerialDrives):
    """Simulated drives that answer Modbus requests."""

    description_type = ModbusDescription
    descriptions = DESCRIPTIONS
    protocol = ModbusLine
    responder = ModbusResponder
