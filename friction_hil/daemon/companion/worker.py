"""Work of the companion: drains the ring, writes the recording and the files of faults, prints the status line."""

import mmap
import os
import select
import time

from friction_hil.daemon.companion.black_box import BlackBox
from friction_hil.daemon.companion.history import History
from friction_hil.daemon.companion.job import Job, say, warn
from friction_hil.daemon.companion.memory import allocate
from friction_hil.daemon.companion.own_rows import OwnRingReader
from friction_hil.daemon.companion.recorder import Recorder
from friction_hil.daemon.companion.status import StatusLine
from friction_hil.daemon.companion.uncertainty import UncertaintyColumn
from friction_hil.daemon.ring import RingReader
from friction_hil.daemon.supervisor import COMPANION, Heir
from friction_hil.errors import RecordingError
from friction_hil.recordings.recording import Array

_INPUT = 0
_PAUSE_MS = 20
_STANDSTILL_S = 2.0  # between two looks at the ring


def work(job: Job, ring_descriptor: int, memory: int, journal: int, heir: Heir) -> int:
    """Serve the ring until it is closed and drained, or the control process is gone; return the exit status.

    The first companion of a run reports that its file cannot be opened; a later one writes the next file of the
    recording. ``memory``: of the last minute, which all companions of a run share; -1 if faults get no files.
    """
    number = heir.lives.starts(COMPANION)
    ring = OwnRingReader(ring_descriptor, job) if job.ring_columns else RingReader(ring_descriptor)
    outputs = _Outputs(job, ring, None if memory < 0 else allocate(job, memory), journal)
    path = None
    if outputs.recorder is not None:
        try:
            path = outputs.recorder.open(number)
        except (OSError, RecordingError) as error:
            reason = error.strerror if isinstance(error, OSError) else str(error)
            if number == 1:
                heir.lives.finish(COMPANION)
                say(failed=f"{job.path} cannot be written: {reason}")
                return 1
            warn(f"the recording cannot go on: {reason}; it is tried again")
    say(opened=path and str(path), pid=os.getpid())
    status = StatusLine(job) if job.status_line else None
    control = select.poll()
    control.register(_INPUT, 0)  # no event but the hang-up, which is always reported
    looked_s = time.monotonic()
    while True:
        stood_s, looked_s = time.monotonic() - looked_s, time.monotonic()
        if stood_s > _STANDSTILL_S:
            warn(f"the companion stood still for {stood_s:.1f} s (stopped, or held up by the disk); it goes on")
        is_gone = bool(control.poll(0))
        is_last = is_gone or ring.is_closed
        if not is_last:
            heir.look()
        rows = ring.drain()
        outputs.take(rows, ring.drain_events())
        if status:
            status.show(rows, ring.lost)
        if is_last and ring.is_drained:
            break
        if not len(rows):
            control.poll(_PAUSE_MS)
    outputs.close(was_abandoned=is_gone and not ring.is_closed)
    heir.lives.finish(COMPANION)
    if status:
        status.close(ring.lost)
    say(done=True)
    return 0


class _Outputs:
    """The recording, if there is one, and the files of faults."""

    def __init__(self, job: Job, ring: RingReader, memory: mmap.mmap | None, journal: int) -> None:
        self._ring = ring
        self._uncertainty = UncertaintyColumn(job, journal)
        self.recorder = None if job.path is None else Recorder(job, ring, journal)
        self._history = None if memory is None else History(job, memory)
        budget = None if self.recorder is None else self.recorder.budget
        self._black_box = None if self._history is None else BlackBox(job, self._history, journal, budget)

    def take(self, rows: Array, events: list[tuple[float, str, str]]) -> None:
        has_state = None
        if isinstance(self._ring, OwnRingReader):
            rows, has_state = self._ring.in_full(rows)
        self._uncertainty.fill(rows)
        if self._history is not None and self._black_box is not None:
            self._history.append(rows)
            self._black_box.take(events)
            self._black_box.advance()
        if self.recorder is None:
            self._ring.release(len(rows), len(events))
        else:
            self.recorder.take(rows, events, has_state)

    def close(self, *, was_abandoned: bool) -> None:
        if self.recorder is not None:
            self.recorder.close(was_abandoned=was_abandoned)
        if self._black_box is not None:
            self._black_box.finish(was_abandoned=was_abandoned)
