"""Who holds the name of a Unix-domain socket: the locks of daemons and axes are such names."""

import os
import socket
import struct

_CREDENTIALS = struct.Struct("3i")  # process, user, group


def peer(connection: socket.socket) -> tuple[int, int, int]:
    """Return process, user and group at the other end of a connected Unix-domain socket; the kernel vouches for them.

    Raises `OSError`: the connection is gone.
    """
    process, user, group = _CREDENTIALS.unpack(
        connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size)
    )
    return process, user, group


def owner(name: bytes | str) -> str:
    """Return the process that listens on a Unix-domain socket, in words."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as asking:
        asking.setblocking(False)
        try:
            asking.connect(name)
            process, user, _ = peer(asking)
        except OSError:  # it has just ended, or has been asked thousands of times
            return "process unknown"
    if not process:  # it is in another container
        return "process unknown"
    return f"process {process}" + (f" of user {user}" if user != os.geteuid() else "")
