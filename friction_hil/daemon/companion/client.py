"""Control process's side of the companion."""

import contextlib
import json
import math
import os
import select
import signal
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import IO, Any

from friction_hil.daemon.companion.job import MOST_SHORT_LIVES, Job, Lives, signal_text
from friction_hil.daemon.companion.paths import prepare
from friction_hil.daemon.ring import RingWriter
from friction_hil.daemon.shared_document import make_document
from friction_hil.daemon.spawner.client import Process, Spawn, spawn_directly
from friction_hil.errors import RecordingError

_RING_S = 8.0  # of rows: what a restart of the worker may take, and an unfinished chunk
_RING_ROWS_MIN = 1024
_PATIENCE_S = 10.0  # without any progress, for the end of the recording
_SLICE_S = 0.1


@dataclass(frozen=True, slots=True)
class CompanionReport:
    """Report on a finished recording."""

    recording: tuple[str, ...]  # its files that are there, in order; none without a path
    rows: int  # that are safe
    lost: int  # rows that are not safe
    problems: tuple[str, ...]  # during the run, one sentence each
    pending: int = 0  # rows that a companion which does not end has yet to write; they are neither safe nor lost
    black_boxes: tuple[str, ...] = ()  # files of faults, each with the minute before it


class Companion:
    """A running companion process. Create it with `start` and `close` it in any case.

    ``push``, ``push_event`` and ``free_slots`` never wait, and work on if the companion dies: rows that no companion
    takes in time are lost, and counted.
    """

    def __init__(self, job: Job, journal_descriptor: int, spawn: Spawn) -> None:
        self._spawn = spawn
        self._journal_descriptor = journal_descriptor
        self._ring = RingWriter(job.row_width, max(_RING_ROWS_MIN, math.ceil(_RING_S / job.period_s)))
        self._job_descriptor = make_document("job", asdict(job))
        self._lives = Lives()
        self._received = b""
        self._paths: list[str] = []
        self._opened = 0  # files so far, also those that were removed since
        self._black_boxes: list[str] = []
        self._problems: list[str] = []
        self._report: CompanionReport | None = None
        self._is_woken = False
        self.push = self._ring.push  # methods of `friction_hil.daemon.ring.RingWriter`
        self.push_event = self._ring.push_event
        self.free_slots = self._ring.free_slots
        self.worker_pid = 0  # of the process that writes the recording
        self.is_given_up = False  # no companion records any more: it ended by itself, or died again and again
        self.process: Process  # the supervisor
        self._launch()

    @classmethod
    def start(cls, job: Job, journal_descriptor: int = -1, spawn: Spawn = spawn_directly) -> "Companion":
        """Start the process; return when it has opened its file and is ready for rows.

        Missing folders of the path are made. ``journal_descriptor`` is the journal of the changes of the run, see
        `friction_hil.daemon.control.journal`; -1 for none. ``spawn`` starts this companion, and those after it.

        Raises `UsageError`: the path does not end in ``.mcap``; `RecordingError`: the file cannot be made or exists
        already, or the process does not start.
        """
        if job.path is not None:
            prepare(Path(job.path), overwrite=job.overwrite)
        try:
            companion = cls(job, journal_descriptor, spawn)
        except OSError as error:  # too many processes, no memory
            raise RecordingError(f"the companion process cannot be started: {error.strerror}") from error
        try:
            companion._begin()
        except BaseException:  # a signal too: opening a file may take forever
            companion.process.kill()  # and with it a worker that is still opening its file
            companion.process.wait()
            companion._close_descriptors()
            raise
        return companion

    @property
    def ring_descriptor(self) -> int:
        """Memory of the ring, for those who only look."""
        return self._ring.descriptor

    @property
    def is_alive(self) -> bool:
        """True while the supervisor runs."""
        return self.process.poll() is None

    def tend(self) -> list[str]:
        """Take the messages of the companion, and start another one where it has died; return new problems.

        To be called several times a second during the run; it never waits for the companion, nor, with a spawner, until
        one is started.
        """
        known = len(self._problems)
        while not self.is_given_up and self._poll.poll(0):
            if not self._read() and not self._restart():
                break
            while self._take_message() is not None:
                pass
        self._wake_if_late()
        return self._problems[known:]

    def close(self, patience_s: float = _PATIENCE_S) -> CompanionReport:
        """Mark the end of the rows, and wait until the recording is finished.

        A companion that was stopped (SIGSTOP) is continued. One that makes no progress for ``patience_s`` goes on in
        the background, and the report says so. A second call returns the same report.
        """
        if self._report is not None:
            return self._report
        self._ring.close_writing()
        is_finished = self._receive_all(patience_s)
        rows, lost = self._ring.rows_kept, self._ring.rows_lost
        pending = self._ring.rows_pushed - rows - lost
        if is_finished:
            self.process.wait()
            lost, pending = lost + pending, 0
        else:
            self._problems.append(
                f"the recording is not finished: process {self.worker_pid} made no progress for {patience_s:g} s; it "
                f"has yet to write {pending} rows, and goes on in the background"
            )
        self._close_descriptors()
        files, black_boxes = tuple(self._paths), tuple(self._black_boxes)
        self._report = CompanionReport(files, rows, lost, tuple(self._problems), pending, black_boxes)
        return self._report

    def __enter__(self) -> "Companion":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _launch(self, death: str = "") -> None:
        """Start a supervisor, whose first worker writes the next file of the recording.

        Raises `OSError`: the system makes no process; nothing has changed.
        """
        descriptors = [self._ring.descriptor, self._job_descriptor, self._journal_descriptor]
        command = ["-m", "friction_hil.daemon.companion", *map(str, (*descriptors, self._opened + 1, death))]
        self.process = self._spawn(command, [each for each in descriptors if each >= 0], None)
        self._lives.begin()
        self.worker_pid = 0
        assert self.process.stdout is not None
        self._poll = select.poll()
        self._poll.register(self.process.stdout, select.POLLIN)

    def _begin(self) -> None:
        answer = self.next_message()
        if answer is None:
            raise RecordingError(f"the companion process did not start (exit status {self.process.wait()})")
        if "failed" in answer:
            raise RecordingError(answer["failed"])

    def _restart(self) -> bool:
        """Start another companion after the death of supervisor and worker; return False if none is there now."""
        status = self.process.poll()
        if status is None:  # both have closed their output: the supervisor is about to be dead
            return False
        if status >= 0:
            self.is_given_up = True  # it has said why, or has done its work
            return False
        death, pipes = signal_text(-status), (self.process.stdin, self.process.stdout)
        if self._lives.end():
            self.is_given_up = True
            self._problems.append(
                f"{MOST_SHORT_LIVES} companion processes were killed at once ({death}): nothing more is recorded"
            )
            return False
        try:
            self._launch(death)
        except OSError as error:  # too many processes, no memory: no reason to end a run
            self.is_given_up = True
            self._problems.append(
                f"the companion process died ({death}), and another one cannot be started ({error.strerror}): nothing "
                "more is recorded"
            )
            return False
        _close(*pipes)
        self._received = b""
        return True

    def _wake_if_late(self) -> None:
        """Continue a companion that may have been stopped (SIGSTOP), once each time the ring is half full."""
        is_late = self._ring.free_slots() < self._ring.capacity // 2
        if is_late and not self._is_woken:
            self._wake()
        self._is_woken = is_late

    def _wake(self) -> None:
        self.process.send_signal(signal.SIGCONT)
        if self.worker_pid:
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.kill(self.worker_pid, signal.SIGCONT)

    def next_message(self) -> dict[str, Any] | None:
        """Wait for the next message of the companion; None when it has ended."""
        while (message := self._take_message()) is None:
            if not self._read():
                return None
        return message

    def _read(self) -> bool:
        """Read what the companion has sent; return False when it has ended."""
        assert self.process.stdout is not None
        data = os.read(self.process.stdout.fileno(), 1 << 16)
        self._received += data
        return bool(data)

    def _take_message(self) -> dict[str, Any] | None:
        """Take the next message that has been read as a whole; None if there is none."""
        line, end, rest = self._received.partition(b"\n")
        if not end:
            return None
        self._received = rest
        message: dict[str, Any] = json.loads(line)
        if message.get("opened"):
            self._paths.append(message["opened"])
            self._opened += 1
        if message.get("removed") in self._paths:
            self._paths.remove(message["removed"])
        if "black_box" in message:
            self._black_boxes.append(message["black_box"])
        if "problem" in message:
            self._problems.append(message["problem"])
        self.worker_pid = message.get("pid", self.worker_pid)
        return message

    def _receive_all(self, patience_s: float) -> bool:
        """Take all messages until no companion works any more; return False after ``patience_s`` without progress."""
        progress, since_s = -1, time.monotonic()
        while True:
            self._wake()
            if not self._poll.poll(_SLICE_S * 1e3):
                if (now_done := self._ring.rows_done) != progress:
                    progress, since_s = now_done, time.monotonic()
                elif time.monotonic() - since_s > patience_s:
                    return False
            elif self._read():
                since_s = time.monotonic()
            elif self._ring.rows_done == self._ring.rows_pushed or self.is_given_up:
                return True
            else:
                self.process.wait()
                if not self._restart():
                    return True
            while self._take_message() is not None:
                pass

    def _close_descriptors(self) -> None:
        _close(self.process.stdin, self.process.stdout)
        os.close(self._ring.descriptor)
        os.close(self._job_descriptor)


def _close(*pipes: IO[bytes] | None) -> None:
    for pipe in pipes:
        if pipe is not None:
            with contextlib.suppress(BrokenPipeError):
                pipe.close()
