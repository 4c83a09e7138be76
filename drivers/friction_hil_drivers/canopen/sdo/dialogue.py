"""The SDO protocol: its frames, and one transfer as bytes in and bytes out. No bus, no clock.

Three drive a transfer: `sdo` waits for one node, `conversation` asks many at once, `side_channel` takes a step a cycle.
Source: CiA 301, 7.2.4.3 (expedited and segmented upload and download).
"""

import struct
from collections import Counter

from friction_hil_drivers.cia402.access import Abort
from friction_hil_drivers.cia402.objects import Address, Object

HEAD = struct.Struct("<BHB")  # command, index, sub-index
LAST_FOUR = struct.Struct("<I")  # abort code, or number of bytes of a segmented transfer
FRAME_BYTES = 8
_LONGEST_UPLOAD = 1 << 16  # bytes; a server may send segments without end

# Command specifiers of requests, and of the answer to each
SPECIFIER = 0xE0
DOWNLOAD_SEGMENT, DOWNLOAD, UPLOAD, UPLOAD_SEGMENT, ABORT = 0x00, 0x20, 0x40, 0x60, 0x80
ANSWERS = {DOWNLOAD_SEGMENT: 0x20, DOWNLOAD: 0x60, UPLOAD: 0x40, UPLOAD_SEGMENT: 0x00}
# The other bits of a command, whose numbers of unused bytes are in bits 2 and 3, of a segment in bits 1 to 3
TOGGLE, EXPEDITED, SIZE_INDICATED, LAST = 0x10, 0x02, 0x01, 0x01

SEGMENT: Address = (-1, -1)  # stands for the object of a segment, which names none


def abort(address: Address, code: int) -> bytes:
    """Return the frame by which either side ends a transfer."""
    return HEAD.pack(ABORT, *address) + LAST_FOUR.pack(code)


def abort_code(answer: bytes) -> int | None:
    """Return the code of an abort, None for another answer."""
    is_abort = len(answer) == FRAME_BYTES and answer[0] & SPECIFIER == ABORT
    return LAST_FOUR.unpack_from(answer, 4)[0] if is_abort else None


def requested(request: bytes | bytearray) -> Address | None:
    """Return the object of a request, `SEGMENT` for a segment, None for an abort and for what is used here nowhere."""
    if len(request) != FRAME_BYTES or request[0] & SPECIFIER not in ANSWERS:
        return None
    command, index, subindex = HEAD.unpack_from(request)
    return SEGMENT if command & SPECIFIER in (DOWNLOAD_SEGMENT, UPLOAD_SEGMENT) else (index, subindex)


def answered(answer: bytes) -> Address | None:
    """Return the object that an answer names, None for a segment, which names none."""
    if len(answer) != FRAME_BYTES or answer[0] & SPECIFIER in (0x00, 0x20):
        return None
    _, index, subindex = HEAD.unpack_from(answer)
    return index, subindex


def expedited(data: bytes, specifier: int) -> bytes | None:
    """Return the content of an expedited request ``DOWNLOAD``, or answer to ``UPLOAD``, that states how long it is."""
    if len(data) != FRAME_BYTES or data[0] & ~(TOGGLE | 0x0C) != specifier | EXPEDITED | SIZE_INDICATED:
        return None
    return data[4 : FRAME_BYTES - (data[0] >> 2 & 0x03)]


def describe(answer: bytes) -> str:
    """Return an answer in words: ``abort 06020000h for 60A9h:00``."""
    if len(answer) != FRAME_BYTES:
        return f"a frame of {len(answer)} bytes"
    address = answered(answer)
    if address is None:
        return "a segment"
    name = f"{address[0]:04X}h:{address[1]:02X}"
    code = abort_code(answer)
    if code is not None:
        return f"abort {code:08X}h for {name}"
    is_value = answer[0] & SPECIFIER == ANSWERS[UPLOAD]
    return f"{'the value of' if is_value else 'the confirmation of a write to'} {name}"


