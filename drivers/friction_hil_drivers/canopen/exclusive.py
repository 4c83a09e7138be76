"""One daemon an axis: a lock that the kernel releases when its owner ends, however it ends."""

import fcntl
import os
import re
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from friction_hil.errors import DriveError
from friction_hil_drivers.canopen.bus import bus_name

if TYPE_CHECKING:
    from friction_hil.config import BusConfig


class AxisLock:
    """Held by the daemon that owns a node of a bus, on this machine.

    Raises
    ------
    DriveError
        Another process holds it; the message names its process number.
    """

    def __init__(self, bus: "BusConfig", node: int, axis: str) -> None:
        name = re.sub(r"\W+", "-", f"friction_hil-{bus_name(bus)}-{node}") + ".lock"
        self._path = Path(tempfile.gettempdir()) / name
        self._descriptor = self._open(axis)
        try:
            # the owner before may have removed the file between our opening and locking it
            while not self._lock():
                os.close(self._descriptor)
                self._descriptor = self._open(axis)
        except BlockingIOError:
            owner = os.read(self._descriptor, 32).decode(errors="replace").strip() or "unknown"
            os.close(self._descriptor)
            raise DriveError(
                f"{axis}: node {node} on {bus_name(bus)} belongs to another daemon already (process {owner})",
                "stop that one first",
            ) from None
        os.ftruncate(self._descriptor, 0)
        os.pwrite(self._descriptor, f"{os.getpid()}\n".encode(), 0)

    def release(self) -> None:
        """Give the axis free; safe to call twice."""
        if self._descriptor >= 0:
            self._path.unlink(missing_ok=True)
            os.close(self._descriptor)
            self._descriptor = -1

    def _open(self, axis: str) -> int:
        # for all users, as the bus is; never through a link that somebody else may have laid
        flags = os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW
        try:
            return os.open(self._path, flags, 0o666)
        except OSError as error:
            raise DriveError(f"{axis}: the lock file {self._path} cannot be opened: {error.strerror}") from error

    def _lock(self) -> bool:
        """Lock the open file; whether it is still the one that others will find."""
        fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        try:
            return os.path.samestat(os.fstat(self._descriptor), os.stat(self._path))
        except FileNotFoundError:
            return False
