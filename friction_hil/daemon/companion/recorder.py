"""Recorder of a worker: rows and events of the ring to the files of a recording."""

import math
import os
import time
from collections import deque
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from friction_hil.daemon.companion.black_box import ABANDONED
from friction_hil.daemon.companion.budget import Budget
from friction_hil.daemon.companion.changes import FileChanges
from friction_hil.daemon.companion.job import Job, say, warn
from friction_hil.daemon.companion.new_file import begin_file
from friction_hil.daemon.companion.paths import part_number, part_path
from friction_hil.daemon.ring import RingReader
from friction_hil.errors import RecordingError
from friction_hil.recordings.columns import CYCLE, TIME
from friction_hil.recordings.mcap_format import PART
from friction_hil.recordings.mcap_writer import CHUNK_S, McapWriter
from friction_hil.recordings.recording import Array

_RETRY_S = 5.0  # after an error of the disk
_COMING = 2  # chunks: the open one, and that of the next rows
_ROOM_BYTES = 32 << 20  # that must be free to go on: a few chunks


class Recorder:
    """Write rows and events of the ring to the recording, and release in the ring what is safe on disk.

    If a worker is killed between the two, its successor writes that chunk once more: better twice than not at all.

    A file ends after ``rotate_s`` of rows, or before a chunk with which it would exceed ``rotate_bytes``, and the
    recording goes on in the next one. Time is that of the rows, which no change of the system's clock affects. If the
    disk is full or gone, rows are lost, and counted, until a further file can be written.

    ``job`` has a path. ``clock``: monotonic time, s.
    """

    def __init__(self, job: Job, ring: RingReader, journal: int, clock: Callable[[], float] = time.monotonic) -> None:
        assert job.path is not None
        self._job, self._ring, self._journal, self._clock = job, ring, journal, clock
        self._first = Path(job.path)
        self._file_changes = FileChanges(journal, job.columns)
        self._number = 0
        self._writer: McapWriter | None = None
        self.budget = None if job.budget_bytes is None else Budget(self._first, job.budget_bytes, job.series)
        self._time = job.columns.index(TIME)
        self._cycle_column = job.columns.index(CYCLE) if CYCLE in job.columns else None
        self._rows_per_s = max(1, round(1.0 / job.period_s))
        self._rows = self._events = 0  # of this file, released in the ring
        self._added = 0  # events in this file that are not from the ring
        self._cycle = 0.0
        self._file_start_s: float | None = None
        self._chunk_bytes = 0  # of the largest chunk so far
        self._size = 0  # of the file when its last chunk was complete
        self._open_since_s: float | None = None
        self._retry_s = 0.0
        self._is_idle_flushed = job.started_unix_ns != 0  # in simulated time, chunks must not depend on the clock

    def open(self, number: int) -> Path:
        """Open the file of part ``number``, or of the next higher one that is free; return its path.

        Raises `OSError` or `RecordingError`: it cannot be written.
        """
        path = part_path(self._first, number)
        self._number = number = part_number(path, self._first) or number
        self._rows = self._events = self._added = 0
        self._writer = None
        self._file_start_s = self._open_since_s = None
        self._writer = begin_file(
            path,
            self._job,
            about={PART: number},
            overwrite=self._job.overwrite and number == 1,
            on_flush=self._release,
        )
        self._file_changes = FileChanges(self._journal, self._job.columns)
        self._size = self._writer.size
        if self.budget is not None:
            self.budget.look()
            self.budget.keep(path, self._size)
        return path

    def take(
        self, rows: Array, events: list[tuple[float, str, str]], has_state: NDArray[np.bool_] | None = None
    ) -> None:
        """Write rows and events that were drained from the ring.

        ``has_state``, (n,): rows whose state is known; without it all are.
        """
        if self._writer is None and not self._resume():
            self._ring.discard()
            return
        assert self._writer is not None
        if len(rows) and self._cycle_column is not None:
            self._cycle = float(rows[-1, self._cycle_column])
        left = deque(events)
        try:
            while len(rows):
                count = self._room(rows)
                if count == 0:
                    self._rotate()
                    continue
                for event in self._file_changes.ahead_of(rows[:count], left):
                    self._added += 1
                    self._writer.write_event(*event)
                self._writer.write(rows[:count], None if has_state is None else has_state[:count])
                if self._cycle_column is not None:  # a change belongs into the file of its first rows
                    self._file_changes.write(self._writer, left, float(rows[count - 1, self._cycle_column]))
                rows, has_state = rows[count:], None if has_state is None else has_state[count:]
            self._file_changes.write(self._writer, left, math.inf)
            self._flush_idle_chunk()
        except (OSError, RecordingError) as error:
            self._suspend(error)

    def close(self, *, was_abandoned: bool) -> None:
        """End the recording."""
        if self._writer is None:
            return
        try:
            if was_abandoned:
                self._writer.write_event(self._cycle, *ABANDONED)
                self._added += 1
            self._writer.close()
        except OSError as error:
            self._suspend(error)

    def _room(self, rows: Array) -> int:
        """Return how many of the rows belong into this file; at most those of a second, to look at its size again."""
        assert self._writer is not None
        times = rows[: self._rows_per_s, self._time]
        if self._file_start_s is None:
            self._file_start_s = float(times[0])
        elif self._job.rotate_bytes is not None and self._size + _COMING * self._chunk_bytes > self._job.rotate_bytes:
            return 0
        if self._job.rotate_s is None:
            return len(times)
        return int(np.searchsorted(times, self._file_start_s + self._job.rotate_s))

    def _rotate(self) -> None:
        """Complete this file and go on in the next one."""
        assert self._writer is not None
        self._writer.close()
        say(opened=str(self.open(self._number + 1)))

    def _flush_idle_chunk(self) -> None:
        """Flush a chunk that no row has come to complete: what it holds must not wait for the next row."""
        assert self._writer is not None
        if not self._writer.has_open_chunk:
            self._open_since_s = None
        elif self._open_since_s is None:
            self._open_since_s = self._clock()
        elif self._is_idle_flushed and self._clock() - self._open_since_s > 1.5 * CHUNK_S:
            self._writer.flush()

    def _release(self) -> None:
        if self._writer is None:  # it is being created
            return
        events = max(self._writer.events_kept - self._added, self._events)
        self._ring.release(self._writer.rows_kept - self._rows, events - self._events)
        self._rows, self._events = self._writer.rows_kept, events
        self._chunk_bytes = max(self._chunk_bytes, self._writer.size - self._size)
        self._size = self._writer.size
        self._open_since_s = None
        if self.budget is not None:
            self.budget.keep(self._writer.path, self._size)

    def _suspend(self, error: OSError | RecordingError) -> None:
        """Report that the disk is full or gone; the run goes on, and so does the recording once it can."""
        reason = error.strerror if isinstance(error, OSError) else str(error)
        warn(f"the recording stops: {reason}; it goes on in another file as soon as the disk takes one")
        self._ring.discard()
        if self._writer is not None:
            self._writer.abandon()
            self._writer = None
        self._retry_s = self._clock() + _RETRY_S

    def _resume(self) -> bool:
        """Go on in a further file if that is possible; return True if it is."""
        if self._clock() < self._retry_s:
            return False
        self._retry_s = self._clock() + _RETRY_S
        try:
            if _free_bytes(self._first.parent) < _ROOM_BYTES:
                return False
            path = self.open(self._number + 1)
        except (OSError, RecordingError):
            return False  # as before; it was reported
        warn(f"the recording goes on in {path}")
        say(opened=str(path))
        return True


def _free_bytes(folder: Path) -> int:
    found = os.statvfs(folder)
    return found.f_bavail * found.f_frsize
