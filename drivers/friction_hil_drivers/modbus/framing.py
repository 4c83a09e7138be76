"""Frames around Modbus requests and replies: RTU and TCP.

The framers of pymodbus make the frames and check the CRC. They are not used to find a reply among received bytes: they
do not know which reply is expected, and after noise they drop bytes of a good reply.
"""

from typing import Protocol

from pymodbus.framer import FramerRTU, FramerSocket
from pymodbus.pdu import DecodePDU

from friction_hil_drivers.serial_line.protocol import ReplyError, in_hex

REFUSED = 0x80  # this bit of the function code marks an exception
_CRC = 2
_REFUSAL_SIZE = 5  # unit, function, code, CRC
_HEADER = 7  # transaction, protocol, length, unit
_LONGEST_BODY = 254  # of a TCP frame: unit and PDU


class Framing(Protocol):
    """Framing of requests and replies on a line."""

    overhead: int  # characters beside the PDU
    reply_form: str  # see `LineProtocol`

    def show(self, data: bytes | bytearray) -> str:
        """Return bytes as messages show them."""
        ...

    def frame(self, unit: int, pdu: bytes) -> bytes:
        """Return the frame of a request."""
        ...

    def cut(self, received: bytearray, unit: int, head: bytes, size: int) -> bytes | None:
        """Remove the reply to the last request, and return its PDU; None while it is not complete.

        ``head``: first bytes of the PDU that is expected; ``size``: its length. Raises `ReplyError`: what came is no
        reply to this request.
        """
        ...


class RtuFraming:
    """Frames on a serial line: unit, PDU, CRC."""

    overhead = 1 + _CRC
    reply_form = "a reply begins with the unit and the function, and ends in a CRC-16"

    def __init__(self) -> None:
        self._framer = FramerRTU(DecodePDU(False))
        self._sent = b""

    def frame(self, unit: int, pdu: bytes) -> bytes:
        """Return the frame of a request."""
        self._sent = self._framer.encode(pdu, unit, 0)
        return self._sent

    def cut(self, received: bytearray, unit: int, head: bytes, size: int) -> bytes | None:
        """Remove noise and the reply, and return its PDU; see `Framing.cut`."""
        start = bytes((unit,)) + head
        refused = head[0] | REFUSED
        is_begun = False
        for k, first in enumerate(received):
            if first != unit:
                continue
            rest = received[k : k + size + self.overhead]
            if start.startswith(rest[: len(start)]):
                is_ours, whole = True, size + self.overhead
            elif rest[1] & REFUSED:  # not always with the requested function: Kinco refuses 3 with 81h
                is_ours, whole = rest[1] == refused, _REFUSAL_SIZE
            else:
                continue
            if len(rest) >= whole and _has_crc(rest[:whole]):
                del received[: k + whole]
                return bytes(rest[1 : whole - _CRC])
            if is_ours:
                if len(rest) >= whole:
                    raise _wrong(received, "its CRC is wrong")
                if k == 0:  # the beginning of the reply: no other frame can be complete
                    return None
                is_begun = True
                break
        if _has_crc(received):
            raise _wrong(received, self._stranger(received, unit, head[0]))
        if not is_begun and len(received) >= size + self.overhead:
            raise _wrong(received, f"no reply of unit {unit} to function {head[0]} is in it")
        return None

    def show(self, data: bytes | bytearray) -> str:
        """Return bytes in hexadecimal numbers, and unit and function of a whole frame."""
        if not _has_crc(data):
            return in_hex(data)
        return f"{in_hex(data)} (unit {data[0]}, function {data[1] & ~REFUSED})"

    def _stranger(self, frame: bytearray, unit: int, function: int) -> str:
        if frame == self._sent:
            return "that is the request itself: the line echoes what is sent; switch the echo of the adapter off"
        if frame[0] != unit:
            return f"unit {frame[0]} answered instead of unit {unit}"
        if frame[1] != function:
            return f"function {frame[1]} was answered instead of {function}"
        return "the number or the address of the registers is not as requested"


class TcpFraming:
    """Frames on a TCP connection: a header with a transaction number and the unit, then the PDU."""

    overhead = _HEADER
    reply_form = "a reply begins with the number of the request and 00 00"

    def __init__(self) -> None:
        self._framer = FramerSocket(DecodePDU(False))
        self._transaction = 0

    def frame(self, unit: int, pdu: bytes) -> bytes:
        """Return the frame of a request, with the next transaction number."""
        self._transaction = self._transaction % 0xFFFF + 1
        return self._framer.encode(pdu, unit, self._transaction)

    def cut(self, received: bytearray, unit: int, head: bytes, size: int) -> bytes | None:
        """Remove the reply and earlier replies before it, and return its PDU; see `Framing.cut`."""
        while len(received) >= _HEADER:
            transaction, protocol, length = (int.from_bytes(received[k : k + 2], "big") for k in (0, 2, 4))
            if protocol or not 2 < length <= _LONGEST_BODY:
                raise _wrong(received, "that is no header of Modbus TCP")
            end = _HEADER - 1 + length
            if len(received) < end:
                return None
            frame = bytes(received[:end])
            del received[:end]
            if transaction != self._transaction:  # the late reply to an earlier request
                continue
            if frame[6] != unit:
                raise ReplyError(f"unit {frame[6]} answered instead of unit {unit}", is_complete=True)
            pdu = frame[_HEADER:]
            if not pdu[0] & REFUSED and (len(pdu) != size or not pdu.startswith(head)):
                raise ReplyError(f"that is no reply to function {head[0]}: {in_hex(frame)}", is_complete=True)
            return pdu
        return None

    def show(self, data: bytes | bytearray) -> str:
        """Return bytes in hexadecimal numbers."""
        return in_hex(data)


def _has_crc(frame: bytes | bytearray) -> bool:
    """Return True if the frame has a correct CRC, whatever its contents."""
    if len(frame) < _REFUSAL_SIZE:
        return False
    return FramerRTU.check_CRC(bytes(frame[:-_CRC]), int.from_bytes(frame[-_CRC:], "big"))


def _wrong(received: bytearray, why: str) -> ReplyError:
    error = ReplyError(f"{why}: {in_hex(received)}")
    received.clear()
    return error
