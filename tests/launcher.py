"""Start commands of friction-hil without the cost of their imports.

Importing takes a second of processor time, and the tests start hundreds of commands. One server process imports
everything once and forks for each command. What it forks is what a shell would start: a process of its own, with its
own streams, signals and exit status, that runs the command line's `main`.
"""

import atexit
import contextlib
import ctypes
import importlib
import json
import os
import select
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from functools import cache
from typing import IO, Any

COMMAND = [sys.executable, "-m", "friction_hil"]
_PRELOADED = (
    "can.interfaces.udp_multicast",
    "encodings.idna",
    "encodings.utf_8_sig",
    "friction_hil.cli.run",
    "friction_hil.cli.simulate",
    "friction_hil.cli.work.doctor",
    "friction_hil.cli.work.drives",
    "friction_hil.cli.work.identify",
    "friction_hil.cli.work.replay",
    "friction_hil.cli.work.run",
    "friction_hil.cli.work.simulate",
    "friction_hil.cli.work.stop",
    "friction_hil.cli.work.train",
    "friction_hil.cli.work.tune",
    "friction_hil.config",
    "friction_hil.daemon.session",
    "friction_hil.models",
    "friction_hil_drivers.ascii.simulated",
    "friction_hil_drivers.canopen.wire.multicast",
    "friction_hil_drivers.canopen.simulated.assembly",
    "friction_hil_drivers.canopen.simulated.drives",
    "friction_hil_drivers.modbus.simulated",
)
_SET_BY_PYTEST = ("PYTEST_CURRENT_TEST",)  # changes with each test
_READ_ON_USE = ("XDG_STATE_HOME",)  # no import depends on it: what a fork is told counts
_STREAMS = ("stdin", "stdout", "stderr")
_PR_SET_CHILD_SUBREAPER = 36
_MAX_JOB_BYTES = 65536


_python = sys.executable  # interpreter that runs the commands; see installed_in


@contextlib.contextmanager
def installed_in(python: str) -> Iterator[None]:
    """Start commands with another interpreter, which has a friction_hil of its own."""
    global _python
    before, _python = _python, python
    try:
        yield
    finally:
        _python = before


def start(*arguments: object, **options: Any) -> "Command | subprocess.Popen[str]":
    """Start a command of friction-hil.

    Parameters
    ----------
    arguments : object
        Words of the command line behind ``friction-hil``.
    options
        Those of Popen. With any other than ``stdin``, ``stdout``, ``stderr`` and ``cwd``, or after a change of the
        environment that an import may see, Popen starts an interpreter of its own.
    """
    words = [_python, *COMMAND[1:], *map(str, arguments)]
    if set(options) <= {*_STREAMS, "cwd"} and _environment() == _server(_python).environment:
        return Command(words, **options)
    return subprocess.Popen(words, text=True, **options)


def _environment() -> dict[str, str]:
    return {name: value for name, value in os.environ.items() if name not in (*_SET_BY_PYTEST, *_READ_ON_USE)}


class _Server:
    """The process that forks, seen from the tests."""

    def __init__(self, python: str) -> None:
        self.environment = _environment()
        self._control, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        # -P: the modules beside this file are no modules of the commands
        words = [python, "-P", __file__, str(theirs.fileno())]
        process = subprocess.Popen(words, pass_fds=[theirs.fileno()], stdin=subprocess.DEVNULL)
        theirs.close()
        atexit.register(process.wait)
        atexit.register(self._control.shutdown, socket.SHUT_RDWR)  # runs first, and ends the server

    def fork(self, arguments: list[str], streams: list[int], cwd: str) -> int:
        """Run a command with the given three streams as a child of this process; return its process id."""
        environment = {name: os.environ.get(name) for name in _READ_ON_USE}
        job = json.dumps({"arguments": arguments, "cwd": cwd, "environment": environment}).encode()
        with _adopting_orphans():
            socket.send_fds(self._control, [job], streams)
            answer = self._control.recv(_MAX_JOB_BYTES)
        if not answer:
            raise RuntimeError("the process that forks commands has ended; python -m tests.launcher 0 may show why")
        return int(answer)


