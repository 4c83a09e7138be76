"""The recording of a loop while it runs: the daemon's ring and the process that empties it into a file."""

import math
import os
import sys
import time
import weakref
from collections import deque
from pathlib import Path
from typing import Any, cast

import numpy as np

from friction_hil.config.recording import RecordingConfig
from friction_hil.daemon.companion import Companion, Job
from friction_hil.daemon.companion.client import ring_of
from friction_hil.daemon.control import journal
from friction_hil.errors import UsageError
from friction_hil.numerics.jit import Array
from friction_hil.own_loop.joints import Joints
from friction_hil.own_loop.memory import COLUMNS, STATE_S, WIDTH, metadata
from friction_hil.recordings import columns
from friction_hil.recordings.recording import CHANGE

_FORKED = "recording: nothing of this process, which was forked: load the compensator in the process of the loop"


class Recorder:
    """What `Memory` is, for a file; `push` and `tend` belong to the thread of the loop, and never wait.

    Raises `UsageError`: the system has no such memory, or the name is none of an MCAP file; `RecordingError`: the file
    exists or cannot be written.
    """

    def __init__(self, joints: Joints, path: Path) -> None:
        if not hasattr(os, "memfd_create"):
            raise UsageError("record= needs Linux: keep the recording in memory, and save it where the loop rests")
        configuration, n = joints.configuration, len(joints.names)
        settings, every = configuration.recording or RecordingConfig(), max(round(STATE_S / configuration.period_s), 1)
        job = Job(
            axes=list(joints.names),
            columns=list(columns.NAMES),
            state_width=WIDTH,
            period_s=configuration.period_s,
            started_unix_ns=time.time_ns(),
            path=str(path),
            metadata=metadata(joints),
            rotate_s=settings.rotate_s,
            rotate_bytes=settings.rotate_bytes,
            has_joint_states=settings.ros,
            ring_columns=list(COLUMNS),
            rows_between_states=every,
        )
        self._path, self._joints, ring = path, joints, ring_of(job)
        joints.loop["rows_between_states"] = every
        self._row = np.full(n * len(COLUMNS), math.nan)
        self._cells = cast("memoryview[float]", self._row.data)
        self._cells[0] = self._cycle = -1.0  # of the last row that was pushed; the first cell is the cycle
        self.rows: Array = self._row.reshape(1, n, -1)
        self.states: Array = ring.tail.reshape(-1, n, WIDTH)
        self._events: deque[tuple[float, str, str]] = deque(maxlen=1000)
        self._journal = journal.make_journal()
        self._companion = Companion.start(job, self._journal, ring=ring, adopts=False)
        self._is_closed, self._owner = False, os.getpid()
        here = weakref.ref(self._companion)

        def leave() -> None:  # a forked process must not keep alive what ends with this one
            if (companion := here()) is not None:
                companion.leave()

        if sys.platform != "win32":  # as the rest, which Linux alone has: for the type checker
            os.register_at_fork(after_in_child=leave)

    @property
    def _is_over(self) -> bool:
        """True when it is closed, and in a forked process, whose rows would take the place of the loop's own."""
        return self._is_closed or os.getpid() != self._owner

    def begin(self) -> None:
        """Do nothing: the file has begun."""

    def push(self) -> None:
        """Hand on the row of this cycle, if there is one."""
        if (cycle := self._cells[0]) != self._cycle and not self._is_over:
            self._cycle = cycle
            self._companion.push(self._row)

    def note(self, name: str, text: str) -> None:
        """Keep an event of the present cycle until `tend` hands it on."""
        self._events.append((self._joints.loop["cycle"].item(), name, text))

    def note_change(self, entry: dict[str, Any]) -> None:
        """Keep the settings after a change as long as rows that were computed with them may have to be written."""
        if self._is_over:  # the descriptor of the journal may be another file's by now
            return
        now_s = self._joints.loop["cycle"].item() * self._joints.configuration.period_s
        known, before = journal.entries(self._journal), entry["number"] - 1
        kept = journal.needed(known, before, now_s)
        if len(kept) < len(known):
            journal.keep(self._journal, kept)
        journal.append(self._journal, {**entry, "before": before, "time_s": now_s})
        self.note(CHANGE, str(entry["number"]))

    def tend(self) -> list[str]:
        """Hand on events; return what the process that records has to say."""
        if self._is_over:
            return [] if self._is_closed else [_FORKED]
        while self._events:
            self._companion.push_event(*self._events.popleft())
        return [text for _, text in self._companion.tend()]

    def save(self, path: Path, *, overwrite: bool) -> tuple[int, int]:
        """Refuse: the file is there."""
        raise UsageError(f"the recording is written to {self._path} while the loop runs: close() ends it")

    def close(self) -> list[str]:
        """End the recording; return what is wrong with it. The loop may go on."""
        if self._is_over:
            return []
        self.tend()
        self._is_closed = True
        report = self._companion.close()
        os.close(self._journal)
        lost = [f"{report.lost} cycles were lost"] if report.lost else []
        return [f"recording: {text}" for text in (*report.problems, *lost)]
