"""One daemon for each axis: a lock that the kernel releases when its owner ends, even by a crash."""

import os
import re
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from friction_hil.errors import DriveError
from friction_hil_drivers.canopen import codes
from friction_hil_drivers.canopen.interfaces import bus_name

if TYPE_CHECKING:
    from friction_hil.config import BusConfig


def state_path(bus: "BusConfig", node: int, suffix: str) -> Path:
    """Return the path of a file about one node of a bus, in the folder for temporary files."""
    return Path(tempfile.gettempdir()) / (re.sub(r"\W+", "-", f"friction_hil-{bus_name(bus)}-{node}") + suffix)


class AxisLock:
    """Lock of one node of a bus, held by the daemon of this machine that drives it.

    Raises
    ------
    DriveError
        Another process holds it; the message names its process number.
    """

    def __init__(self, bus: "BusConfig", node: int, axis: str) -> None:
        self._path = state_path(bus, node, ".lock")
        self._descriptor = self._open(axis)
        try:
            # the owner before may have removed the file after it was opened here and before it was locked
            while not self._lock():
                os.close(self._descriptor)
                self._descriptor = self._open(axis)
        except BlockingIOError:
            owner = os.read(self._descriptor, 32).decode(errors="replace").strip() or "unknown"
            os.close(self._descriptor)
            text = f"{axis}: node {node} on {bus_name(bus)} belongs to another daemon already (process {owner})"
            raise DriveError(text, "stop that one first", code=codes.NODE_LOCKED) from None
        os.ftruncate(self._descriptor, 0)
        os.pwrite(self._descriptor, f"{os.getpid()}\n".encode(), 0)

    def release(self) -> None:
        """Release the axis; safe to call twice."""
        if self._descriptor >= 0:
            self._path.unlink(missing_ok=True)
            os.close(self._descriptor)
            self._descriptor = -1

    def _open(self, axis: str) -> int:
        # for all users, as the bus is; never through a link that another user may have placed there
        flags = os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW
        try:
            return os.open(self._path, flags, 0o666)
        except OSError as error:
            text = f"{axis}: the lock file {self._path} cannot be opened: {error.strerror}"
            raise DriveError(text, code=codes.LOCK_FILE) from error

    def _lock(self) -> bool:
        """Lock the open file; return True if it is still the one under its name."""
        import fcntl  # imported here: Windows has none, and configurations are checked there too

        fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        try:
            return os.path.samestat(os.fstat(self._descriptor), os.stat(self._path))
        except FileNotFoundError:
            return False
