"""Server of the control socket: a thread for each connection, and the end of it all with the daemon.

Who only keeps a connection keeps nobody out: where all places are taken, the client for whom the server has waited
longest is hung up, whether it sends nothing, half a request, or does not read its answers.
"""

import contextlib
import json
import os
import select
import socket
import socketserver
import threading
import time
from array import array
from collections.abc import Callable
from typing import Any

from friction_hil.drive.socket_owner import peer

LONGEST_LINE = 1 << 20  # bytes of a request
MOST_CLIENTS = 32
_LOOK_MS = 500
_MOMENT_S = 0.05  # within which a request that has come is read
_NOT_WHOLE = f"a request ends with a line feed, within {LONGEST_LINE} bytes"
_HUNG_UP = f"hung up: {MOST_CLIENTS} clients are connected, and this one was silent for the longest time"


class ControlServer(socketserver.ThreadingMixIn, socketserver.UnixStreamServer):
    """Serves a socket that listens already."""

    daemon_threads = True

    def __init__(self, descriptor: int, desk: Callable[[], Callable[[bytes, int], dict[str, Any]]]) -> None:
        super().__init__("", _Connection, bind_and_activate=False)
        self.socket.close()
        self.socket = socket.socket(fileno=os.dup(descriptor))
        self.desk = desk  # returns the function that answers a request (bytes) of a user (number)
        self.places = Places()

    def process_request(self, request: Any, client_address: Any) -> None:
        """Serve a connection in a thread; while all others are being answered, it waits as those behind it do."""
        self.places.take(request)
        super().process_request(request, client_address)

    def shutdown_request(self, request: Any) -> None:
        """Close a connection, and give its place away."""
        self.places.leave(request)
        super().shutdown_request(request)


class Places:
    """The connections, each with what the server does for it: it waits for the client, or answers."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._waiting: dict[socket.socket, float] = {}  # for the client, and since when, s; the longest is first
        self._answered: set[socket.socket] = set()

    def take(self, connection: socket.socket) -> None:
        """Give a connection a place, if need be that of another one for whose client the server waits."""
        with self._changed:
            while len(self._waiting) + len(self._answered) >= MOST_CLIENTS:
                if (silent := self._longest_silent()) is not None:
                    self._hang_up(silent)
                else:
                    self._changed.wait(_MOMENT_S if self._waiting else None)
            self._waiting[connection] = time.monotonic()

    def begin_answer(self, connection: socket.socket) -> bool:
        """Note that a request has come whole; return False if the connection has lost its place."""
        with self._changed:
            if connection not in self._waiting:
                return False
            del self._waiting[connection]
            self._answered.add(connection)
            return True

    def end_answer(self, connection: socket.socket) -> None:
        """Note that the answer is known: it remains that the client reads it, and asks again."""
        with self._changed:
            self._answered.discard(connection)
            self._waiting[connection] = time.monotonic()
            self._changed.notify()

    def leave(self, connection: socket.socket) -> None:
        """Give the place of a connection away."""
        with self._changed:
            self._waiting.pop(connection, None)
            self._answered.discard(connection)
            self._changed.notify()

    def _longest_silent(self) -> socket.socket | None:
        """Return the first from whom nothing is there to be read, else the first; none of the last moment.

        A request that has just come is not thrown away. Who has asked again but does not read the answers is silent.
        """
        before = time.monotonic() - _MOMENT_S
        waiting = [each for each, since in self._waiting.items() if since < before]
        readable, _, _ = select.select(waiting, [], [], 0.0)
        return next((each for each in waiting if each not in readable), next(iter(waiting), None))

    def _hang_up(self, connection: socket.socket) -> None:
        del self._waiting[connection]
        with contextlib.suppress(OSError):  # it is gone, or reads nothing
            connection.send(_line({"ok": False, "problems": [_HUNG_UP]}), socket.MSG_DONTWAIT)
        with contextlib.suppress(OSError):
            connection.shutdown(socket.SHUT_RDWR)  # the thread that waits for it wakes, and closes it


class _Connection(socketserver.StreamRequestHandler):
    """One client: a line with a request, a line with its answer, until it hangs up."""

    server: ControlServer

    def handle(self) -> None:
        places, is_whole = self.server.places, True
        with contextlib.suppress(OSError):  # the client is gone
            _, user, _ = peer(self.connection)
            while is_whole and (line := self.rfile.readline(LONGEST_LINE)) and places.begin_answer(self.connection):
                is_whole = line.endswith(b"\n")
                answer: dict[str, Any] = {"ok": False, "problems": [_NOT_WHOLE]}
                if is_whole:
                    try:
                        answer = self.server.desk()(line, user)
                    except Exception as error:  # noqa: BLE001 - it must not keep others from stopping axes
                        answer["problems"] = [f"an error in friction-hil: {type(error).__name__}: {error}"]
                rest = self._say_at_once(answer)
                places.end_answer(self.connection)
                self.wfile.write(rest)

    def _say_at_once(self, answer: dict[str, Any]) -> bytes:
        """Send what the connection takes of an answer, and return the rest, for which the client has to read.

        Until then the connection keeps its place, so that whoever asked for a stop gets its answer. File descriptors
        come with its first byte; their number stands for them.
        """
        descriptors = answer.get("descriptors", ())
        line = _line({**answer, "descriptors": len(descriptors)} if descriptors else answer)
        rights = [(socket.SOL_SOCKET, socket.SCM_RIGHTS, array("i", descriptors))] if descriptors else []
        try:
            sent = self.connection.sendmsg([line], rights, socket.MSG_DONTWAIT)  # `send_fds` ignores its flags
        except BlockingIOError:  # it has not read its earlier answers
            if descriptors:
                raise
            sent = 0
        return line[sent:]


def _line(answer: dict[str, Any]) -> bytes:
    return json.dumps(answer).encode() + b"\n"


def serve(
    descriptor: int,
    desk: Callable[[], Callable[[bytes, int], dict[str, Any]]],
    control: int,
    look: Callable[[], None],
) -> None:
    """Serve until ``control`` is closed at its other end: then the daemon has ended. Call ``look`` now and then."""
    with ControlServer(descriptor, desk) as server:
        threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 3600.0}, daemon=True).start()
        end = select.poll()
        end.register(control, 0)  # no event but the hang-up, which is always reported
        while not end.poll(_LOOK_MS):
            look()
