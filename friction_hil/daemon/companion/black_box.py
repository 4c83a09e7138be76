"""Files of faults: the minute before each, and the seconds after it."""

import os
import time
from collections import deque
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path

import numpy as np

from friction_hil.daemon.companion.budget import Budget
from friction_hil.daemon.companion.changes import FileChanges
from friction_hil.daemon.companion.history import History
from friction_hil.daemon.companion.job import Job, say, warn
from friction_hil.daemon.companion.new_file import begin_file
from friction_hil.errors import RecordingError
from friction_hil.recordings.columns import CYCLE, TIME
from friction_hil.recordings.mcap_format import IS_OF_FAULT
from friction_hil.recordings.mcap_writer import McapWriter

ABANDONED = ("abandoned", "the control process ended without closing the run")  # event
AFTER_S = 10.0
_LONGEST_AFTER_S = 60.0  # faults that follow each other prolong the file, but not forever
_MOST_EVENTS = 1000
_ROWS_AT_ONCE = 5000  # so that the ring is drained in between


class BlackBox:
    """Write a file of its own for each fault, from the rows that `History` keeps.

    A fault while a file is being written belongs to that file. What cannot be written is reported, and given up: the
    run, and its recording, go on.

    ``job`` has a ``black_box``. The rows are appended to ``history`` before this is told of them. ``budget``: in which
    room is made for the files.
    """

    def __init__(self, job: Job, history: History, journal: int, budget: Budget | None = None) -> None:
        assert job.black_box is not None
        self._budget = budget
        self._job, self._history, self._path = job, history, Path(job.black_box)
        self._journal, self._file_changes = journal, FileChanges(journal, job.columns)
        self._time, self._cycle = job.columns.index(TIME), job.columns.index(CYCLE)
        self._events: deque[tuple[float, str, str]] = deque(maxlen=_MOST_EVENTS)
        self._left: deque[tuple[float, str, str]] = deque()  # events of the file that are not written yet
        self._writer: McapWriter | None = None
        self._next = 0  # row of the history
        self._latest_end_s = 0.0
        self._is_due = False
        if history.fault is not None:  # the worker before this one died while it wrote the file
            self._open(*history.fault)

    def take(self, events: Sequence[tuple[float, str, str]]) -> None:
        """Take the events that belong to the rows in the history; a fault among them begins a file."""
        self._events.extend(events)
        if self._history.fault is not None:
            self._left.extend(events)
        self._is_due = self._is_due or any(name in ("fault", ABANDONED[0]) for _, name, _ in events)
        if self._is_due and self._history.count:
            self._is_due = False
            self._begin()

    def advance(self) -> None:
        """Write some of the rows that are due; close the file after the last one."""
        if self._writer is None or self._history.fault is None:
            return
        _, end_s = self._history.fault
        try:
            self._next = max(self._next, self._history.oldest)  # a slow disk: what was overwritten is missing
            rows, has_state = self._history.read(self._next, self._next + _ROWS_AT_ONCE)
            inside = rows[:, self._time] <= end_s
            rows, is_over = rows[inside], not inside.all()
            if len(rows):
                for event in self._file_changes.ahead_of(rows, self._left):
                    self._writer.write_event(*event)
                self._writer.write(rows, has_state[inside])
                self._next += len(rows)
                self._file_changes.write(self._writer, self._left, float(rows[-1, self._cycle]))
            if is_over:
                self._end()
        except OSError as error:
            self._give_up(error)

    def finish(self, *, was_abandoned: bool) -> None:
        """Write what is due, and close the file: no row comes any more. The death of the daemon is a fault as well."""
        if was_abandoned and self._history.count:
            self.take([(self._history.last_cycle, *ABANDONED)])
        while self._writer is not None and self._next < self._history.count:
            self.advance()
            say(progress=self._next)  # the control process waits for the end, but not forever
        if self._writer is not None:
            try:
                self._end()
            except OSError as error:
                self._give_up(error)

    def _begin(self) -> None:
        last_s = self._history.last_s
        if self._history.fault is not None:
            first, _ = self._history.fault
            self._history.fault = first, min(last_s + AFTER_S, self._latest_end_s)
            return
        first = self._history.minute_before()
        self._left = deque(self._events)
        self._history.fault = first, last_s + AFTER_S
        self._open(first, last_s + AFTER_S)

    def _open(self, first: int, end_s: float) -> None:
        self._next, self._latest_end_s = max(first, self._history.oldest), end_s - AFTER_S + _LONGEST_AFTER_S
        path = _free_path(self._path)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._writer = begin_file(path, self._job, about={IS_OF_FAULT: True}, on_flush=self._make_room)
            self._file_changes = FileChanges(self._journal, self._job.columns)
        except (OSError, RecordingError) as error:
            self._give_up(error, path)

    def _make_room(self) -> None:
        if self._writer is not None and self._budget is not None:
            self._budget.keep(self._writer.path, self._writer.size)

    def _end(self) -> None:
        assert self._writer is not None
        self._file_changes.write(self._writer, self._left, np.inf)
        self._writer.close()
        say(black_box=str(self._writer.path))
        self._writer, self._history.fault = None, None

    def _give_up(self, error: OSError | RecordingError, path: Path | None = None) -> None:
        reason = error.strerror if isinstance(error, OSError) else str(error)
        if self._writer is not None:
            path = self._writer.path
            self._writer.abandon()
        warn(f"the minute before the fault cannot be written to {path}: {reason}")
        self._writer, self._history.fault = None, None


def _free_path(path: Path) -> Path:
    """Return the file of a fault that happens now: ``run-fault-20260131-142530.mcap``, with a number if it exists."""
    now = datetime.fromtimestamp(time.time()).astimezone()
    wanted = path.with_stem(f"{path.stem}-fault-{now:%Y%m%d-%H%M%S}")
    number, free = 1, wanted
    while os.path.lexists(free):
        number += 1
        free = wanted.with_stem(f"{wanted.stem}-{number}")
    return free
