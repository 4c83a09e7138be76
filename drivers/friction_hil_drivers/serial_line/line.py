"""Serial port or TCP connection: bytes in and out. Nothing here blocks once the line is open."""

import contextlib
import errno
import os
import select
import socket
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import serial
from serial.rs485 import RS485Settings

from friction_hil.errors import BusError
from friction_hil_drivers.serial_line import codes, ports
from friction_hil_drivers.serial_line.options import LineOptions, tcp_address

_CONNECT_S = 2.0
_PSEUDO_TERMINALS = Path("/dev/pts")
_READ_SIZE = 448  # bytes; more than the replies of a cycle, and within Python's pool of small objects
_PARITY = {"none": serial.PARITY_NONE, "even": serial.PARITY_EVEN, "odd": serial.PARITY_ODD}


class _Link(NamedTuple):
    """Identity of a link to a pseudo-terminal and of the terminal; a later link of the same name has another one."""

    made: tuple[int, int]
    terminal: tuple[int, int]


class LineGoneError(Exception):
    """The adapter was unplugged, or the peer closed the connection."""


class Line:
    """Serial port or TCP connection."""

    def __init__(self, options: LineOptions) -> None:
        self.options = options
        self._port: Any = None  # serial.Serial
        self._link: _Link | None = None  # to the pseudo-terminal that was opened
        self._socket: socket.socket | None = None
        self._connecting: socket.socket | None = None
        # resolved when the line is opened, because resolving takes time
        self._peer: tuple[socket.AddressFamily, Any] | None = None
        self._hang_up = select.poll()  # reports that the adapter of a serial port is gone
        self.descriptor = -1  # file descriptor of the open line, for select; -1 if the line is gone

    @property
    def is_open(self) -> bool:
        """True if the line is open."""
        return self.descriptor >= 0

    def open(self) -> None:
        """Open the line; a TCP connection may take two seconds.

        Raises `BusError`: the port does not exist or is in use, or no server accepts the connection.
        """
        if self.options.is_tcp:
            address = tcp_address(self.options.port)
            try:
                connection = socket.create_connection(address, _CONNECT_S)
                self._peer = connection.family, connection.getpeername()
                self._take_socket(connection)
            except OSError as error:
                raise BusError(
                    f"{self.options.port}: no connection: {_reason(error)}",
                    "check that the drive is on and accepts connections at this address",
                    code=codes.LINE_NOT_OPENED,
                ) from error
        else:
            self._open_port()

    def _open_port(self) -> None:
        import termios  # imported here: Windows has none, and configurations are checked there too

        options, link = self.options, _link(self.options.port)
        # a pseudo-terminal has no parity, and setting one for the second time fails
        has_parity = not _is_pseudo(options.port)
        try:
            port = serial.Serial(
                options.port,
                options.baud,
                parity=_PARITY[options.parity] if has_parity else serial.PARITY_NONE,
                stopbits=options.stop_bits,
                timeout=0,
                exclusive=True,
            )
        except (OSError, ValueError, termios.error) as error:  # serial.SerialException is an OSError
            raise _refusal(options.port, error) from error
        if options.is_rs485:
            try:
                port.rs485_mode = RS485Settings()
            except (OSError, ValueError, termios.error) as error:
                port.close()
                raise BusError(
                    f"{options.port} cannot switch the direction of an RS-485 line ({error})",
                    "set is_rs485: false if the adapter switches the direction by itself",
                    code=codes.RS485_NOT_SUPPORTED,
                ) from error
        self._port, self.descriptor, self._link = port, port.fileno(), link
        self._hang_up.register(self.descriptor, 0)

    def _take_socket(self, connection: socket.socket) -> None:
        connection.setblocking(False)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._socket, self.descriptor = connection, connection.fileno()

    @property
    def latency_s(self) -> float:
        """Latency timer of the USB adapter, which delays short replies, s; 0 if it has none."""
        return ports.latency_s(ports.name_of(self.options.port)) or 0.0

    def notes(self) -> list[str]:
        """Return notes for the user on settings that slow the line down."""
        found = ports.latency(ports.name_of(self.options.port))
        return [] if found is None or found.result == "pass" else [str(found)]

    def read(self, *, is_ready: bool = True) -> bytes:
        """Return the bytes that have arrived; empty if none have.

        ``is_ready``: the system reports bytes; if there are none then, the adapter is gone. Raises `LineGoneError`: the
        line is gone.
        """
        try:
            data = os.read(self.descriptor, _READ_SIZE)
        except BlockingIOError:
            return b""
        except OSError as error:
            raise self._lose(_reason(error)) from error
        if not data and self._socket is not None:
            raise self._lose("the peer closed the connection")
        # reading a port whose adapter is gone returns no bytes, without an error
        if is_ready and not data and self._hang_up.poll(0):
            raise self._lose("the adapter was unplugged")
        return data

    def write(self, data: bytes) -> None:
        """Send ``data``.

        Raises `LineGoneError`: the line is gone, or accepts no more bytes because the peer does not read them.
        """
        try:
            if os.write(self.descriptor, data) == len(data):
                return
            reason = "it accepts no more bytes"
        except OSError as error:
            reason = _reason(error)
        raise self._lose(reason)

    def acknowledge(self) -> None:
        """Make the kernel acknowledge immediately what a TCP peer has sent.

        Many peers send no reply while the previous one is not acknowledged (Nagle's algorithm), and the kernel
        acknowledges it with the next request. After one late reply, such a peer would send every reply only after the
        following request.
        """
        if self._socket is not None:
            with contextlib.suppress(OSError):
                self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_QUICKACK, 1)

    def _lose(self, reason: str) -> LineGoneError:
        self.close()
        return LineGoneError(f"{self.options.port} is gone: {reason}")

    def reopen(self) -> bool:
        """Try, without waiting, to reopen a line that is gone; return True if it is open."""
        if self.is_open:
            return True
        if not self.options.is_tcp:
            if os.path.exists(self.options.port) and not self._is_left_behind():
                with contextlib.suppress(BusError):
                    self._open_port()
            return self.is_open
        if self._connecting is None:
            if self._peer is None:
                return False
            family, address = self._peer
            self._connecting = socket.socket(family)
            self._connecting.setblocking(False)
            if self._connecting.connect_ex(address) not in (0, errno.EINPROGRESS):
                self._connecting.close()
                self._connecting = None
        elif select.select([], [self._connecting], [], 0.0)[1]:
            connection, self._connecting = self._connecting, None
            if connection.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR) == 0:
                self._take_socket(connection)
            else:
                connection.close()
        return self.is_open

    def _is_left_behind(self) -> bool:
        """Return True if the process that made the link has ended: its pseudo-terminal may be another one's now."""
        before, now = self._link, _link(self.options.port)
        return before is not None and now is not None and now.made == before.made and now.terminal != before.terminal

    def close(self) -> None:
        """Close the line. Safe to call twice."""
        self._hang_up = select.poll()
        self.descriptor = -1
        for part in (self._port, self._socket, self._connecting):
            if part is not None:
                with contextlib.suppress(OSError):
                    part.close()
        self._port = self._socket = self._connecting = None


