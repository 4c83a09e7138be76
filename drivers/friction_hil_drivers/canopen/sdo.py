"""Reading and writing a drive's object dictionary, with errors that say what and where."""

import struct
from typing import Any

from friction_hil.errors import DriveError
from friction_hil_drivers.canopen.objects import DataType, Object

_MISSING = (0x06020000, 0x06090011)
_ATTEMPTS = 3


class ObjectAccess:
    """SDO client of one node.

    Parameters
    ----------
    node
        ``canopen.RemoteNode`` on a network that is being read.
    axis : str
        Name of the axis, for messages.
    where : str
        Node and bus, for messages.
    """

    def __init__(self, node: Any, axis: str, where: str) -> None:
        self._sdo = node.sdo
        self._sdo.RESPONSE_TIMEOUT = 0.5
        self.axis = axis
        self.where = where

    def bytes_of(self, entry: Object) -> bytes | None:
        """Content of an object as it stands on the wire, None where the drive has no such object.

        Raises
        ------
        DriveError
            The drive does not answer, or refuses.
        """
        import canopen

        for attempt in range(_ATTEMPTS):
            try:
                return bytes(self._sdo.upload(entry.index, entry.subindex))
            except canopen.SdoAbortedError as error:
                if error.code in _MISSING:
                    return None
                raise DriveError(f"{self.axis}: reading {entry} from {self.where}: {error}") from error
            except canopen.SdoCommunicationError as error:
                if attempt == _ATTEMPTS - 1:
                    raise DriveError(
                        f"{self.axis}: nobody answers as {self.where} (reading {entry}): is the drive on, is this "
                        "its node number, and does the bit rate fit?"
                    ) from error
        return None

    def find(self, entry: Object) -> int | None:
        """Value of an integer object, None where the drive has no such object."""
        data = self.bytes_of(entry)
        if data is None:
            return None
        if len(data) not in (1, 2, 4):
            raise DriveError(f"{self.axis}: {entry} of {self.where} has {len(data)} bytes; no integer has that many")
        is_signed = entry.type in (DataType.INTEGER8, DataType.INTEGER16, DataType.INTEGER32)
        return int.from_bytes(data, "little", signed=is_signed)

    def read(self, entry: Object) -> int:
        """Value of an integer object that the drive must have."""
        value = self.find(entry)
        if value is None:
            raise DriveError(f"{self.axis}: {self.where} lacks object {entry}, which is needed")
        return value

    def width(self, entry: Object) -> int | None:
        """Width in bits that the drive gives an object, None where it lacks it."""
        data = self.bytes_of(entry)
        return None if data is None else 8 * len(data)

    def write(self, entry: Object, value: int, bits: int | None = None) -> None:
        """Write an integer object.

        Raises
        ------
        DriveError
            The drive does not answer, or refuses; the message has the value.
        """
        import canopen

        low, high = entry.type.bounds
        if not low <= value <= high:
            raise DriveError(f"{self.axis}: {value} does not fit into {entry} ({low} to {high})")
        data = value.to_bytes((bits or entry.type.bits) // 8, "little", signed=value < 0)
        try:
            self._sdo.download(entry.index, entry.subindex, data)
        except canopen.SdoAbortedError as error:
            raise DriveError(f"{self.axis}: writing {value} to {entry} of {self.where}: {error}") from error
        except canopen.SdoCommunicationError as error:
            raise DriveError(f"{self.axis}: {self.where} stopped answering (writing {entry})") from error

    def try_write(self, entry: Object, value: int) -> bool:
        """Write an object that the drive may lack or refuse; whether it then reads back as written."""
        try:
            self.write(entry, value)
        except DriveError:
            return False
        return self.find(entry) == value


def integer_format(bits: int, is_signed: bool) -> str:
    """Format character of `struct` for an integer of so many bits."""
    code = {8: "b", 16: "h", 32: "i"}[bits]
    return code if is_signed else code.upper()


def size_of(layout: str) -> int:
    """Bytes of a little-endian `struct` layout."""
    return struct.calcsize(f"<{layout}")
