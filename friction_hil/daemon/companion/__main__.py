"""Supervisor: forks the worker, and another one when it dies; ends when a worker has finished.

It imports nothing heavy, so each fork starts clean.
"""

import mmap
import os
import signal
import sys
import traceback

from friction_hil.daemon.companion.job import (
    CANNOT_OPEN,
    MOST_SHORT_LIVES,
    Job,
    Lives,
    die_with_parent,
    signal_text,
    warn,
)
from friction_hil.daemon.companion.memory import allocate
from friction_hil.daemon.shared_document import read_document


def main(ring_descriptor: int, job_descriptor: int, journal_descriptor: int, number: int, death: str) -> int:
    """Serve the job; return the exit status.

    The descriptors are those of shared memory: of the rows, of the job, and of the changes of the run (-1: none).
    ``number``: of the first worker, 1 at the start of a run. ``death``: how the companion before this one has died;
    empty for the first one.
    """
    for ignored in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(ignored, signal.SIG_IGN)
    if hasattr(os, "sched_setscheduler"):
        # the loop's real-time priority is not meant for writing files
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    if death:
        warn(f"the companion process died ({death}); the next one takes over")
    job, lives = Job(**read_document(job_descriptor)), Lives()
    memory = None if job.black_box is None else allocate(job)
    while True:
        lives.begin()
        _, status = os.waitpid(_fork_worker(job, ring_descriptor, journal_descriptor, number, memory), 0)
        code = os.waitstatus_to_exitcode(status)
        if code == 0:
            return 0
        if code == CANNOT_OPEN and number == 1:
            return 1
        how = signal_text(-code) if code < 0 else f"exit status {code}"
        warn(f"worker {number} of the companion died ({how}); the next one takes over")
        if lives.end():
            warn(f"{MOST_SHORT_LIVES} workers of the companion died at once: nothing more is recorded")
            return 1
        number += 1


def _fork_worker(job: Job, ring_descriptor: int, journal_descriptor: int, number: int, memory: mmap.mmap | None) -> int:
    parent, pid = os.getpid(), os.fork()
    if pid:
        return pid
    status = 1
    try:
        die_with_parent(is_wanted=True)
        if os.getppid() != parent:  # it died before that
            os._exit(status)
        # imported here: only the worker needs numpy
        from friction_hil.daemon.companion.changes import Changes
        from friction_hil.daemon.companion.worker import work

        status = work(job, ring_descriptor, number, memory, Changes(journal_descriptor))
    except MemoryError:
        warn(f"worker {number} of the companion has no memory left")
    except BaseException:  # noqa: BLE001 - a fork must not return into the code of its parent
        traceback.print_exc()
    finally:
        sys.stderr.flush()
        os._exit(status)


if __name__ == "__main__":
    _ring, _job, _journal, _number = map(int, sys.argv[1:5])
    sys.exit(main(_ring, _job, _journal, _number, sys.argv[5]))
