"""Control process's side of the companion."""

import contextlib
import json
import math
import os
import selectors
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from friction_hil.daemon.companion.job import Job, encode
from friction_hil.daemon.ring import RingWriter
from friction_hil.errors import RecordingError, UsageError

_RING_S = 8.0  # of rows: what a restart of the worker may take, and an unfinished chunk
_RING_ROWS_MIN = 1024


@dataclass(frozen=True, slots=True)
class CompanionReport:
    """Report on a finished recording.

    Attributes
    ----------
    recording : tuple of str
        Its files, in order; more than one when the worker had to be restarted, none without a path.
    rows, lost : int
        Number of rows that are safe, and of those that are not.
    problems : tuple of str
        Problems during the run, one sentence each.
    """

    recording: tuple[str, ...]
    rows: int
    lost: int
    problems: tuple[str, ...]


class Companion:
    """A running companion process. Create it with `start` and `close` it in any case.

    Attributes
    ----------
    push, push_event, free_slots : callable
        Methods of `friction_hil.daemon.ring.RingWriter`. They never wait, and work on if the companion dies: rows that
        it does not take in time are lost, and counted.
    worker_pid : int
        Process that writes the recording.
    """

    def __init__(self, ring: RingWriter, process: "subprocess.Popen[bytes]") -> None:
        self._ring = ring
        self._process = process
        self._received = b""
        self._paths: list[str] = []
        self._problems: list[str] = []
        self._report: CompanionReport | None = None
        self.push = ring.push
        self.push_event = ring.push_event
        self.free_slots = ring.free_slots
        self.worker_pid = 0

    @classmethod
    def start(cls, job: Job) -> "Companion":
        """Start the process; return when it has opened its file and is ready for rows.

        Missing folders of the path are made.

        Raises
        ------
        UsageError
            The path does not end in ``.mcap``.
        RecordingError
            The file cannot be made or exists already, or the process does not start.
        """
        if job.path is not None:
            prepare(Path(job.path), overwrite=job.overwrite)
        capacity = max(_RING_ROWS_MIN, math.ceil(_RING_S / job.period_s))
        ring = RingWriter(job.row_width, capacity)
        # -P: do not import modules from the current directory, which may be the user's
        command = [sys.executable, "-P", "-m", "friction_hil.daemon.companion"]
        try:
            line = encode(job, ring.descriptor)
            process = subprocess.Popen(
                command,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                pass_fds=[ring.descriptor],
                env=os.environ | {"OPENBLAS_NUM_THREADS": "1"},
            )
        finally:
            os.close(ring.descriptor)
        companion = cls(ring, process)
        companion._begin(line)
        return companion

    @property
    def is_alive(self) -> bool:
        """True while the process runs."""
        return self._process.poll() is None

    def close(self, timeout_s: float = 60.0) -> CompanionReport:
        """Mark the end of the rows, and wait until the recording is finished.

        After ``timeout_s`` the report says that it is not, and the companion goes on in the background. A second
        call returns the same report.
        """
        if self._report is not None:
            return self._report
        self._ring.close_writing()
        if not self._receive_all(timeout_s):
            self._problems.append(f"the recording was not finished within {timeout_s:g} s; that goes on")
        else:
            self._process.wait()
        self._close_pipes()
        rows = self._ring.rows_kept
        lost = self._ring.rows_pushed - rows
        if lost and (self._process.returncode or 0) < 0:
            name = signal.Signals(-self._process.returncode).name
            self._problems.append(f"the companion process was killed (signal {name}): nothing more was recorded")
        self._report = CompanionReport(tuple(self._paths), rows, lost, tuple(self._problems))
        return self._report

    def __enter__(self) -> "Companion":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _begin(self, line: bytes) -> None:
        assert self._process.stdin is not None
        with contextlib.suppress(BrokenPipeError):  # the answer will then be missing
            self._process.stdin.write(line)
            self._process.stdin.flush()
        answer = self.next_message()
        if answer is not None and "failed" not in answer:
            return
        status = self._process.wait()
        self._close_pipes()
        raise RecordingError(
            answer["failed"] if answer else f"the companion process did not start (exit status {status})"
        )

    def next_message(self) -> dict[str, Any] | None:
        """Wait for the next message of the companion; None when it has ended."""
        assert self._process.stdout is not None
        while b"\n" not in self._received:
            data = os.read(self._process.stdout.fileno(), 1 << 16)
            if not data:
                return None
            self._received += data
        line, _, self._received = self._received.partition(b"\n")
        message: dict[str, Any] = json.loads(line)
        if message.get("opened"):
            self._paths.append(message["opened"])
        if "problem" in message:
            self._problems.append(message["problem"])
        self.worker_pid = message.get("pid", self.worker_pid)
        return message

    def _receive_all(self, timeout_s: float) -> bool:
        deadline = time.monotonic() + timeout_s
        with selectors.DefaultSelector() as selector:
            assert self._process.stdout is not None
            selector.register(self._process.stdout, selectors.EVENT_READ)
            while selector.select(max(0.0, deadline - time.monotonic())):
                if self.next_message() is None:
                    return True
        return False

    def _close_pipes(self) -> None:
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                with contextlib.suppress(BrokenPipeError):
                    pipe.close()


def free_path(path: str | Path, started_unix_ns: int) -> Path:
    """Return ``path``, or if it exists the same with the local time in its name: ``run-20260131-142530.mcap``.

    This is for the path of a configuration, which is the same at every run; a path that the user gives for one run
    is refused if it exists.

    Parameters
    ----------
    path : path
        File wanted.
    started_unix_ns : int
        Wall-clock time of the start, ns since 1970; 0 for now.
    """
    path = Path(path)
    if not path.exists():
        return path
    started = datetime.fromtimestamp((started_unix_ns or time.time_ns()) * 1e-9).astimezone()
    return path.with_stem(f"{path.stem}-{started:%Y%m%d-%H%M%S}")


def prepare(path: Path, *, overwrite: bool) -> None:
    """Create the folder of a recording, and check that the recording can be written.

    Raises
    ------
    UsageError
        The path does not end in ``.mcap``.
    RecordingError
        It is a folder, it exists already and must not be overwritten, or its folder cannot be created.
    """
    if path.is_dir():
        raise UsageError(f"{path} is a folder: name the file in it, e.g. {path / 'run.mcap'}")
    if path.suffix.lower() != ".mcap":
        raise UsageError(f"{path}: recordings are written as .mcap; `friction-hil convert` makes other formats of one")
    if path.exists() and not overwrite:
        raise RecordingError(f"{path} exists already; --force replaces it")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        is_in_the_way = isinstance(error, FileExistsError | NotADirectoryError)
        reason = "there is a file of that name" if is_in_the_way else error.strerror
        raise RecordingError(f"the folder {path.parent} cannot be made: {reason}") from None
