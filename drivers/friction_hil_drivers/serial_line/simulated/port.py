"""Drives' end of a simulated line: a pseudo-terminal or a TCP connection. No call blocks."""

import contextlib
import math
import os
import socket
import time
from pathlib import Path
from typing import Protocol

from friction_hil.errors import BusError
from friction_hil_drivers.serial_line.options import LineOptions, tcp_address
from friction_hil_drivers.simulated_name import claim

_MOST = 4096  # bytes at a time
_FORGOTTEN_S = 0.3
_PSEUDO_TERMINALS = "/dev/pts/"


class Port(Protocol):
    """Bytes to and from the master."""

    where: str  # path or address, for the user

    @property
    def descriptors(self) -> tuple[int, ...]:
        """File descriptors that become readable when bytes or a new master arrive."""
        ...

    def read(self) -> bytes | None:
        """Return the bytes that have arrived; None if the master has gone, and its incomplete request is void."""
        ...

    def write(self, data: bytes) -> None:
        """Send bytes to the master; without one they are lost, as on a real line."""
        ...

    def idle(self) -> None:
        """Drop replies that no master has read for some time."""
        ...

    def close(self) -> None:
        """Close the port and remove its link. Safe to call twice."""
        ...


def open_port(line: LineOptions) -> Port:
    """Open the port to which masters connect at ``line.port``.

    Raises `BusError`: the path or address is in use, or the system refuses it.
    """
    return TcpPort(line.port) if line.is_tcp else PtyPort(Path(line.port))


class PtyPort:
    """A pseudo-terminal, at a stable path by a symbolic link.

    Only a link that an earlier simulation left behind, or one without a target, is replaced. Raises `BusError`: the
    path is in use, or the link cannot be made.
    """

    def __init__(self, path: Path) -> None:
        import tty  # imported here: Windows has none, and configurations are checked there too

        self._path = path
        self._owner = _own(path)
        try:
            self._master, self._slave = os.openpty()
        except OSError as error:
            self._owner.close()
            raise BusError(f"no pseudo-terminal for {path}: {error.strerror}") from error
        # the other end stays open here, so that the settings remain while masters connect and disconnect
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self._heard_s = time.monotonic()
        self._target = os.ttyname(self._slave)
        self.where = f"{path} (pseudo-terminal {self._target})"
        try:
            if path.is_symlink():
                path.unlink()
            path.symlink_to(self._target)
        except OSError as error:
            self.close()
            raise BusError(f"{path} cannot be linked to the pseudo-terminal: {error.strerror}") from error

    @property
    def descriptors(self) -> tuple[int, ...]:
        """See `Port`."""
        return (self._master,)

    def read(self) -> bytes | None:
        """See `Port`."""
        try:
            data = os.read(self._master, _MOST)
        except BlockingIOError:
            return b""
        self._heard_s = time.monotonic()
        return data

    def idle(self) -> None:
        """See `Port`."""
        # a serial port would lose the replies that a killed master has not read
        if time.monotonic() - self._heard_s > _FORGOTTEN_S:
            import termios  # imported here, as in __init__

            self._heard_s = math.inf
            termios.tcflush(self._slave, termios.TCIFLUSH)

    def write(self, data: bytes) -> None:
        """See `Port`."""
        with contextlib.suppress(BlockingIOError):  # no master reads, and the buffer is full
            os.write(self._master, data)

    def close(self) -> None:
        """See `Port`."""
        if self._master < 0:
            return
        with contextlib.suppress(OSError):
            if os.readlink(self._path) == self._target:
                self._path.unlink()
        os.close(self._master)
        os.close(self._slave)
        self._master = self._slave = -1
        self._owner.close()


class TcpPort:
    """A listening socket that serves one master at a time; others are refused until it has gone.

    ``address``: ``tcp://HOST:PORT``. Raises `BusError`: it is in use, or does not belong to this machine.
    """

    def __init__(self, address: str) -> None:
        host, port = tcp_address(address)
        self.where = address
        self._client: socket.socket | None = None
        try:
            family, _, _, _, local = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
            self._listener = socket.create_server(local, family=family, backlog=1)
        except OSError as error:
            raise BusError(f"{address}: cannot listen there: {error.strerror}") from error
        self._listener.setblocking(False)

    @property
    def descriptors(self) -> tuple[int, ...]:
        """See `Port`."""
        listener = self._listener.fileno()
        return (listener,) if self._client is None else (listener, self._client.fileno())

    def read(self) -> bytes | None:
        """See `Port`."""
        received = bytearray()
        is_gone = self._client is not None and not self._drain(self._client, received)
        if is_gone:
            self._drop()
        self._accept()
        return None if is_gone else bytes(received)

    def write(self, data: bytes) -> None:
        """See `Port`."""
        if self._client is not None:
            with contextlib.suppress(OSError):  # the master has gone or does not read; the next `read` detects that
                self._client.send(data)

    def idle(self) -> None:
        """See `Port`; nothing to do, because a new master starts with empty buffers."""

    def close(self) -> None:
        """See `Port`."""
        self._drop()
        self._listener.close()

    def _drain(self, client: socket.socket, received: bytearray) -> bool:
        """Read everything that has come; return True if the master is still there."""
        while True:
            try:
                data = client.recv(_MOST)
            except BlockingIOError:
                return True
            except OSError:
                return False
            if not data:
                return False
            received += data

    def _accept(self) -> None:
        with contextlib.suppress(OSError):  # no master connects, or it has gone again
            while True:
                client, _ = self._listener.accept()
                if self._client is not None:
                    client.close()
                    continue
                client.setblocking(False)
                client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                self._client = client

    def _drop(self) -> None:
        if self._client is not None:
            self._client.close()
            self._client = None


def _own(path: Path) -> socket.socket:
    """Check that a link may be made at ``path``; return a socket that keeps other simulations from it while open.

    A link whose name can be claimed was left behind.
    """
    # the link itself, not its target
    link = os.path.join(os.path.realpath(path.parent), path.name)
    if os.path.lexists(link):
        # a killed simulation leaves a link to a pseudo-terminal, whose number may be in use again
        is_ours = os.path.islink(link) and (os.readlink(link).startswith(_PSEUDO_TERMINALS) or not os.path.exists(link))
        if not is_ours:
            raise BusError(
                f"{path} exists and is not replaced; set line.port to a path that does not exist, such as "
                "/tmp/friction-hil-line"
            )
    try:
        return claim(os.fsencode(link))
    except OSError as error:
        raise BusError(f"{path}: another process simulates drives there ({error.strerror})") from error
