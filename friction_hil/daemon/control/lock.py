"""The control socket of a daemon, and the lock of its name."""

import contextlib
import hashlib
import os
import socket
import time

from friction_hil.daemon.control.names import is_live, socket_path
from friction_hil.drive.socket_owner import owner
from friction_hil.errors import FrictionHilError, UsageError

_BACKLOG = 64
_MOST_NAMES = 100
_ORPHAN_S = 2.0
_LOOK_S = 0.02


class NameTakenError(UsageError):
    """Another daemon has this name."""


def control_socket(name: str, group: str | None, *, is_next_taken: bool) -> "ControlSocket":
    """Return the control socket of a daemon called ``name``, or with ``is_next_taken`` ``name-2`` if there is one.

    Raises `UsageError` as `ControlSocket` does.
    """
    for number in range(2, _MOST_NAMES):
        try:
            return ControlSocket(name if number == 2 else f"{name}-{number - 1}", group)
        except NameTakenError:
            if not is_next_taken:
                raise
    return ControlSocket(name, group)


class ControlSocket:
    """Socket of a daemon, and the lock of its name: both end with this process.

    ``group``: its members may use the socket too. Raises `UsageError`: the name or the group is wrong, or another
    daemon has this name (`NameTakenError`); `FrictionHilError`: the socket cannot be made.
    """

    def __init__(self, name: str, group: str | None = None) -> None:
        self.path = socket_path(name)
        group_id = -1 if group is None else _group_id(group)
        self._lock = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            self._take_name(name)
            self._open(group_id)
        except OSError as error:
            self.close()
            reason = error.strerror or str(error)
            text = f"the control socket {self.path} cannot be made: {reason}"
            raise FrictionHilError(text, "set XDG_RUNTIME_DIR to a folder of your own") from error
        except BaseException:
            self.close()
            raise
        self.descriptor = self._socket.fileno()  # listening socket

    def _take_name(self, name: str) -> None:
        digest = hashlib.sha256(os.fsencode(self.path.absolute())).hexdigest()
        lock = b"\0friction_hil daemon, " + digest[:40].encode()
        try:
            self._lock.bind(lock)
        except OSError:
            raise NameTakenError(_taken(name, owner(lock))) from None
        self._lock.listen(_BACKLOG)  # nothing is accepted: whoever connects sees who listens

    def _open(self, group_id: int) -> None:
        folder = self.path.parent
        folder.mkdir(mode=0o700 if group_id < 0 else 0o755, parents=True, exist_ok=True)
        if folder.stat().st_uid not in (os.geteuid(), 0):
            raise FrictionHilError(f"{folder} belongs to another user: set XDG_RUNTIME_DIR to a folder of your own")
        end_s = time.monotonic() + _ORPHAN_S
        while is_live(self.path) and time.monotonic() < end_s:
            time.sleep(_LOOK_S)  # the server of a daemon that was killed ends by itself
        if is_live(self.path):  # of a daemon in a container that shares this folder, but not the lock
            raise NameTakenError(_taken(self.path.stem, owner(os.fspath(self.path))))
        with contextlib.suppress(FileNotFoundError):
            self.path.unlink()  # left by a daemon that was killed
        before = os.umask(0o177)
        try:
            self._socket.bind(os.fspath(self.path))
        finally:
            os.umask(before)
        if group_id >= 0:
            os.chown(self.path, -1, group_id)
            os.chmod(self.path, 0o660)
        self._socket.listen(_BACKLOG)
        self._inode = self.path.stat().st_ino

    def close(self) -> None:
        """Remove the socket and release the name; safe to call twice."""
        with contextlib.suppress(OSError, AttributeError):
            if self.path.stat().st_ino == self._inode:
                self.path.unlink()
        self._socket.close()
        self._lock.close()


def _taken(name: str, who: str) -> str:
    return (
        f"a daemon called {name!r} runs already ({who}); --name gives this one another name, 'friction-hil status' "
        "lists those that run"
    )


def _group_id(group: str) -> int:
    import grp  # imported here: Windows has none, and some commands import this module there

    try:
        return grp.getgrnam(group).gr_gid
    except KeyError:
        raise UsageError(f"--group {group}: there is no such group on this machine") from None
