"""Messages to the service manager that started the daemon: the protocol of sd_notify(3)."""

import contextlib
import os
import socket
from collections.abc import Mapping

from friction_hil.daemon.log import Sink
from friction_hil.numerics.jit import Array

_PARTS_OF_WATCHDOG = 4  # messages in each watchdog interval: three of them may be lost


class ServiceManager:
    """Service manager that waits for messages of this process.

    A message that its full queue does not take is left out: the loop must not wait, and the next one follows.

    ``address``: path of a Unix datagram socket; abstract if it begins with ``@``.
    """

    def __init__(self, address: str, watchdog_s: float | None) -> None:
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC)
        self._socket.setblocking(False)
        self._address = "\0" + address[1:] if address.startswith("@") else address
        self.watchdog_s = watchdog_s  # interval within which it expects a sign of life, s; None: none is expected

    @classmethod
    def from_environment(cls, environment: Mapping[str, str]) -> "ServiceManager | None":
        """Return the service manager that the environment names; None if none started this process."""
        address = environment.get("NOTIFY_SOCKET")
        if not address:
            return None
        wait_us = environment.get("WATCHDOG_USEC", "")
        is_ours = environment.get("WATCHDOG_PID", str(os.getpid())) == str(os.getpid())
        return cls(address, int(wait_us) * 1e-6 if wait_us.isdecimal() and is_ours else None)

    @property
    def alive_every_s(self) -> float | None:
        """Interval at which `alive` is to be called, s."""
        return None if self.watchdog_s is None else self.watchdog_s / _PARTS_OF_WATCHDOG

    def ready(self) -> None:
        """Report that the daemon has started."""
        self._send("READY=1")

    def alive(self) -> None:
        """Feed the watchdog."""
        self._send("WATCHDOG=1")

    def stopping(self) -> None:
        """Report that the daemon is ending."""
        self._send("STOPPING=1")

    def status(self, text: str) -> None:
        """Report a line of text, which ``systemctl status`` shows."""
        self._send("STATUS=" + " ".join(text.split()))

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()

    def _send(self, message: str) -> None:
        # It may be busy, gone, or closed to this user: a daemon that moves axes goes on without it.
        with contextlib.suppress(OSError):
            self._socket.sendto(message.encode(), self._address)


class NotifyingSink:
    """Sink that reports to the service manager what passes through it.

    The rows of the loop, and nothing else, feed the watchdog: they come once per cycle, with feedback of the drives.
    """

    def __init__(self, sink: Sink, manager: ServiceManager, period_s: float) -> None:
        self._sink = sink  # receiver of all rows and events
        self._manager = manager
        every_s = manager.alive_every_s
        self._rows_between = 0 if every_s is None else max(1, int(every_s / period_s))
        self._left = self._rows_between
        self._is_ready = False

    def push(self, row: Array) -> None:
        """Take the rows of a cycle."""
        self._sink.push(row)
        if not self._is_ready:
            self._is_ready = True
            self._manager.ready()
        self._left -= 1
        if not self._left:
            self._left = self._rows_between
            self._manager.alive()

    def event(self, cycle: int, name: str, text: str) -> None:
        """Take an event; states and faults become the status of the service."""
        self._sink.event(cycle, name, text)
        if name in ("state", "fault"):
            self._manager.status(text if name == "state" else f"fault: {text}")
