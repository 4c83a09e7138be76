"""Which SDO answer belongs to which request (CiA 301, 7.2.4.3). Pure: no bus, no clock."""

import struct
from dataclasses import dataclass

_HEAD = struct.Struct("<BHB")
_CODE = struct.Struct("<I")
_SIZE = 8  # bytes of every SDO frame

# Command specifiers, in the upper three bits of the first byte: of a request, and of the answer to it
_DOWNLOAD_SEGMENT, _DOWNLOAD, _UPLOAD, _UPLOAD_SEGMENT = 0, 1, 2, 3
_ANSWERS = {_DOWNLOAD_SEGMENT: 1, _DOWNLOAD: 3, _UPLOAD: 2, _UPLOAD_SEGMENT: 0}
_ABORT = 0x80
_TOGGLE = 0x10

Address = tuple[int, int]  # index and sub-index

SEGMENT: Address = (-1, -1)  # stands for the object of a segment, which names none

# Why a server says that it has no such object, CiA 301, table 22
ABSENT = (0x06020000, 0x06090011)

WRITE_ONLY = 0x06010001

# ... and that it has one which cannot be read now: time-out, memory, write-only, hardware, local control, state
HIDDEN = (0x05040000, 0x05040005, WRITE_ONLY, 0x06060000, 0x08000020, 0x08000021, 0x08000022)


@dataclass(frozen=True, slots=True)
class Request:
    """A request under way.

    Attributes
    ----------
    address : tuple of int
        Index and sub-index of the object; a segment has that of its transfer.
    answer : int
        Command specifier that the answer to it has.
    toggle : int or None
        Toggle bit of a segment, None for a request that begins a transfer.
    """

    address: Address
    answer: int
    toggle: int | None

    @classmethod
    def of(cls, data: bytes | bytearray, transfer: Address) -> "Request":
        """Return what is to be expected after ``data`` was sent; ``transfer`` is the object of the transfer before."""
        command, index, subindex = _HEAD.unpack_from(data)
        specifier = command >> 5
        if specifier in (_DOWNLOAD_SEGMENT, _UPLOAD_SEGMENT):
            return cls(transfer, _ANSWERS[specifier], command & _TOGGLE)
        return cls((index, subindex), _ANSWERS[specifier], None)

    @staticmethod
    def is_one(data: bytes | bytearray) -> bool:
        """Return True for a request, False for an abort and for what is used here nowhere."""
        return len(data) == _SIZE and data[0] >> 5 in _ANSWERS

    @property
    def key(self) -> Address:
        """Key under which answers to equal requests are counted: the object, `SEGMENT` for a segment."""
        return SEGMENT if self.is_segment else self.address

    @property
    def is_segment(self) -> bool:
        """True for a segment of a transfer that has begun."""
        return self.toggle is not None

    def is_answered_by(self, data: bytes) -> bool:
        """Return True for the answer or the abort that belongs to this request.

        An answer names its object, a segment only its toggle bit. A server that knows of no transfer cannot name the
        object of a segment that it aborts: it says 0000h.
        """
        if len(data) != _SIZE:
            return False
        if data[0] == _ABORT:
            return address_of(data) == self.address or (self.is_segment and address_of(data) == (0, 0))
        if data[0] >> 5 != self.answer:
            return False
        if self.is_segment:
            return data[0] & _TOGGLE == self.toggle
        return address_of(data) == self.address


def address_of(data: bytes) -> Address | None:
    """Return the object that an answer names, None for a segment, which names none."""
    if len(data) != _SIZE or (data[0] != _ABORT and data[0] >> 5 in (0, 1)):
        return None
    _, index, subindex = _HEAD.unpack_from(data)
    return index, subindex


def abort_code(data: bytes) -> int | None:
    """Return the code of an abort, None for another answer."""
    return _CODE.unpack_from(data, 4)[0] if len(data) == _SIZE and data[0] == _ABORT else None


def describe(data: bytes) -> str:
    """Return an answer in words: ``abort 06020000h for 60A9h:00``."""
    if len(data) != _SIZE:
        return f"a frame of {len(data)} bytes"
    address = address_of(data)
    if address is None:
        return "a segment"
    name = f"{address[0]:04X}h:{address[1]:02X}"
    code = abort_code(data)
    if code is not None:
        return f"abort {code:08X}h for {name}"
    return f"{'the value of' if data[0] >> 5 == _ANSWERS[_UPLOAD] else 'the confirmation of a write to'} {name}"
