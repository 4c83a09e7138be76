"""Control process's side of the companion, and of all other processes beside the loop."""

import contextlib
import ctypes
import json
import math
import os
import select
import signal
import subprocess
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from friction_hil.daemon import supervisor
from friction_hil.daemon.companion.job import Job
from friction_hil.daemon.companion.paths import prepare
from friction_hil.daemon.lives import MOST_SHORT_LIVES, make_lives
from friction_hil.daemon.ring import RingWriter
from friction_hil.daemon.shared_document import make_document
from friction_hil.daemon.supervisor import Beside
from friction_hil.errors import RecordingError

COMPANION = "the companion process"
_RING_S = 8.0  # of rows: what a restart of the companion may take, and an unfinished chunk
_RING_ROWS_MIN = 1024
_SPARE_STATES = 3  # of a loop of the user's own: a state outlives the rows that begin with it
_PATIENCE_S = 10.0  # without any progress, for the end of the recording
_END_S = 5.0  # for that of the processes
_SLICE_S = 0.1
_PR_SET_CHILD_SUBREAPER = 36


@dataclass(frozen=True, slots=True)
class CompanionReport:
    """Report on a finished recording."""

    recording: tuple[str, ...]  # its files that are there, in order; none without a path
    rows: int  # that are safe
    lost: int  # rows that are not safe
    problems: tuple[str, ...]  # during the run, one sentence each
    pending: int = 0  # rows that a companion which does not end has yet to write; they are neither safe nor lost
    black_boxes: tuple[str, ...] = ()  # files of faults, each with the minute before it


def ring_of(job: Job) -> RingWriter:
    """Return the ring of a job."""
    rows = max(_RING_ROWS_MIN, math.ceil(_RING_S / job.period_s))
    states = rows // job.rows_between_states + _SPARE_STATES if job.rows_between_states else 0
    return RingWriter(job.row_width, rows, tail=states * len(job.axes) * job.state_width)


