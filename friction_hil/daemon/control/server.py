"""Server of the control socket: a thread for each connection, and the end of it all with the daemon."""

import json
import os
import select
import socket
import socketserver
import threading
from collections.abc import Callable
from typing import Any

from friction_hil.drive.socket_owner import peer

LONGEST_LINE = 1 << 20  # bytes of a request
_MOST_CLIENTS = 32


class ControlServer(socketserver.ThreadingMixIn, socketserver.UnixStreamServer):
    """Serves a socket that listens already.

    Parameters
    ----------
    descriptor : int
        Listening socket.
    answer : callable
        Called with a request (bytes) and the number of the user who sent it; returns the answer (dict).
    """

    daemon_threads = True

    def __init__(self, descriptor: int, answer: Callable[[bytes, int], dict[str, Any]]) -> None:
        super().__init__("", _Connection, bind_and_activate=False)
        self.socket.close()
        self.socket = socket.socket(fileno=os.dup(descriptor))
        self.answer = answer
        self.places = threading.BoundedSemaphore(_MOST_CLIENTS)


class _Connection(socketserver.StreamRequestHandler):
    """One client: a line with a request, a line with its answer, until it hangs up."""

    server: ControlServer

    def handle(self) -> None:
        if not self.server.places.acquire(blocking=False):
            self._say({"ok": False, "problems": [f"{_MOST_CLIENTS} clients are connected already"]})
            return
        try:
            self._serve()
        except OSError:
            pass  # the client is gone
        finally:
            self.server.places.release()

    def _serve(self) -> None:
        _, user, _ = peer(self.connection)
        while line := self.rfile.readline(LONGEST_LINE):
            if not line.endswith(b"\n"):
                self._say({"ok": False, "problems": [f"a request ends with a line feed, within {LONGEST_LINE} bytes"]})
                return
            self._say(self.server.answer(line, user))

    def _say(self, answer: dict[str, Any]) -> None:
        """Send an answer, and with its first byte the file descriptors that it has; their number stands for them."""
        descriptors = answer.get("descriptors", ())
        line = json.dumps({**answer, "descriptors": len(descriptors)} if descriptors else answer).encode() + b"\n"
        if descriptors:
            sent = socket.send_fds(self.connection, [line], descriptors)
            line = line[sent:]
        self.wfile.write(line)


def serve(descriptor: int, answer: Callable[[bytes, int], dict[str, Any]], control: int) -> None:
    """Serve until ``control`` is closed at its other end: then the daemon has ended."""
    with ControlServer(descriptor, answer) as server:
        threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 3600.0}, daemon=True).start()
        end = select.poll()
        end.register(control, 0)  # no event but the hang-up, which is always reported
        end.poll()
