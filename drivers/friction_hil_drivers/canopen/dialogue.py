"""SDO transfers as bytes in and bytes out: no bus, no clock. An answer that is not that of the request is passed over.

Source: CiA 301, 7.2.4.3 (expedited and segmented upload, expedited download).
"""

import struct

from friction_hil_drivers.canopen.objects import Object

_HEAD = struct.Struct("<BHB")  # command, index, sub-index
_UPLOAD, _UPLOAD_SEGMENT, _DOWNLOAD = 0x40, 0x60, 0x20
_ABORT = 0x80
_TOGGLE = 0x10


class Transfer:
    """One transfer with one node.

    Attributes
    ----------
    entry : Object
    is_done : bool
    data : bytes or None
        Content that was read, as on the wire; b"" after a download; None while nothing has come, and after an abort.
    abort_code : int
        0 for none.
    is_silent : bool
        The node did not answer; set by whoever keeps the time.
    """

    def __init__(self, entry: Object) -> None:
        self.entry = entry
        self.is_done = False
        self.data: bytes | None = None
        self.abort_code = 0
        self.is_silent = False

    def first(self) -> bytes:
        """Return the first request; also begins again."""
        raise AssertionError("each direction has its own")

    def take(self, answer: bytes) -> bytes | None:
        """Take an answer of the node; return the next request, if one follows."""
        if self.is_done or len(answer) != 8:
            return None
        if answer[0] == _ABORT:
            if self._is_ours(answer):
                self.abort_code = int(struct.unpack_from("<I", answer, 4)[0])
                self.is_done = True
            return None
        return self._go_on(answer)

    @property
    def value(self) -> int | None:
        """Integer that was read; None where the node lacks the object, refuses, is silent, or has no integer there."""
        if not self.data or len(self.data) > 8:
            return None
        return int.from_bytes(self.data, "little", signed=self.entry.type.is_signed)

    @property
    def is_accepted(self) -> bool:
        """True if the node has carried the transfer out."""
        return self.is_done and not self.abort_code

    def _head(self, command: int) -> bytes:
        return _HEAD.pack(command, self.entry.index, self.entry.subindex)

    def _is_ours(self, answer: bytes) -> bool:
        return answer[1:4] == self._head(0)[1:]

    def _go_on(self, answer: bytes) -> bytes | None:
        raise AssertionError("each direction has its own")


class Upload(Transfer):
    """Read an object."""

    def first(self) -> bytes:
        """See `Transfer.first`."""
        self._segments: bytearray | None = None
        self._toggle = 0
        return self._head(_UPLOAD) + bytes(4)

    def _go_on(self, answer: bytes) -> bytes | None:
        if self._segments is not None:
            return self._take_segment(answer)
        if answer[0] & 0xE0 != _UPLOAD or not self._is_ours(answer):
            return None
        if answer[0] & 0x02:  # expedited
            size = 4 - (answer[0] >> 2 & 0x03) if answer[0] & 0x01 else (self.entry.type.bits // 8 or 4)
            self.data = answer[4 : 4 + size]
            self.is_done = True
            return None
        self._segments = bytearray()
        return bytes([_UPLOAD_SEGMENT]) + bytes(7)

    def _take_segment(self, answer: bytes) -> bytes | None:
        assert self._segments is not None
        if answer[0] & 0xE0 or answer[0] & _TOGGLE != self._toggle:
            return None
        self._segments += answer[1 : 8 - (answer[0] >> 1 & 0x07)]
        if answer[0] & 0x01:
            self.data = bytes(self._segments)
            self.is_done = True
            return None
        self._toggle ^= _TOGGLE
        return bytes([_UPLOAD_SEGMENT | self._toggle]) + bytes(7)


class Download(Transfer):
    """Write an integer of at most 4 bytes: as many as its type has, or ``size``."""

    def __init__(self, entry: Object, value: int, size: int | None = None) -> None:
        super().__init__(entry)
        self._value, self._size = value, size or entry.type.bits // 8

    def first(self) -> bytes:
        """See `Transfer.first`."""
        size = self._size
        data = self._value.to_bytes(size, "little", signed=self._value < 0)
        return self._head(_DOWNLOAD | 0x03 | (4 - size) << 2) + data.ljust(4, b"\0")

    def _go_on(self, answer: bytes) -> bytes | None:
        if answer[0] == 0x60 and self._is_ours(answer):
            self.data = b""
            self.is_done = True
        return None
