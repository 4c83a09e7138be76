"""Worker: drains the ring, writes the recording, prints the status line."""

import json
import os
import select
import time
from pathlib import Path

from friction_hil.daemon.companion.job import CANNOT_OPEN, Job, die_with_parent, say, segment_path, warn
from friction_hil.daemon.companion.status import StatusLine
from friction_hil.daemon.control import journal
from friction_hil.daemon.ring import RingReader
from friction_hil.errors import RecordingError
from friction_hil.recordings.columns import CYCLE
from friction_hil.recordings.mcap_writer import McapWriter
from friction_hil.recordings.recording import Array

_INPUT = 0
_PAUSE_MS = 20
_STANDSTILL_S = 2.0  # between two looks at the ring


def work(job: Job, ring_descriptor: int, number: int, journal_descriptor: int = -1) -> int:
    """Serve the ring until it is closed and drained, or the control process is gone.

    Parameters
    ----------
    job : Job
    ring_descriptor : int
        File descriptor of the ring's memory.
    number : int
        1 for the first worker of a run; a later one writes the next segment of the recording.
    journal_descriptor : int
        Memory of the changes of the run; -1 for none.

    Returns
    -------
    int
        Exit status: 0, or ``CANNOT_OPEN`` after the reason was reported to the control process.
    """
    ring = RingReader(ring_descriptor)
    recorder = _Recorder(job, ring, journal_descriptor)
    path = None
    if job.path is not None:
        path = segment_path(Path(job.path), number)
        try:
            recorder.open(path, overwrite=job.overwrite and number == 1)
        except (OSError, RecordingError) as error:
            reason = f"{path} cannot be written: {error.strerror if isinstance(error, OSError) else error}"
            if number == 1:
                say(failed=reason)
                return CANNOT_OPEN
            warn(reason)
            path = None
    parent = os.getppid()  # read while its death would end this process too: so it is the supervisor
    die_with_parent(is_wanted=False)  # only while the file is being opened, which may take forever
    say(opened=path and str(path), pid=os.getpid())
    status = StatusLine(job) if job.status_line else None
    control = select.poll()
    control.register(_INPUT, 0)  # no event but the hang-up, which is always reported
    looked_s = time.monotonic()
    while True:
        if os.getppid() != parent:
            parent = os.getppid()
            warn("the supervisor of the companion died; its worker goes on")
        stood_s, looked_s = time.monotonic() - looked_s, time.monotonic()
        if stood_s > _STANDSTILL_S:
            warn(f"the companion stood still for {stood_s:.1f} s (stopped, or held up by the disk); it goes on")
        is_gone = bool(control.poll(0))
        is_last = is_gone or ring.is_closed
        rows = ring.drain()
        recorder.take(rows, ring.drain_events())
        if status:
            status.show(rows, ring.lost)
        if is_last and ring.is_drained:
            break
        if not len(rows):
            control.poll(_PAUSE_MS)
    recorder.close(was_abandoned=is_gone and not ring.is_closed)
    if status:
        status.close(ring.lost)
    return 0


class _Recorder:
    """Write rows and events of the ring to the recording, and release in the ring what is safe on disk.

    If a worker is killed between the two, its successor writes that chunk once more: better twice than not at all.
    """

    def __init__(self, job: Job, ring: RingReader, journal_descriptor: int) -> None:
        self._job = job
        self._ring = ring
        self._journal_descriptor = journal_descriptor
        self._added = 0  # events in the file that are not from the ring
        self._writer: McapWriter | None = None
        self._cycle_column = job.columns.index(CYCLE) if CYCLE in job.columns else None
        self._rows = self._events = 0  # released in the ring
        self._cycle = 0.0

    def open(self, path: Path, *, overwrite: bool) -> None:
        self._writer = McapWriter(
            path,
            self._job.axes,
            self._job.columns,
            state_width=self._job.state_width,
            started_unix_ns=self._job.started_unix_ns,
            metadata=self._job.metadata,
            overwrite=overwrite,
            on_flush=self._release,
        )
        self._write_earlier_changes()

    def _write_earlier_changes(self) -> None:
        """Write the changes before this file began: what its rows were computed with is in the file itself."""
        assert self._writer is not None
        for entry in [] if self._journal_descriptor < 0 else journal.entries(self._journal_descriptor):
            self._writer.write_event(0.0, "change", json.dumps(entry))
            self._added += 1

    def _whole(self, cycle: float, name: str, text: str) -> tuple[float, str, str]:
        """Return an event as it is recorded: a change with its settings and models, which the ring has no room for."""
        if name == "change" and self._journal_descriptor >= 0:
            for entry in journal.entries(self._journal_descriptor):
                if str(entry["number"]) == text:
                    return cycle, name, json.dumps(entry)
        return cycle, name, text

    def take(self, rows: Array, events: list[tuple[float, str, str]]) -> None:
        if self._job.path is None:
            self._ring.release(len(rows), len(events))
            return
        if self._writer is None:
            self._ring.discard()
            return
        if len(rows) and self._cycle_column is not None:
            self._cycle = float(rows[-1, self._cycle_column])
        try:
            self._writer.write(rows)
            for event in events:
                self._writer.write_event(*self._whole(*event))
        except OSError as error:
            self._give_up(error)

    def close(self, *, was_abandoned: bool) -> None:
        if self._writer is None:
            return
        try:
            if was_abandoned:
                self._writer.write_event(self._cycle, "abandoned", "the control process ended without closing the run")
                self._added += 1
            self._writer.close()
        except OSError as error:
            self._give_up(error)

    def _release(self) -> None:
        if self._writer is None:  # it is being created
            return
        events = max(self._writer.events_kept - self._added, self._events)
        self._ring.release(self._writer.rows_kept - self._rows, events - self._events)
        self._rows, self._events = self._writer.rows_kept, events

    def _give_up(self, error: OSError) -> None:
        """Report that the disk is full or gone; the run goes on without a recording."""
        warn(f"the recording ended early: {error.strerror}")
        self._ring.discard()
        self._writer = None