def _is_pseudo(port: str) -> bool:
    return _PSEUDO_TERMINALS in Path(port).resolve().parents


def _link(port: str) -> _Link | None:
    with contextlib.suppress(OSError):
        if os.path.islink(port) and _is_pseudo(port):
            link, terminal = os.lstat(port), os.stat(port)
            return _Link((link.st_ino, link.st_ctime_ns), (terminal.st_rdev, terminal.st_ctime_ns))
    return None


def _reason(error: OSError) -> str:
    return error.strerror or str(error) or type(error).__name__


def _refusal(port: str, error: Exception) -> BusError:
    """Return the error for a serial port that does not open."""
    number = getattr(error, "errno", None)
    if "exclusively lock" in str(error):
        return taken(port, ports.holders(port))
    if number == errno.EACCES:
        reason, remedy = "permission denied", ports.permission_remedy(Path(port))
    elif number == errno.ENOENT:
        present = ", ".join(ports.serial_ports()) or "none"
        reason = f"there is no such port; serial ports of this machine: {present}"
        remedy = "plug the adapter in, or correct line.port"
    else:
        reason, remedy = str(error), "check that it is a serial port; dmesg shows messages about its adapter"
    return BusError(f"{port} cannot be opened: {reason}", remedy, code=codes.LINE_NOT_OPENED)


def taken(port: str, holders: Sequence[str]) -> BusError:
    """Return the error for a port that other processes use; ``holders`` names the known ones."""
    who = f" ({', '.join(holders)})" if holders else ""
    detail = f"{port} cannot be opened: another process has it{who}: a line must have only one master"
    return BusError(detail, "end that process first", code=codes.LINE_NOT_OPENED)
