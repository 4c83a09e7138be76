"""Control process's side of the spawner."""

import contextlib
import json
import os
import select
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Sequence
from typing import IO, Protocol

from friction_hil.daemon.spawner import ENVIRONMENT

_ANSWER_BYTES = 4096
_END_S, _SLICE_S = 2.0, 0.05
_UNKNOWN = -9  # as after SIGKILL, which Windows lacks: a process whose end nobody has seen, as the spawner is gone


class Process(Protocol):
    """A process, as `subprocess.Popen` is one."""

    stdin: IO[bytes] | None
    stdout: IO[bytes] | None

    @property
    def pid(self) -> int:
        """Its number; 0 until it is known."""
        ...

    def poll(self) -> int | None:
        """Return its exit status, None while it runs; never wait."""
        ...

    def wait(self, timeout: float | None = None) -> int:
        """Wait for its end and return its exit status."""
        ...

    def send_signal(self, number: int, /) -> None:
        """Send it a signal, if it runs."""
        ...

    def kill(self) -> None:
        """Kill it, if it runs."""
        ...


class Spawn(Protocol):
    """Starts a process, whose standard input is a pipe, and its output one too if ``stdout`` is None."""

    def __call__(self, words: Sequence[str], descriptors: Sequence[int], stdout: int | None) -> Process:
        """Start the Python interpreter with ``words`` as its arguments; it inherits the descriptors.

        ``stdout``: descriptor of its output; None for a pipe. Raises `OSError`: it cannot be started.
        """
        ...


def spawn_directly(words: Sequence[str], descriptors: Sequence[int], stdout: int | None) -> subprocess.Popen[bytes]:
    """Start a process from this one; see `Spawn`."""
    return subprocess.Popen(
        # -P: do not import modules from the current directory, which may be the user's
        [sys.executable, "-P", *words],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE if stdout is None else stdout,
        pass_fds=descriptors,
        env=os.environ | ENVIRONMENT,
        process_group=0,  # Ctrl-C is not meant for it, not even before it can ignore it
    )


class SpawnedProcess:
    """A process that a spawner has started; see `Process`."""

    def __init__(self, spawner: "Spawner", stdin: IO[bytes]) -> None:
        self._spawner = spawner
        self._pid = 0
        self.returncode: int | None = None  # exit status, once that is known
        self.stdin: IO[bytes] | None = stdin
        self.stdout: IO[bytes] | None = None

    @property
    def pid(self) -> int:
        """Its number; 0 until the spawner has answered."""
        self._spawner.take_answers()
        return self._pid

    def take(self, answer: dict[str, int]) -> None:
        """Take what the spawner answered about it."""
        self._pid = answer.get("pid", self._pid)
        self.returncode = answer.get("status")

    def poll(self) -> int | None:
        """Return its exit status, None while it runs; never wait."""
        self._spawner.take_answers()
        if self.returncode is None and self._spawner.is_gone and not self._is_there():
            self.returncode = _UNKNOWN
        return self.returncode

    def _is_there(self) -> bool:
        try:
            descriptor = os.pidfd_open(self._pid)
        except OSError:
            return False
        try:
            return not select.select([descriptor], (), (), 0.0)[0]
        finally:
            os.close(descriptor)

    def wait(self, timeout: float | None = None) -> int:
        """Wait for its end and return its exit status; a `subprocess.TimeoutExpired`: it has not come in time."""
        end_s = None if timeout is None else time.monotonic() + timeout
        while (status := self.poll()) is None:
            if end_s is not None and time.monotonic() > end_s:
                raise subprocess.TimeoutExpired("", timeout or 0.0)
            self._spawner.await_answer(_SLICE_S)
        return status

    def send_signal(self, number: int) -> None:
        """Send it a signal, if it runs."""
        if self.poll() is None and self._pid:
            with contextlib.suppress(ProcessLookupError):
                os.kill(self._pid, number)

    def kill(self) -> None:
        """Kill it, if it runs; wait until the spawner has started it."""
        while self.poll() is None and not self._pid:
            self._spawner.await_answer(_SLICE_S)
        self.send_signal(signal.SIGKILL)

    def close(self) -> None:
        """Close its pipes."""
        for pipe in (self.stdin, self.stdout):
            if pipe is not None:
                pipe.close()


class Spawner:
    """A running spawner; `spawn` never waits. To be started before the loop, and closed after all its processes."""

    def __init__(self) -> None:
        self._connection, other = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with other:
            self.process = subprocess.Popen(  # that starts the others
                # -P: do not import modules from the current directory, which may be the user's
                [sys.executable, "-P", "-m", "friction_hil.daemon.spawner", str(other.fileno())],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                pass_fds=(other.fileno(),),
                process_group=0,  # Ctrl-C is not meant for it
            )
        self._connection.setblocking(False)
        self._processes: dict[int, SpawnedProcess] = {}
        self._requests = 0
        self.is_gone = False

    def spawn(self, words: Sequence[str], descriptors: Sequence[int], stdout: int | None) -> "SpawnedProcess":
        """Ask for a process; see `Spawn`. One that the system refuses ends with exit status 127."""
        with contextlib.ExitStack() as stack:
            inputs = os.pipe()
            stack.callback(os.close, inputs[0])
            process = SpawnedProcess(self, os.fdopen(inputs[1], "wb", 0))
            if stdout == subprocess.DEVNULL:
                stdout = os.open(os.devnull, os.O_WRONLY)
                stack.callback(os.close, stdout)
            elif stdout is None:
                outputs = os.pipe()
                stack.callback(os.close, outputs[1])
                process.stdout, stdout = os.fdopen(outputs[0], "rb", 0), outputs[1]
            self._requests += 1
            request = {
                "number": self._requests,
                "words": [sys.executable, "-P", *words],
                "descriptors": list(descriptors),
            }
            self._processes[self._requests] = process
            try:
                socket.send_fds(self._connection, [json.dumps(request).encode()], [inputs[0], stdout, *descriptors])
            except OSError as error:
                del self._processes[self._requests]
                process.close()
                if isinstance(error, BrokenPipeError):
                    raise BrokenPipeError(error.errno, "the process that starts others has died") from error
                raise
        return process

    def await_answer(self, timeout_s: float) -> None:
        """Wait for an answer of the spawner, or until its end is known."""
        if self.is_gone:  # nothing comes any more
            time.sleep(timeout_s)
        else:
            select.select([self._connection], (), (), timeout_s)

    def take_answers(self) -> None:
        """Take what the spawner has answered; never wait."""
        while not self.is_gone:
            try:
                answer = self._connection.recv(_ANSWER_BYTES)
            except BlockingIOError:
                return
            except OSError:
                answer = b""
            if not answer:
                self.is_gone = True
                return
            told: dict[str, int] = json.loads(answer)
            self._processes[told["number"]].take(told)
            if "status" in told:
                del self._processes[told["number"]]

    def close(self) -> None:
        """End the spawner; processes that it has started and that still run go on."""
        self._connection.close()
        try:
            self.process.wait(_END_S)
        except subprocess.TimeoutExpired:  # stopped
            self.process.kill()
            self.process.wait()
