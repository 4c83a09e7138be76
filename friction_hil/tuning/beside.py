"""Computing beside the motion: a process that computes one job after the other while axes move.

It has the lowest priority and, while an axis moves, all processors but one, so that the loop is not late for it
(FH-230); at standstill it has all of them. Nothing of it runs in the process of the loop, not even a thread that waits.
"""

import contextlib
import ctypes
import json
import os
import pickle
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from friction_hil.errors import FrictionHilError
from friction_hil.tuning.settings import ShowStep

_NICENESS = 19
_PR_SET_PDEATHSIG = 1
_LOOK_S = 0.05
_ATTEMPTS, _BETWEEN_S = 5, 0.1


class Worker:
    """A process that computes jobs in the order in which they are given, from the first one until it is closed.

    A job is a function of a module, its arguments, and then a `ShowStep`; they and its result can be pickled. What goes
    wrong other than by a `FrictionHilError`, the end of the process too, has the job computed again in this process,
    where its error has a place.
    """

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        self._folder = tempfile.TemporaryDirectory(prefix="friction_hil_tune_")
        self._jobs: list[tuple[Callable[..., Any], tuple[Any, ...]]] = []

    def __enter__(self) -> "Worker":
        return self

    def __exit__(self, *_: object) -> None:
        self._stop()
        self._folder.cleanup()

    def _stop(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.communicate()
        self._process = None

    def submit(self, function: Callable[..., Any], *arguments: Any) -> int:
        """Give a job; return its number for `result`."""
        number = len(self._jobs)
        self._jobs.append((function, arguments))
        with contextlib.suppress(OSError):  # then it is computed by this process
            self._give(number)
        return number

    def _give(self, number: int) -> None:
        with self._path(number, "job").open("wb") as file:
            pickle.dump(self._jobs[number], file)
        process = self._process = self._process or self._started()
        assert process.stdin is not None
        process.stdin.write(f"{self._path(number, '')}\n".encode())
        process.stdin.flush()

    def replace(self, number: int, *arguments: Any) -> None:
        """Compute a job with other arguments, because its result is of no use any more; it is lost."""
        function, _ = self._jobs[number]
        left = [k for k in range(len(self._jobs)) if k == number or not self._path(k, "done").exists()]
        self._stop()
        self._jobs[number] = (function, arguments)
        with contextlib.suppress(OSError):
            for kind in ("done", "step"):
                self._path(number, kind).unlink(missing_ok=True)
            for k in left:
                self._give(k)

    def result(self, number: int, show: ShowStep) -> Any:
        """Wait for a job and return its result; ``show`` is told of its steps. No axis moves meanwhile."""
        done = self._path(number, "done")
        told = ""
        while not done.exists():
            if self._process is None or self._process.poll() is not None:
                break
            with contextlib.suppress(OSError, ValueError):
                text = self._path(number, "step").read_text(encoding="utf-8")
                if text != told:
                    show(*json.loads(text))
                    told = text
            time.sleep(_LOOK_S)
        function, arguments = self._jobs[number]
        self._jobs[number] = function, ()  # what it has been given is large
        try:
            result, error = pickle.loads(done.read_bytes())
        except Exception:  # noqa: BLE001  there is none, or not all of it
            return function(*arguments, show)
        if error is not None:
            raise error
        return result

    @contextlib.contextmanager
    def aside(self) -> Iterator[None]:
        """Leave a processor to the loop, as long as axes move."""
        every = os.sched_getaffinity(0)
        self._confine(every - {min(every)} or every, _NICENESS)
        try:
            yield
        finally:
            self._confine(every, 0)

    def _confine(self, processors: set[int], niceness: int) -> None:
        """Set what the process may use. Linux weighs sessions first, by a niceness of their own (autogroup)."""
        if self._process is None:
            return
        folder = Path("/proc", str(self._process.pid))
        with contextlib.suppress(OSError):  # it has ended, or one of its threads has
            for thread in (folder / "task").iterdir():
                os.sched_setaffinity(int(thread.name), processors)
        for _ in range(_ATTEMPTS):
            try:
                (folder / "autogroup").write_text(str(niceness), encoding="ascii")
            except BlockingIOError:  # another process has just changed its own
                time.sleep(_BETWEEN_S)
            except OSError:
                return
            else:
                return

    def _path(self, number: int, kind: str) -> Path:
        return Path(self._folder.name, f"{number}.{kind}")

    def _started(self) -> "subprocess.Popen[bytes]":
        # a session of its own: Ctrl-C reaches the process of the loop alone, which brings the axes to rest
        return subprocess.Popen(
            [sys.executable, "-P", "-c", f"from {__name__} import main; main()"],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )


def main() -> None:
    """Compute jobs until there are no more, or the parent has ended."""
    with contextlib.suppress(AttributeError, OSError):  # not on every system
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
    os.setpriority(os.PRIO_PROCESS, 0, _NICENESS)
    with contextlib.suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
    for line in sys.stdin:
        _compute(line.strip())


def _compute(path: str) -> None:
    """Compute one job, whose files begin with ``path``."""

    def show(text: str, number: int = 0, count: int | None = None, /) -> None:
        _replace(f"{path}step", json.dumps([text, number, count]).encode())

    done: tuple[Any, FrictionHilError | None]
    try:
        function, arguments = pickle.loads(Path(f"{path}job").read_bytes())
        done = function(*arguments, show), None
        content = pickle.dumps(done)
    except FrictionHilError as error:
        content = pickle.dumps((None, error))
    except Exception:  # noqa: BLE001  the parent computes it again, and tells where it fails
        content = b""
    _replace(f"{path}done", content)


def _replace(path: str, content: bytes) -> None:
    Path(f"{path}.new").write_bytes(content)
    os.replace(f"{path}.new", path)