@cache
def _server(python: str) -> _Server:
    return _Server(python)


class Command:
    """A command forked by the server, with the part of Popen's interface that tests use; all streams are text."""

    def __init__(
        self,
        args: list[str],
        *,
        stdin: int | IO[Any] | None = None,
        stdout: int | IO[Any] | None = None,
        stderr: int | IO[Any] | None = None,
        cwd: str | os.PathLike[str] | None = None,
    ) -> None:
        self.args = args
        self.returncode: int | None = None
        self.stdin: IO[str] | None = None
        self.stdout: IO[str] | None = None
        self.stderr: IO[str] | None = None
        self._readers: dict[str, _Reader] = {}
        theirs: list[int] = []
        with contextlib.ExitStack() as opened:
            for name, wanted in zip(_STREAMS, (stdin, stdout, stderr), strict=True):
                theirs.append(self._open(name, wanted, theirs, opened))
            self.pid = _server(args[0]).fork(args[len(COMMAND) :], theirs, os.fspath(cwd or os.getcwd()))
        # only now, so that nothing is left behind when forking fails
        self._exit = os.pidfd_open(self.pid)

    def _open(self, name: str, wanted: int | IO[Any] | None, before: list[int], opened: contextlib.ExitStack) -> int:
        """Return the command's end of one stream; what is opened for it alone is closed with ``opened``."""
        own = _STREAMS.index(name)
        if wanted is None:
            return own
        if wanted == subprocess.STDOUT:
            return before[1]
        if wanted == subprocess.DEVNULL:
            theirs = os.open(os.devnull, os.O_RDWR)
        elif wanted == subprocess.PIPE:
            read_end, write_end = os.pipe()
            theirs, ours = (read_end, write_end) if name == "stdin" else (write_end, read_end)
            setattr(self, name, os.fdopen(ours, "w" if name == "stdin" else "r"))
        else:
            return wanted if isinstance(wanted, int) else wanted.fileno()
        opened.callback(os.close, theirs)
        return theirs

    def poll(self) -> int | None:
        """Return the exit status, or None while the command runs."""
        return self._reap(0.0)

    def wait(self, timeout: float | None = None) -> int:
        """Return the exit status when the command has ended; minus the number of the signal that ended it."""
        status = self._reap(timeout)
        if status is None:
            assert timeout is not None
            raise subprocess.TimeoutExpired(self.args, timeout)
        return status

    def _reap(self, timeout: float | None) -> int | None:
        if self.returncode is None:
            poll = select.poll()
            poll.register(self._exit, select.POLLIN)
            if poll.poll(None if timeout is None else timeout * 1e3):
                self.returncode = os.waitstatus_to_exitcode(os.waitpid(self.pid, 0)[1])
                os.close(self._exit)
        return self.returncode

    def send_signal(self, number: int) -> None:
        """Send a signal, unless the command has ended."""
        if self.poll() is None:
            signal.pidfd_send_signal(self._exit, number)

    def kill(self) -> None:
        """Send SIGKILL."""
        self.send_signal(signal.SIGKILL)

    def communicate(self, input: str | None = None, timeout: float | None = None) -> tuple[str, str]:
        """Write ``input``, close standard input and return all output and errors once the command has ended.

        A stream that is no pipe gives an empty text. After `TimeoutExpired` another call goes on from there.
        """
        deadline = None if timeout is None else time.monotonic() + timeout
        for name in ("stdout", "stderr"):
            if (stream := getattr(self, name)) is not None and name not in self._readers:
                self._readers[name] = _Reader(stream)
        if self.stdin is not None and not self.stdin.closed:
            with contextlib.suppress(BrokenPipeError):
                self.stdin.write(input or "")
            with contextlib.suppress(BrokenPipeError):
                self.stdin.close()
        for reader in self._readers.values():
            reader.join(_left(deadline))
            if reader.is_alive():
                assert timeout is not None
                raise subprocess.TimeoutExpired(self.args, timeout)
        self.wait(_left(deadline))
        output, errors = (self._readers[name].text if name in self._readers else "" for name in _STREAMS[1:])
        return output, errors

    def __enter__(self) -> "Command":
        return self

    def __exit__(self, *_: object) -> None:
        for stream in (self.stdout, self.stderr, self.stdin):
            if stream is not None:
                with contextlib.suppress(BrokenPipeError):
                    stream.close()
        self.wait()


