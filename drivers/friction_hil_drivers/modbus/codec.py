"""Modbus exchanges: requests made from process images, and replies stored in them."""

from collections.abc import Callable, Mapping, Sequence

from pymodbus.pdu import ModbusPDU
from pymodbus.pdu.bit_message import (
    ReadCoilsRequest,
    ReadCoilsResponse,
    ReadDiscreteInputsRequest,
    WriteMultipleCoilsRequest,
    WriteSingleCoilRequest,
)
from pymodbus.pdu.register_message import (
    ReadHoldingRegistersRequest,
    ReadInputRegistersRequest,
    ReadWriteMultipleRegistersRequest,
    WriteMultipleRegistersRequest,
    WriteSingleRegisterRequest,
)

from friction_hil_drivers.modbus.framing import REFUSED, Framing
from friction_hil_drivers.modbus.registers import BIT_TABLES, Layout, RegisterBlock
from friction_hil_drivers.serial_line.blocks import representable_numbers
from friction_hil_drivers.serial_line.protocol import Image, ReplyError, Single

_READ_REQUESTS: dict[str, type[ModbusPDU]] = {
    "holding": ReadHoldingRegistersRequest,
    "input": ReadInputRegistersRequest,
    "coil": ReadCoilsRequest,
    "discrete": ReadDiscreteInputsRequest,
}
# Modbus Application Protocol Specification V1.1b3, section 7
EXCEPTIONS = {
    1: "illegal function: it does not have this one",
    2: "illegal data address: not all of these registers exist",
    3: "illegal data value: it does not accept this value or this number of registers",
    4: "server device failure",
    5: "acknowledge: it will take a long time",
    6: "server device busy",
    7: "negative acknowledge",
    8: "memory parity error",
    10: "gateway path unavailable",
    11: "gateway target device failed to respond",
}


class ModbusExchange(Single):
    """A request to one drive and its reply; see `friction_hil_drivers.serial_line.protocol.Exchange`."""

    def __init__(
        self,
        framing: Framing,
        unit: int,  # address of the drive
        image: Image,  # has the numbers to write, and the reply fills it
        *,
        read: RegisterBlock | None = None,  # an exchange with both `read` and `write` uses function 23
        write: RegisterBlock | None = None,
        write_functions: Sequence[int] = (),  # that the drive has
    ) -> None:
        self._framing = framing
        self._unit = unit
        self._image = image
        self._read = read
        self.addressees = self.unanswered = frozenset((str(unit),))
        self.reads = read.names if read is not None else ()
        self.writes = write.names if write is not None else ()
        self._is_bits = read is not None and read.table in BIT_TABLES
        self._layout = None if read is None or self._is_bits else Layout(read)
        self._start, self._pack = _parts(read, write, write_functions)
        verbs = [f"write {write}"] if write is not None else []
        verbs += [f"read {read}"] if read is not None else []
        self.label = f"{' and '.join(verbs)} of unit {unit}"
        pdu = self._start if self._pack is None else self._start + self._pack(dict.fromkeys(self.writes, 0.0))
        self._head = self._reply_head(pdu)
        if read is None:
            self._reply_length = 5  # function, address, and the value or the number of registers
        else:
            self._reply_length = len(self._head) + self._head[1]
        self.request_size = len(pdu) + framing.overhead
        self.reply_size = self._reply_length + framing.overhead

    def encode(self) -> bytes:
        """Return the request with the numbers of the image. Raises `ValueError`: a number is not finite."""
        try:
            pdu = self._start if self._pack is None else self._start + self._pack(self._image.values)
        except ValueError as error:
            raise ValueError(f"{self.label}: {error}") from None
        if self._read is None:
            self._head = self._reply_head(pdu)
        return self._framing.frame(self._unit, pdu)

    def _reply_head(self, pdu: bytes) -> bytes:
        """Return the first bytes of a reply other than an exception; the reply to a write repeats the request."""
        if self._read is None:
            return pdu[:5]
        size = (self._read.count + 7) // 8 if self._is_bits else 2 * self._read.count
        return bytes((pdu[0], size))

    def take(self, received: bytearray) -> bool:
        """Remove the reply from ``received`` and store it in the image; return True if it was complete.

        Raises `ReplyError`: the bytes are no reply to this request, or the drive refuses it.
        """
        pdu = self._framing.cut(received, self._unit, self._head, self._reply_length)
        if pdu is None:
            return False
        if pdu[0] & REFUSED:
            text = EXCEPTIONS.get(pdu[1], "not one of the standard ones")
            raise ReplyError(f"unit {self._unit} refuses: {text} (exception {pdu[1]})", is_complete=True)
        if self._layout is not None:
            self._image.put(self.reads, self._layout.unpack(pdu[2:]))
        elif self._read is not None:
            self._image.put(self.reads, _bits(self._read, pdu[1:]))
        return True


def _bits(block: RegisterBlock, data: bytes) -> list[float]:
    response = ReadCoilsResponse()
    response.decode(data)
    return [float(response.bits[field.address - block.address]) for field in block.fields]


def _pdu(request: ModbusPDU) -> bytes:
    return bytes((request.function_code,)) + request.encode()


_Pack = Callable[[Mapping[str, float]], bytes]


def _parts(
    read: RegisterBlock | None, write: RegisterBlock | None, functions: Sequence[int]
) -> tuple[bytes, _Pack | None]:
    """Return the constant beginning of a request, and the function that makes its rest from the numbers to write."""
    if write is None:
        assert read is not None
        return _pdu(_READ_REQUESTS[read.table](address=read.address, count=read.count)), None
    is_single = write.count == 1
    if write.table == "coil":
        return b"", _coil_writer(
            write, WriteSingleCoilRequest if is_single and 5 in functions else WriteMultipleCoilsRequest
        )
    layout, zeros = Layout(write), [0] * write.count
    request: ModbusPDU
    if read is not None:
        request = ReadWriteMultipleRegistersRequest(read.address, read.count, write.address, zeros)
    else:
        kind = WriteSingleRegisterRequest if is_single and 6 in functions else WriteMultipleRegistersRequest
        request = kind(address=write.address, registers=zeros)
    return _pdu(request)[: -layout.size], layout.pack


def _coil_writer(block: RegisterBlock, kind: type[ModbusPDU]) -> _Pack:
    def make(values: Mapping[str, float]) -> bytes:
        bits = [False] * block.count
        for field, number in zip(block.fields, representable_numbers(block.fields, values), strict=True):
            bits[field.address - block.address] = bool(number)
        return _pdu(kind(address=block.address, bits=bits))

    return make
