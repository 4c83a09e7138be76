"""Supervisor: forks the worker, and another one when it dies; ends when a worker has finished.

It imports nothing heavy, so each fork starts clean.
"""

import os
import signal
import sys
import time
import traceback

from friction_hil.daemon.companion.job import CANNOT_OPEN, Job, receive, warn

_SHORT_LIFE_S = 5.0
_SHORT_LIVES = 3


def main() -> int:
    """Serve one job from standard input; return the exit status."""
    for ignored in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(ignored, signal.SIG_IGN)
    if hasattr(os, "sched_setscheduler"):
        # the loop's real-time priority is not meant for writing files
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    try:
        job, ring_descriptor = receive()
    except EOFError:
        return 1
    number, short_lives = 0, 0
    while short_lives < _SHORT_LIVES:
        number += 1
        born = time.monotonic()
        _, status = os.waitpid(_fork_worker(job, ring_descriptor, number), 0)
        code = os.waitstatus_to_exitcode(status)
        if code == 0:
            return 0
        if code == CANNOT_OPEN and number == 1:
            return 1
        how = f"signal {signal.Signals(-code).name}" if code < 0 else f"exit status {code}"
        warn(f"worker {number} of the companion died ({how}); the next one takes over")
        short_lives = short_lives + 1 if time.monotonic() - born < _SHORT_LIFE_S else 0
    warn(f"{_SHORT_LIVES} workers of the companion died at once: nothing more is recorded")
    return 1


def _fork_worker(job: Job, ring_descriptor: int, number: int) -> int:
    pid = os.fork()
    if pid:
        return pid
    status = 1
    try:
        # imported here: only the worker needs numpy
        from friction_hil.daemon.companion.worker import work

        status = work(job, ring_descriptor, number)
    except BaseException:  # noqa: BLE001 - a fork must not return into the code of its parent
        traceback.print_exc()
    finally:
        sys.stderr.flush()
        os._exit(status)


if __name__ == "__main__":
    sys.exit(main())
