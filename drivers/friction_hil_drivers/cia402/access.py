"""Objects of a drive: reading them, from the drive itself or from a log of its answers, and why a drive refuses."""

from abc import ABC, abstractmethod
from enum import IntEnum
from typing import Protocol

from friction_hil.errors import DriveError
from friction_hil_drivers.cia402 import codes
from friction_hil_drivers.cia402.objects import Object


class Abort(IntEnum):
    """Abort codes (CiA 301, table 22)."""

    TOGGLE = 0x05030000
    TIME_OUT = 0x05040000
    COMMAND = 0x05040001
    OUT_OF_MEMORY = 0x05040005
    UNSUPPORTED_ACCESS = 0x06010000
    WRITE_ONLY = 0x06010001
    READ_ONLY = 0x06010002
    NO_OBJECT = 0x06020000
    NOT_MAPPABLE = 0x06040041
    PDO_TOO_LONG = 0x06040042
    INCOMPATIBLE = 0x06040043
    HARDWARE = 0x06060000
    LENGTH = 0x06070010
    NO_SUBINDEX = 0x06090011
    VALUE = 0x06090030
    TOO_HIGH = 0x06090031
    TOO_LOW = 0x06090032
    NOT_TRANSFERRED = 0x08000020
    LOCAL_CONTROL = 0x08000021
    DEVICE_STATE = 0x08000022
    NO_DATA = 0x08000024


# Why a server says that it has no such object ...
ABSENT = (Abort.NO_OBJECT, Abort.NO_SUBINDEX)
# ... and that it has one which cannot be read now
HIDDEN = (
    Abort.TIME_OUT,
    Abort.OUT_OF_MEMORY,
    Abort.WRITE_ONLY,
    Abort.HARDWARE,
    Abort.NOT_TRANSFERRED,
    Abort.LOCAL_CONTROL,
    Abort.DEVICE_STATE,
)


class AbortError(Exception):
    """Refusal of a drive to show or to take an object, with its abort code; in ``words``, where the bus has them."""

    def __init__(self, code: int, words: str = "") -> None:
        super().__init__(words or f"{code:08X}h")
        self.code = code


class RefusedError(DriveError):
    """An object was not written because the drive refuses it."""

    def __init__(self, text: str) -> None:
        super().__init__(text, code=codes.SDO_ABORT)


class Reading(Protocol):
    """Reading of an object that is over."""

    @property
    def data(self) -> bytes | None:
        """Content as on the wire, None where the drive refused it or did not answer."""

    @property
    def is_silent(self) -> bool:
        """True if the drive did not answer."""


class ObjectReader(ABC):
    """Objects of one drive; all that reads or writes raises a `DriveError` if it does not answer."""

    axis: str  # its name, for messages
    where: str  # node and bus (or log), for messages

    @abstractmethod
    def bytes_of(self, entry: Object) -> bytes | None:
        """Return the content of an object as on the wire, None where the drive has no such object."""

    def why_absent(self, entry: Object) -> str:
        """Return why an object counts as absent, as the verb of a sentence: ``lacks``."""
        return "lacks"

    def why_hidden(self, entry: Object) -> str:
        """Return why an object that the drive has could not be read, "" for another."""
        return ""

    def width(self, entry: Object) -> int | None:
        """Return the width in bits that the drive gives an object, None where it has no such object."""
        data = self.bytes_of(entry)
        return None if data is None else 8 * len(data)

    def find(self, entry: Object) -> int | None:
        """Return the value of an integer object, None where the drive has no such object."""
        data = self.bytes_of(entry)
        if data is None:
            return None
        if len(data) not in (1, 2, 4):
            text = f"{self.axis}: {entry} of {self.where} has {len(data)} bytes; integers have 1, 2 or 4"
            raise DriveError(text, code=codes.OBJECT_SIZE)
        return int.from_bytes(data, "little", signed=entry.type.is_signed)

    def read(self, entry: Object) -> int:
        """Return the value of an integer object that the drive must have."""
        value = self.find(entry)
        if value is None:
            text = f"{self.axis}: {self.where} {self.why_absent(entry)} object {entry}, which is needed"
            raise DriveError(text, code=codes.OBJECT_MISSING)
        return value


def hexadecimal(data: bytes | None) -> str:
    """Return the content of an object as a number: ``007E003Ch``."""
    return "not shown" if data is None else f"{int.from_bytes(data, 'little'):0{2 * len(data)}X}h"
