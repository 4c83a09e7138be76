"""One daemon for each axis: a lock that the kernel releases when its owner ends, even by a crash.

The lock is the name of a Unix-domain socket in Linux's abstract namespace. It is no file: nothing is left behind that
another user could not open, no folder has to be shared, and no link can be placed in its way. Whoever runs owns it;
others see the owner's process number through the socket. The name is seen in one network namespace, to which a CAN
interface and the groups of udp_multicast belong as well: whoever reaches the bus sees the lock. An adapter that is
a device file (slcan) can be passed to several containers, each with a network namespace of its own; these do not see
each other's locks.
"""

import errno
import hashlib
import os
import re
import socket
import stat
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from friction_hil.drive.socket_owner import owner
from friction_hil.errors import DriveError
from friction_hil_drivers.canopen import codes
from friction_hil_drivers.canopen.wire.interfaces import bus_name

if TYPE_CHECKING:
    from friction_hil.config import BusConfig

_LONGEST_NAME = 107  # bytes behind the leading zero, unix(7)
_MULTICAST_PORT = 43113  # of python-can, where the configuration names none


def state_path(bus: "BusConfig", node: int, suffix: str) -> Path:
    """Return the path of a file about one node of a bus, in the folder for temporary files."""
    return Path(tempfile.gettempdir()) / (re.sub(r"\W+", "-", f"friction_hil-{bus_name(bus)}-{node}") + suffix)


class AxisLock:
    """Lock of one node of a bus; a `DriveError` names process and user of the daemon that holds it already."""

    def __init__(self, bus: "BusConfig", node: int, axis: str) -> None:
        name = _socket_name(bus, node)
        self._socket: socket.socket | None = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            self._socket.bind(name)
            self._socket.listen(socket.SOMAXCONN)  # nothing is accepted: whoever connects sees who listens
        except OSError as error:
            self.release()
            if error.errno != errno.EADDRINUSE:
                text = f"{axis}: the lock of node {node} on {bus_name(bus)} cannot be taken: {error.strerror}"
                raise DriveError(text, code=codes.LOCK_FAILED) from error
            text = f"{axis}: node {node} on {bus_name(bus)} belongs to another daemon already ({owner(name)})"
            raise DriveError(text, "stop that one first", code=codes.NODE_LOCKED) from None

    def release(self) -> None:
        """Release the axis; safe to call twice."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None


def _socket_name(bus: "BusConfig", node: int) -> bytes:
    """Return the name of the lock: the same for each way to write the same bus, another one for each other bus."""
    text = f"friction_hil axis lock, {_bus_identity(bus)}, node {node}".encode()
    if len(text) > _LONGEST_NAME:
        text = b"friction_hil axis lock, " + hashlib.sha256(text).hexdigest().encode()
    return b"\0" + text


def _bus_identity(bus: "BusConfig") -> str:
    if bus.interface == "udp_multicast":
        return f"udp_multicast {bus.channel}:{bus.port or _MULTICAST_PORT}"
    if bus.interface == "virtual":  # does not leave its process
        return f"virtual {bus.channel} of process {os.getpid()}"
    device = str(bus.channel).partition("@")[0]  # slcan: /dev/ttyACM0@115200
    if os.path.isabs(device):
        try:
            found = os.stat(device)  # /dev/serial/by-id/... is a link to it
        except OSError:
            return f"{bus.interface} {device}"
        if stat.S_ISCHR(found.st_mode):
            return f"device {os.major(found.st_rdev)}:{os.minor(found.st_rdev)}"
    return f"{bus.interface} {bus.channel}"
