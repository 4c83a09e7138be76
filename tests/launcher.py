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
import socket
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from typing import Any

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


def start(*arguments: object, **options: Any) -> subprocess.Popen[str]:
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
    if set(options) <= {"stdin", "stdout", "stderr", "cwd"} and _environment() == _server(_python).environment:
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


class Command(subprocess.Popen[str]):
    """A command forked by the server: a child of this process like any other, with its streams as texts."""

    def __init__(self, args: list[str], **options: Any) -> None:
        super().__init__(args, text=True, **options)

    def _execute_child(self, args: list[str], *others: Any, **_: Any) -> None:
        cwd, streams = others[4], others[9:15]  # three pairs of ends, ours and theirs; -1 where nothing is redirected
        theirs = [streams[0], streams[3], streams[5]]
        given = [own if end == -1 else end for own, end in enumerate(theirs)]
        self.pid = _server(args[0]).fork(args[len(COMMAND) :], given, os.fspath(cwd or os.getcwd()))
        self._child_created = True
        self._close_pipe_fds(*streams)  # type: ignore[attr-defined]


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