class Companion:
    """The companion that records, and what else runs beside the loop. Create it with `start`, `close` it in any case.

    ``push``, ``push_event``, ``free_slots`` and ``tend`` never wait, and work on if the companion dies: rows that no
    companion takes in time are lost, and counted.
    """

    def __init__(self, job: Job, journal: int, others: Sequence[Beside], ring: RingWriter, *, adopts: bool) -> None:
        self._ring = ring
        self.push = ring.push  # methods of `friction_hil.daemon.ring.RingWriter`
        self.push_event = ring.push_event
        self.free_slots = ring.free_slots
        self._received = b""
        self._paths: list[str] = []
        self._black_boxes: list[str] = []
        self._problems: list[str] = []
        self._news: list[tuple[str, str]] = []
        self._report: CompanionReport | None = None
        self._is_woken = self._is_done = self._is_alone = False
        self._starts = self._group = 0
        self.worker_pid = self.supervisor_pid = 0  # of the process that records, and of the one that started it
        self.over: set[str] = set()  # titles of processes that are not started any more
        minute = -1 if job.black_box is None else os.memfd_create("friction_hil-minute")
        given = [ring.descriptor, make_document("job", asdict(job)), journal, minute]
        recording = Beside(
            title=COMPANION,
            loss="nothing more is recorded",
            words=["-m", "friction_hil.daemon.companion", *map(str, given)],
            descriptors=[each for each in given if each >= 0],
            is_heir=True,
        )
        processes, lives = [recording, *others], make_lives(2 + len(others))
        self._inherited = [*{lives, *(each for process in processes for each in process.descriptors)}]
        content = {"lives": lives, "descriptors": self._inherited, "processes": [asdict(each) for each in processes]}
        self._plan = make_document("plan", content)
        self._life, self._end = os.pipe()  # standard input of all processes, and its other end, which ends them
        self._reports = -1
        self._own = [*(each for each in given if each not in (journal, -1)), lives, self._plan, self._life]
        self._poll = select.poll()
        if adopts:  # what outlives a supervisor becomes a child of this process: it stays in its tree
            ctypes.CDLL(None).prctl(_PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)
        self._launch()

    @classmethod
    def start(
        cls,
        job: Job,
        journal: int = -1,
        others: Sequence[Beside] = (),
        ring: RingWriter | None = None,
        *,
        adopts: bool = True,
    ) -> "Companion":
        """Start the processes; return when the companion has opened its file and is ready for rows.

        Missing folders of the path are made. ``journal``: that of the changes of the run, see
        `friction_hil.daemon.control.journal`; -1 for none. ``others`` are started with it; ``ring`` is that which they
        know, from `ring_of`. ``adopts``: orphans of all processes become children of this one; not in a user's.

        Raises `UsageError`: the path does not end in ``.mcap``; `RecordingError`: the file cannot be made or exists
        already, or the process does not start.
        """
        if job.path is not None:
            prepare(Path(job.path), overwrite=job.overwrite)
        try:
            companion = cls(job, journal, others, ring or ring_of(job), adopts=adopts)
        except OSError as error:  # too many processes, no memory
            raise RecordingError(f"{COMPANION} cannot be started: {error.strerror}") from error
        try:
            companion._begin()
        except BaseException:  # a signal too: opening a file may take forever
            companion._kill()
            companion.process.wait()
            companion._close_descriptors()
            raise
        return companion

    @property
    def is_given_up(self) -> bool:
        """True if no companion records any more: it has died again and again."""
        return COMPANION in self.over

    def tend(self) -> list[tuple[str, str]]:
        """Take the messages of the processes; return new events, each its name and text.

        To be called several times a second during the run; it never waits.
        """
        while not self._is_alone and self._poll.poll(0):
            if not self._read():  # nobody is left who could start another one, and the loop must not wait for a fork
                self._is_alone = True
                self._report_problem("all processes beside the loop died: nothing more is recorded until the run ends")
            while self._take_message() is not None:
                pass
        is_late = self._ring.free_slots() < self._ring.capacity // 2
        if is_late and not self._is_woken:  # it may have been stopped (SIGSTOP)
            self._wake()
        self._is_woken = is_late
        news, self._news = self._news, []
        return news

    def close(self, patience_s: float = _PATIENCE_S) -> CompanionReport:
        """Mark the end of the rows, wait until the recording is finished, and end all processes.

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
            lost, pending = lost + pending, 0
        else:
            self._problems.append(
                f"the recording is not finished: process {self.worker_pid} made no progress for {patience_s:g} s; it "
                f"has yet to write {pending} rows, and goes on in the background"
            )
        self._end_all(is_finished=is_finished)
        files, black_boxes = tuple(self._paths), tuple(self._black_boxes)
        self._report = CompanionReport(files, rows, lost, tuple(self._problems), pending, black_boxes)
        return self._report

    def leave(self) -> None:
        """Let go, in a forked process, of the end of the pipe whose hang-up ends all processes."""
        if self._end >= 0:
            os.close(self._end)
            self._end = -1

    def __enter__(self) -> "Companion":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _launch(self) -> None:
        """Start a supervisor. Raises `OSError`: the system makes no process."""
        reports, theirs = os.pipe()
        try:
            self.process = subprocess.Popen(
                supervisor.command(self._plan),
                stdin=self._life,
                stdout=theirs,
                pass_fds=(self._plan, *self._inherited),
                env=os.environ | supervisor.ENVIRONMENT,
                process_group=0,  # Ctrl-C is not meant for it, nor for those that it starts
            )
        except OSError:
            os.close(reports)
            raise
        finally:
            os.close(theirs)
        if self._reports >= 0:
            self._poll.unregister(self._reports)
            os.close(self._reports)
        self._reports, self._received, self._is_alone = reports, b"", False
        self.supervisor_pid = self.process.pid
        self._group = self._group or self.process.pid
        self._starts += 1
        self._poll.register(reports, select.POLLIN)

    def _begin(self) -> None:
        while not self.worker_pid:
            answer = self.next_message()
            if answer is None or self.is_given_up:
                raise RecordingError(f"{COMPANION} did not start")
            if "failed" in answer:
                raise RecordingError(answer["failed"])

    def _wake(self) -> None:
        for pid in (self.supervisor_pid, self.worker_pid):
            if pid:
                with contextlib.suppress(ProcessLookupError, PermissionError):
                    os.kill(pid, signal.SIGCONT)

    def next_message(self) -> dict[str, Any] | None:
        """Wait for the next message of the processes; None when all have ended."""
        while (message := self._take_message()) is None:
            if not self._read():
                return None
        return message

    def _read(self) -> bool:
        """Read what the processes have sent; return False when all have ended."""
        data = os.read(self._reports, 1 << 16)
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
        if message.get("removed") in self._paths:
            self._paths.remove(message["removed"])
        if "black_box" in message:
            self._black_boxes.append(message["black_box"])
        if "problem" in message:
            self._report_problem(message["problem"])
        if "text" in message:
            self._news.append((message["severity"], message["text"]))
        if "over" in message:
            self.over.add(message["over"])
        self._is_done = self._is_done or "done" in message
        self.worker_pid = message.get("pid", self.worker_pid)
        self.supervisor_pid = message.get("supervisor", self.supervisor_pid)
        return message

    def _report_problem(self, text: str) -> None:
        self._problems.append(text)
        self._news.append(("warning", f"recording: {text}"))

    def _receive_all(self, patience_s: float) -> bool:
        """Take all messages until no companion works any more; return False after ``patience_s`` without progress."""
        progress, since_s = -1, time.monotonic()
        while not (self._is_done or self.is_given_up):
            self._wake()
            if not self._poll.poll(_SLICE_S * 1e3):
                if (now_done := self._ring.rows_done) != progress:
                    progress, since_s = now_done, time.monotonic()
                elif time.monotonic() - since_s > patience_s:
                    return False
            elif self._read():
                since_s = time.monotonic()
            elif self._starts > MOST_SHORT_LIVES or not self._start_again():
                return True
            while self._take_message() is not None:
                pass
        return True

    def _start_again(self) -> bool:
        """Start another supervisor after the loop; return False if that cannot be."""
        self.process.wait()
        try:
            self._launch()
        except OSError as error:
            self._problems.append(f"{COMPANION} died, and another one cannot be started ({error.strerror})")
            return False
        return True

    def _end_all(self, *, is_finished: bool) -> None:
        """End all processes; one that has yet to finish the recording goes on, and its supervisor with it."""
        os.close(self._end)
        self._end = -1
        self._wake()
        end_s = time.monotonic() + _END_S
        # until the last one has ended, but not forever: one may hang in the kernel
        while is_finished and time.monotonic() < end_s + 1.0 and (not self._poll.poll(_SLICE_S * 1e3) or self._read()):
            if time.monotonic() > end_s:
                self._kill()
        if is_finished:
            with contextlib.suppress(subprocess.TimeoutExpired):
                self.process.wait(1.0)
            with contextlib.suppress(ChildProcessError):
                while os.waitpid(-self._group, os.WNOHANG)[0]:  # those that have outlived their supervisor
                    pass
        self._close_descriptors()

    def _kill(self) -> None:
        """Kill what is left: all processes are of one group."""
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(self._group, signal.SIGKILL)

    def _close_descriptors(self) -> None:
        for each in (*self._own, self._reports, self._end):
            if each >= 0:
                os.close(each)
