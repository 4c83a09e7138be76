"""SDO client: a drive's object dictionary, read and written while the drive is being configured."""

import contextlib
from collections.abc import Iterator
from typing import Any

import can
import canopen

from friction_hil.errors import DriveError
from friction_hil_drivers.canopen import codes
from friction_hil_drivers.canopen.object_reader import ObjectReader
from friction_hil_drivers.canopen.objects import Object

_RESPONSE_TIMEOUT_S = 0.5
_NOTIFIER_TIMEOUT_S = 0.02
_ATTEMPTS = 3
_NO_SUCH_OBJECT = (0x06020000, 0x06090011)


class SdoClient(ObjectReader):
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
        self._sdo.RESPONSE_TIMEOUT = _RESPONSE_TIMEOUT_S
        self.axis = axis
        self.where = where

    def bytes_of(self, entry: Object) -> bytes | None:
        """See `ObjectReader.bytes_of`."""
        for attempt in range(_ATTEMPTS):
            try:
                return bytes(self._sdo.upload(entry.index, entry.subindex))
            except canopen.SdoAbortedError as error:
                if error.code in _NO_SUCH_OBJECT:
                    return None
                text = f"{self.axis}: reading {entry} from {self.where}: {error}"
                raise DriveError(text, code=codes.SDO_ABORT) from error
            except canopen.SdoCommunicationError as error:
                if attempt == _ATTEMPTS - 1:
                    text = (
                        f"{self.axis}: no drive answers as {self.where} (reading {entry}): is the drive on, is this "
                        "its node number, and is the bit rate right?"
                    )
                    raise DriveError(text, code=codes.NO_ANSWER) from error
        return None

    def write(self, entry: Object, value: int, bits: int | None = None) -> None:
        """Write an integer object, with the width that its type has or ``bits``.

        Raises
        ------
        DriveError
            The drive does not answer, or refuses; the message has the value.
        """
        low, high = entry.type.bounds
        if not low <= value <= high:
            text = f"{self.axis}: {value} does not fit into {entry} ({low} to {high})"
            raise DriveError(text, code=codes.OBJECT_SIZE)
        data = value.to_bytes((bits or entry.type.bits) // 8, "little", signed=value < 0)
        try:
            self._sdo.download(entry.index, entry.subindex, data)
        except canopen.SdoAbortedError as error:
            text = f"{self.axis}: writing {value} to {entry} of {self.where}: {error}"
            raise DriveError(text, code=codes.SDO_ABORT) from error
        except canopen.SdoCommunicationError as error:
            text = f"{self.axis}: {self.where} stopped answering (writing {entry})"
            raise DriveError(text, code=codes.ANSWER_LOST) from error

    def try_write(self, entry: Object, value: int) -> bool:
        """Write an object that the drive may lack or refuse; return True if it reads back as written."""
        try:
            self.write(entry, value)
        except DriveError:
            return False
        return self.find(entry) == value


class SdoNetwork:
    """SDO clients of the nodes on one bus, through the canopen library."""

    def __init__(self, bus: can.BusABC) -> None:
        self._bus = bus
        self._network: Any = canopen.Network(bus)

    def client(self, node: int, axis: str, where: str) -> SdoClient:
        """Return the SDO client of a node; `axis` and `where` are for its messages."""
        return SdoClient(self._network.add_node(node, object_dictionary=None), axis, where)

    @contextlib.contextmanager
    def reading(self) -> Iterator[None]:
        """Let a thread of the library read the bus, for its clients; it has ended afterwards."""
        self._network.notifier = can.Notifier(self._bus, self._network.listeners, _NOTIFIER_TIMEOUT_S)
        try:
            yield
        finally:
            self._network.notifier.stop()