class _Reader(threading.Thread):
    """Reads a stream to its end."""

    def __init__(self, stream: IO[str]) -> None:
        super().__init__(daemon=True)
        self.text = ""
        self._stream = stream
        self.start()

    def run(self) -> None:
        with self._stream:
            self.text = self._stream.read()


def _left(deadline: float | None) -> float | None:
    return None if deadline is None else max(0.0, deadline - time.monotonic())


@contextlib.contextmanager
def _adopting_orphans() -> Iterator[None]:
    """Become the parent of descendants whose own parent ends."""
    libc = ctypes.CDLL(None)
    libc.prctl(_PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)
    try:
        yield
    finally:
        libc.prctl(_PR_SET_CHILD_SUBREAPER, 0, 0, 0, 0)


def _serve(control: socket.socket) -> list[str] | None:
    """Fork for each job; return its arguments in the fork, None in the server once the tests have ended."""
    while True:
        data, streams, _, _ = socket.recv_fds(control, _MAX_JOB_BYTES, 3)
        if not data:
            return None
        read_end, write_end = os.pipe()
        between = os.fork()  # ends at once, so that its child becomes that of the test
        if between == 0:
            if (command := os.fork()) != 0:
                os.write(write_end, b"%d" % command)
                os._exit(0)
            for descriptor in (read_end, write_end):
                os.close(descriptor)
            control.close()
            job = json.loads(data)
            os.chdir(job["cwd"])
            for name, value in job["environment"].items():
                if value is None:
                    os.environ.pop(name, None)
                else:
                    os.environ[name] = value
            for own, stream in enumerate(streams):
                os.dup2(stream, own)
            for stream in streams:
                os.close(stream)
            return list(job["arguments"])
        os.waitpid(between, 0)
        control.send(os.read(read_end, _MAX_JOB_BYTES))
        for descriptor in (*streams, read_end, write_end):
            os.close(descriptor)


def load_kernels() -> None:
    """Set up an axis and move a servo, so that no command has to load what they call."""
    from friction_hil import config
    from friction_hil.daemon.axis import AxisLoop
    from friction_hil.drive import AxisFacts
    from friction_hil.models import describe
    from friction_hil.motion.trajectory import PathTime
    from friction_hil.servo.config import ServoConfig
    from friction_hil.servo.servo import Servo

    axis = {
        "driver": "canopen",
        "node": 1,
        "mode": "csp",
        "limits": {"torque": 0.3, "velocity": 2.0},
        "model": {
            "axis": "rotary",
            "friction": {"model": "lugre", "parameters": dict(describe("lugre").example)},
            "mechanics": {"inertia": 2e-4},
        },
        "trajectory": {"kind": "sine", "amplitude": 0.3, "frequency": 1.0},
    }
    bus = {"interface": "virtual", "channel": "none"}
    content = config.from_dict({"version": 1, "period_s": 1e-3, "bus": bus, "axes": {"x": axis}}, "preloaded")
    AxisLoop("x", content.axes["x"], AxisFacts("x", "servo", 1e-5, 1e-3, 1e-3, 1e-3), 1e-3, PathTime(0.25))
    Servo(ServoConfig()).advance(1)


def _main() -> int:
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the command line does before it imports
    for name in _PRELOADED:
        importlib.import_module(name)
    from numba.core.registry import cpu_target

    cpu_target.target_context.refresh()  # else done with the first kernel
    load_kernels()
    arguments = _serve(socket.socket(fileno=int(sys.argv[1])))
    if arguments is None:
        return 0
    from friction_hil.cli import main

    sys.argv[1:] = arguments
    return main()


if __name__ == "__main__":
    sys.exit(_main())
