"""Names of which only one process of this machine may simulate the drives."""

import hashlib
import socket


def claim(name: bytes) -> socket.socket:
    """Return a socket that keeps other simulations from a name while it is open.

    The kernel frees the name when its process ends in any way. Raises `OSError`: another process has it.
    """
    owner = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    try:
        owner.bind(b"\0friction_hil-" + hashlib.sha256(name).hexdigest().encode())
    except OSError:
        owner.close()
        raise
    return owner