class Transfer:
    """One transfer with one node."""

    __slots__ = ("_toggle", "abort_code", "data", "entry", "is_done", "is_silent")

    _beginning = _segment = -1  # specifiers of the requests

    def __init__(self, entry: Object) -> None:
        self.entry = entry
        self.is_done = False
        self.is_silent = False  # the node did not answer; set by whoever keeps the time
        self.data: bytes | None = None  # as on the wire, b"" after a download; None until it came, and after an abort
        self.abort_code = 0  # 0 for none
        self._toggle: int | None = None  # of the segment under way; None: the request that begins the transfer is

    def first(self) -> bytes:
        """Return the first request; also begins again."""
        raise AssertionError("each direction has its own")

    def accepts(self, answer: bytes) -> bool:
        """Return True for the answer, or the abort, that belongs to the request under way.

        An answer names its object, a segment only its toggle bit. A server that knows of no transfer cannot name the
        object of a segment that it aborts: it says 0000h.
        """
        if self.is_done or len(answer) != FRAME_BYTES:
            return False
        address: Address = HEAD.unpack_from(answer)[1:]
        specifier = answer[0] & SPECIFIER
        if self._toggle is None:
            return address == self.entry.address and specifier in (ANSWERS[self._beginning], ABORT)
        if specifier == ABORT:
            return address in (self.entry.address, (0, 0))
        return specifier == ANSWERS[self._segment] and answer[0] & TOGGLE == self._toggle

    def take(self, answer: bytes) -> bytes | None:
        """Take an answer of the node, or pass over what is none; return the next request, if one follows."""
        if not self.accepts(answer):
            return None
        code = abort_code(answer)
        if code is None:
            return self._go_on(answer)
        self.abort_code, self.is_done = code, True
        return None

    @property
    def awaited(self) -> Address:
        """Object that the answer under way names, `SEGMENT` for a segment."""
        return self.entry.address if self._toggle is None else SEGMENT

    @property
    def value(self) -> int | None:
        """Integer that was read; None where the node lacks the object, refuses, is silent, or has no integer there."""
        if not self.data or len(self.data) > 8:
            return None
        return int.from_bytes(self.data, "little", signed=self.entry.type.is_signed)

    @property
    def is_accepted(self) -> bool:
        """True if the node has carried the transfer out."""
        return self.data is not None

    def _head(self, command: int) -> bytes:
        return HEAD.pack(command, self.entry.index, self.entry.subindex)

    def _go_on(self, answer: bytes) -> bytes | None:
        raise AssertionError("each direction has its own")

    def _next_toggle(self) -> int:
        self._toggle = 0 if self._toggle is None else self._toggle ^ TOGGLE
        return self._toggle

    def _end(self, data: bytes) -> None:
        self.data, self.is_done = data, True


class Upload(Transfer):
    """Read an object."""

    __slots__ = ("_segments",)

    _beginning, _segment = UPLOAD, UPLOAD_SEGMENT

    def first(self) -> bytes:
        """See `Transfer.first`."""
        self._toggle, self._segments = None, b""
        return self._head(UPLOAD) + bytes(4)

    def _go_on(self, answer: bytes) -> bytes | None:
        if self._toggle is not None:
            self._segments += answer[1 : FRAME_BYTES - (answer[0] >> 1 & 0x07)]
            if answer[0] & LAST:
                self._end(self._segments)
                return None
            if len(self._segments) > _LONGEST_UPLOAD:
                self.abort_code, self.is_done = Abort.OUT_OF_MEMORY, True
                return None
        elif answer[0] & EXPEDITED:
            content = expedited(answer, UPLOAD)
            # without a size it has as many bytes as its type
            self._end(answer[4 : 4 + (self.entry.type.bits // 8 or 4)] if content is None else content)
            return None
        return bytes([UPLOAD_SEGMENT | self._next_toggle()]) + bytes(7)


class Download(Transfer):
    """Write an object: its content, or an integer with as many bytes as its type has, or ``size``."""

    __slots__ = ("_content", "_left")

    _beginning, _segment = DOWNLOAD, DOWNLOAD_SEGMENT

    def __init__(self, entry: Object, content: bytes | int, size: int | None = None) -> None:
        super().__init__(entry)
        if isinstance(content, int):
            content = content.to_bytes(size or entry.type.bits // 8, "little", signed=content < 0)
        self._content = content

    def first(self) -> bytes:
        """See `Transfer.first`."""
        size = len(self._content)
        self._toggle = None
        self._left: bytes | None = None  # to be sent in segments; None: nothing is
        if 0 < size <= 4:
            head = self._head(DOWNLOAD | EXPEDITED | SIZE_INDICATED | 4 - size << 2)
            return head + self._content.ljust(4, b"\0")
        self._left = self._content
        return self._head(DOWNLOAD | SIZE_INDICATED) + LAST_FOUR.pack(size)

    def _go_on(self, answer: bytes) -> bytes | None:
        if self._left is None:
            self._end(b"")
            return None
        segment, left = self._left[:7], self._left[7:]
        self._left = left or None
        unused = 7 - len(segment)
        command = DOWNLOAD_SEGMENT | self._next_toggle() | unused << 1 | (0 if left else LAST)
        return bytes([command]) + segment + bytes(unused)


class OwedAnswers(Counter[Address]):
    """Answers that one server owes, by what they name, and ``strays``: those that arrived when nothing waited for them.

    A server answers in order. So a request for an object that still owes an answer has to wait for that one first: it
    could not tell the two apart.
    """

    def __init__(self) -> None:
        super().__init__()
        self.strays: list[bytes] = []

    def drop(self, answer: bytes) -> None:
        """Take an answer that belongs to no request, or to one that was given up."""
        self.strays.append(answer)
        address = answered(answer)
        if address is None or self[address] <= 0:
            address = SEGMENT  # or the abort of one
        self[address] = max(0, self[address] - 1)
