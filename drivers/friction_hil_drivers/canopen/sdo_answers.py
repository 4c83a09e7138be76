"""Which SDO answer belongs to which request (CiA 301, 7.2.4.3). Pure: no bus, no clock."""

from dataclasses import dataclass

from friction_hil_drivers.canopen.dialogue import (
    ABORT,
    ANSWERS,
    DOWNLOAD_SEGMENT,
    FRAME_BYTES,
    HEAD,
    SEGMENT,
    SPECIFIER,
    TOGGLE,
    UPLOAD_SEGMENT,
    Address,
    answered,
)


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
        command, index, subindex = HEAD.unpack_from(data)
        specifier = command & SPECIFIER
        if specifier in (DOWNLOAD_SEGMENT, UPLOAD_SEGMENT):
            return cls(transfer, ANSWERS[specifier], command & TOGGLE)
        return cls((index, subindex), ANSWERS[specifier], None)

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
        if len(data) != FRAME_BYTES:
            return False
        if data[0] == ABORT:
            return answered(data) == self.address or (self.is_segment and answered(data) == (0, 0))
        if data[0] & SPECIFIER != self.answer:
            return False
        if self.is_segment:
            return data[0] & TOGGLE == self.toggle
        return answered(data) == self.address
