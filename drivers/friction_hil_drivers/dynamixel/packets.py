"""Packets of Dynamixel Protocol 2.0: header, stuffing, CRC.

Stuffing and CRC are computed by the vendor's SDK. Its other functions are not used, because dynamixel-sdk 4.1.0 for
Python sends packets without the stuffing that they need; its receiver waits for bytes in a loop, trusts a damaged
length and then drops the packets after it; and from a packet with one stuffed byte it also removes bytes that were
not stuffed (FD FD after a single FF).
"""

import importlib
from dataclasses import dataclass
from typing import Any

from friction_hil.errors import UsageError

PING, READ, WRITE, REBOOT, STATUS = 0x01, 0x02, 0x03, 0x08, 0x55
SYNC_READ, SYNC_WRITE, FAST_SYNC_READ = 0x82, 0x83, 0x8A
BROADCAST = 254
HEADER = b"\xff\xff\xfd\x00"
PREFIX = len(HEADER) + 3  # header, ID, length
CRC = 2
REQUEST_SIZE = PREFIX + 1 + CRC  # without parameters
STATUS_SIZE = PREFIX + 2 + CRC
_LEAST_LENGTH = 1 + CRC
_STUFFED, _PLAIN = b"\xff\xff\xfd\xfd", b"\xff\xff\xfd"


@dataclass(frozen=True, slots=True)
class Packet:
    """Contents of a received packet."""

    id: int  # of the servo to which an instruction is sent, or that answers
    instruction: int
    parameters: bytes  # without stuffing; those of a status packet begin with the error field
    is_whole: bool  # the CRC is correct; otherwise all fields may be wrong
    skipped: int  # bytes before the header


class Packets:
    """Makes packets, and finds packets in received bytes. Raises `UsageError`: the SDK is not installed."""

    def __init__(self) -> None:
        try:
            sdk = importlib.import_module("dynamixel_sdk.protocol2_packet_handler")
        except ImportError:
            raise UsageError("Dynamixel servos need another package: pip install 'friction-hil[dynamixel]'") from None
        self._handler: Any = sdk.Protocol2PacketHandler()

    def pack(self, servo: int, instruction: int, parameters: bytes = b"") -> bytes:
        """Make a packet."""
        length = _LEAST_LENGTH + len(parameters)
        bare = [*HEADER, servo, *length.to_bytes(2, "little"), instruction, *parameters, 0, 0]
        stuffed = bytes(self._handler.addStuffing(bare)[:-CRC])
        return stuffed + self.crc(stuffed).to_bytes(CRC, "little")

    def crc(self, data: bytes | bytearray, before: int = 0) -> int:
        """Compute the CRC of data; ``before`` is the CRC of the data that precede them."""
        crc: int = self._handler.updateCRC(before, data, len(data))
        return crc

    def cut(self, received: bytearray, longest: int) -> Packet | None:
        """Remove the first packet and the bytes before it, and return the packet; None if none is complete.

        Of a damaged packet only the header is removed, so that a wrong length cannot hide an intact packet.

        ``longest``: greatest valid value of the length field.
        """
        skipped = 0
        while (start := received.find(HEADER)) >= 0:
            del received[:start]
            skipped += start
            if len(received) < PREFIX:
                return None
            length = int.from_bytes(received[PREFIX - 2 : PREFIX], "little")
            end = PREFIX + length
            if _LEAST_LENGTH <= length <= longest:
                if len(received) >= end:
                    return self._first(received, end, skipped)
                if received.find(HEADER, len(HEADER)) < 0:  # stuffing keeps headers out of a packet
                    return None
            del received[: len(HEADER)]
            skipped += len(HEADER)
        del received[: max(0, len(received) - len(HEADER) + 1)]  # the rest may be the beginning of a header
        return None

    def _first(self, received: bytearray, end: int, skipped: int) -> Packet:
        body = bytes(received[PREFIX : end - CRC]).replace(_STUFFED, _PLAIN)
        is_whole = self.crc(received[: end - CRC]) == int.from_bytes(received[end - CRC : end], "little")
        packet = Packet(received[len(HEADER)], body[0], body[1:], is_whole, skipped)
        del received[: end if is_whole else len(HEADER)]
        return packet
