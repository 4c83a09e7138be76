"""Commands of friction-hil as processes that need not import: each is a fork of one process that has imported all.

To import takes a second of processor time, and tests start hundreds of commands. What is forked here is what a shell
would start: a process of its own, with its own streams, signals and exit status, that runs the command line's `main`.
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
    "friction_hil.cli.run",
    "friction_hil.cli.simulate",
    "friction_hil.config",
    "friction_hil.daemon.session",
    "friction_hil.models",
    "friction_hil_drivers.ascii",
    "friction_hil_drivers.canopen",
    "friction_hil_drivers.modbus",
)
_OF_PYTEST = ("PYTEST_CURRENT_TEST",)  # is another one in each test
_PR_SET_CHILD_SUBREAPER = 36
_LONGEST_JOB = 65536


def start(*arguments: object, **options: Any) -> "subprocess.Popen[str]":
    """Start a command of friction-hil; ``options`` are those of Popen."""
    words = [*COMMAND, *map(str, arguments)]
    is_plain = set(options) <= {"stdin", "stdout", "stderr"} and _environment() == _server().environment
    return (_Forked if is_plain else subprocess.Popen)(words, text=True, **options)


def _environment() -> dict[str, str]:
    return {name: value for name, value in os.environ.items() if name not in _OF_PYTEST}


class _Server:
    """The process that forks, as others see it."""

    def __init__(self) -> None:
        self.environment = _environment()
        self.control, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        words = [sys.executable, "-m", "tests.launcher", str(theirs.fileno())]
        process = subprocess.Popen(words, pass_fds=[theirs.fileno()], stdin=subprocess.DEVNULL)
        theirs.close()
        atexit.register(process.wait)
        atexit.register(self.control.shutdown, socket.SHUT_RDWR)  # which comes first, and ends it


@cache
def _server() -> _Server:
    return _Server()


class _Forked(subprocess.Popen[str]):
    """A command that is forked by the server, and becomes a child of this process."""

    def _execute_child(self, args: list[str], *rest: Any) -> None:
        # as Popen has them behind the program: ..., p2cread, p2cwrite, c2pread, c2pwrite, errread, errwrite, ...
        pipes = rest[9:15]
        streams = [theirs if theirs >= 0 else own for own, theirs in enumerate((pipes[0], pipes[3], pipes[5]))]
        job = json.dumps({"arguments": args[len(COMMAND) :], "cwd": os.getcwd()}).encode()
        control = _server().control
        with _taking_in_orphans():
            socket.send_fds(control, [job], streams)
            answer = control.recv(_LONGEST_JOB)
        if not answer:
            raise RuntimeError("the process that forks commands has ended; python -m tests.launcher 0 may tell why")
        self.pid = int(answer)
        self._child_created = True
        self._close_pipe_fds(*pipes)  # type: ignore[attr-defined]


@contextlib.contextmanager
def _taking_in_orphans() -> Iterator[None]:
    """Become the parent of what loses its own."""
    libc = ctypes.CDLL(None)
    libc.prctl(_PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)
    try:
        yield
    finally:
        libc.prctl(_PR_SET_CHILD_SUBREAPER, 0, 0, 0, 0)


def _serve(control: socket.socket) -> list[str] | None:
    """Fork for each job; return its arguments in the fork, None in the server when nobody has jobs any more."""
    while True:
        data, streams, _, _ = socket.recv_fds(control, _LONGEST_JOB, 3)
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
            for own, stream in enumerate(streams):
                os.dup2(stream, own)
            for stream in streams:
                os.close(stream)
            return list(job["arguments"])
        os.waitpid(between, 0)
        control.send(os.read(read_end, _LONGEST_JOB))
        for descriptor in (*streams, read_end, write_end):
            os.close(descriptor)


def _main() -> int:
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the command line does before it imports
    for name in _PRELOADED:
        importlib.import_module(name)
    from numba.core.registry import cpu_target

    cpu_target.target_context.refresh()  # which else comes with the first kernel
    arguments = _serve(socket.socket(fileno=int(sys.argv[1])))
    if arguments is None:
        return 0
    from friction_hil.cli import main

    sys.argv[1:] = arguments
    return main()


if __name__ == "__main__":
    sys.exit(_main())
