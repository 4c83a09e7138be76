"""The drives' end of a simulated line: a pseudo-terminal or a TCP connection. Nothing here blocks."""

import contextlib
import hashlib
import math
import os
import socket
import termios
import time
import tty
from pathlib import Path
from typing import Protocol

from friction_hil.errors import BusError
from friction_hil_drivers.serial_line.options import LineOptions, tcp_address

_MOST = 4096  # bytes at a time
_FORGOTTEN_S = 0.3
_PSEUDO_TERMINALS = "/dev/pts/"


class Port(Protocol):
    """Bytes to and from the master."""

    where: str  # for people

    @property
    def descriptors(self) -> tuple[int, ...]:
        """File descriptors that become readable when there is something to do."""
        ...

    def read(self) -> bytes | None:
        """Return what came; None if the master has gone, and its unfinished request with it."""
        ...

    def write(self, data: bytes) -> None:
        """Send; bytes are lost if nobody listens, as on a real line."""
        ...

    def idle(self) -> None:
        """Drop replies that nobody has read for long."""
        ...

    def close(self) -> None:
        """Close the port and remove its link. Safe to call twice."""
        ...


def open_port(line: LineOptions) -> Port:
    """Open the port that masters will find at ``line.port``.

    Raises
    ------
    BusError
        Something else is there, or the system refuses.
    """
    return TcpPort(line.port) if line.is_tcp else PtyPort(Path(line.port))


class PtyPort:
    """A pseudo-terminal, at a stable path by a symbolic link.

    Parameters
    ----------
    path : Path
        Where the link shall be. Something there that is neither a link left behind by an earlier simulation nor
        one that leads nowhere is never replaced.

    Raises
    ------
    BusError
        Something else is there, or the link cannot be made.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._owner = _own(path)
        try:
            self._master, self._slave = os.openpty()
        except OSError as error:
            self._owner.close()
            raise BusError(f"no pseudo-terminal for {path}: {error.strerror}") from error
        # the other end stays open here, too: so the settings last, and masters may come and go
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
        # what a killed master left unread, a serial port would have lost when it was closed
        if time.monotonic() - self._heard_s > _FORGOTTEN_S:
            self._heard_s = math.inf
            termios.tcflush(self._slave, termios.TCIFLUSH)

    def write(self, data: bytes) -> None:
        """See `Port`."""
        with contextlib.suppress(BlockingIOError):  # nobody reads, and the buffer is full
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
    """A listening socket that serves one master at a time; the next may come when it has gone.

    Parameters
    ----------
    address : str
        ``tcp://HOST:PORT``.

    Raises
    ------
    BusError
        The address is in use or not one of this machine.
    """

    def __init__(self, address: str) -> None:
        host, port = tcp_address(address)
        self.where = address
        self._client: socket.socket | None = None
        try:
            family, _, _, _, place = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
            self._listener = socket.create_server(place, family=family, backlog=1)
        except OSError as error:
            raise BusError(f"{address}: nobody can be served there: {error.strerror}") from error
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
            with contextlib.suppress(OSError):  # it has gone, or does not read: the next read shows it
                self._client.send(data)

    def idle(self) -> None:
        """See `Port`: a new master starts with empty buffers."""

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
        with contextlib.suppress(OSError):  # nobody is there, or has gone again
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
    """Make sure that a link may be laid at ``path``, and that no other simulation does so before this socket closes.

    The kernel frees the name of the socket when its owner ends, however it ends: what it then left behind is stale.
    """
    # without the link at its end being followed: that is what it is about
    place = os.path.join(os.path.realpath(path.parent), path.name)
    if os.path.lexists(place):
        # a link to a pseudo-terminal is what a killed simulation leaves; its number may be another's by now
        is_ours = os.path.islink(place) and (
            os.readlink(place).startswith(_PSEUDO_TERMINALS) or not os.path.exists(place)
        )
        if not is_ours:
            raise BusError(
                f"{path} exists and is not replaced; let line.port be a path where nothing is, such as "
                "/tmp/friction-hil-line"
            )
    owner = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    try:
        owner.bind(b"\0friction_hil-" + hashlib.sha256(os.fsencode(place)).hexdigest().encode())
    except OSError as error:
        owner.close()
        raise BusError(f"{path}: another process simulates drives there ({error.strerror})") from error
    return owner
