"""Client of the control socket: one request, one answer. Nothing heavy is imported."""

import contextlib
import json
import os
import socket
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from friction_hil.errors import FrictionHilError

_PATIENCE_S = 120.0  # a start takes as long as enable_timeout_s and a first motion allow
_PART_BYTES = 1 << 16
_MOST_DESCRIPTORS = 4


class DaemonGoneError(FrictionHilError):
    """Nobody listens at the socket, or who did has hung up."""


def ask(path: Path, request: dict[str, Any]) -> dict[str, Any]:
    """Return the answer of a daemon to a request.

    Raises `FrictionHilError`: the socket may not be used, the daemon has gone, or it refuses the request; the message
    says why.
    """
    with Question(path, request, _PATIENCE_S) as question:
        while (answer := question.answer()) is None:
            pass
        return answer


class Question:
    """A request that was sent to a daemon, and its answer when it comes.

    Raises `FrictionHilError`: the socket may not be used, or the daemon has gone (`DaemonGoneError`); the message says
    why. ``patience_s``: time for which connecting, sending and `answer` wait, s; 0: they never wait.
    """

    def __init__(self, path: Path, request: dict[str, Any], patience_s: float = 0.0) -> None:
        self._path, self._patience_s = path, patience_s
        self._line = b""
        # that came with the answer; `close` closes those that nobody has taken out of the list
        self.descriptors: list[int] = []
        self._connection = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            with self._explained():
                if patience_s:  # a time-out of Python's would not wait where many ask at the same time
                    wait = struct.pack("ll", *divmod(int(1e6 * patience_s), 1_000_000))
                    self._connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, wait)
                else:
                    self._connection.setblocking(False)
                self._connection.connect(os.fspath(path))
                self._connection.settimeout(patience_s)
                self._connection.sendall(json.dumps(request).encode() + b"\n")
        except BaseException:
            self.close()
            raise

    def answer(self) -> dict[str, Any] | None:
        """Return the answer; None if a part of it is still to come.

        Raises `FrictionHilError`: the daemon has gone (`DaemonGoneError`), or it refuses the request; the message says
        why.
        """
        with self._explained():
            try:
                part, received, _, _ = socket.recv_fds(self._connection, _PART_BYTES, _MOST_DESCRIPTORS)
            except BlockingIOError:
                return None
        for each in received:
            os.set_inheritable(each, False)
        self.descriptors += received
        self._line += part
        if not part:
            raise DaemonGoneError(
                f"{self._path}: the daemon has ended, or it restarts the process of its control socket"
            )
        line, end, _ = self._line.partition(b"\n")  # why the daemon hangs up may follow
        if not end:
            return None
        answer: dict[str, Any] = json.loads(line)
        if not answer["ok"]:
            raise FrictionHilError("\n".join(answer["problems"]))
        return answer

    def close(self) -> None:
        """Hang up; safe to call twice."""
        self._connection.close()
        while self.descriptors:
            os.close(self.descriptors.pop())

    def __enter__(self) -> "Question":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @contextlib.contextmanager
    def _explained(self) -> Iterator[None]:
        try:
            yield
        except PermissionError:
            raise FrictionHilError(
                f"{self._path}: this user may not use the control socket; who runs the daemon can admit a group with "
                "run --group GROUP"
            ) from None
        except OSError as error:
            if self._patience_s and isinstance(error, TimeoutError | BlockingIOError):
                raise FrictionHilError(f"{self._path}: no answer within {self._patience_s:g} s") from None
            raise DaemonGoneError(f"{self._path}: {error.strerror}") from None
