"""Packets of Dynamixel Protocol 2.0: header, stuffing, CRC.

Stuffing and the CRC are the vendor's SDK's. The rest of it is not used: dynamixel-sdk 4.1.0 for Python sends packets
that had to be stuffed as they were before; its receiver waits for bytes in a loop, believes a corrupted length and
swallows the packets behind it; and from a packet with one stuffed byte it drops bytes that were never stuffed (FD FD
behind a single FF).
"""

import importlib
from dataclasses import dataclass
from typing import Any

from friction_hil.errors import UsageError

PING, READ, WRITE, STATUS, SYNC_READ, SYNC_WRITE, FAST_SYNC_READ = 0x01, 0x02, 0x03, 0x55, 0x82, 0x83, 0x8A
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
    """Contents of a received packet.

    Attributes
    ----------
    id : int
        Whom an instruction is for, or who answers.
    instruction : int
    parameters : bytes
        Without stuffing; a status packet begins with its error field.
    is_whole : bool
        The CRC is right. Otherwise nothing of the packet is certain.
    skipped : int
        Bytes before the header.
    """

    id: int
    instruction: int
    parameters: bytes
    is_whole: bool
    skipped: int


class Packets:
    """Makes packets, and finds them among received bytes.

    Raises
    ------
    UsageError
        The SDK is not installed.
    """

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
        """Compute the CRC of data; ``before`` is the CRC of the data ahead of them."""
        crc: int = self._handler.updateCRC(before, data, len(data))
        return crc

    def cut(self, received: bytearray, longest: int) -> Packet | None:
        """Remove the first packet and the bytes before it; None while there is none.

        Behind a header whose packet is broken the search goes on with the next byte, so that no length that came
        wrong hides a packet that came right.

        Parameters
        ----------
        received : bytearray
            What came so far.
        longest : int
            The greatest value that the length field can have.
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
