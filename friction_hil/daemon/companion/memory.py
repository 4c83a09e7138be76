"""Memory for the rows of the last minute; it outlives each companion of a run."""

import math
import mmap
import os

from friction_hil.daemon.companion.job import Job

BEFORE_S = 60.0  # of rows before a fault
KEPT = 4 / 3  # times as many rows are kept: writing them may take a while
STATES = 512  # rows with states: one a second, and those after gaps
HEADER_BYTES = 4096
_MOST_BYTES = 256 << 20


def rows_kept(job: Job) -> int:
    """Return the number of rows that are kept; fewer than those of `BEFORE_S` where they would take too much memory."""
    most = _MOST_BYTES // (8 * len(job.axes) * len(job.columns))
    return max(1, min(math.ceil(KEPT * BEFORE_S / job.period_s), most))


def size_bytes(job: Job) -> int:
    """Return the size of the memory."""
    states = STATES * (1 + len(job.axes) * job.state_width)
    return HEADER_BYTES + 8 * (rows_kept(job) * len(job.axes) * len(job.columns) + states)


def allocate(job: Job, descriptor: int) -> mmap.mmap:
    """Return the memory behind a descriptor, all of it present; what an earlier companion has kept there stays.

    Raises `OSError`: there is not enough.
    """
    os.posix_fallocate(descriptor, 0, size_bytes(job))
    return mmap.mmap(descriptor, size_bytes(job), flags=mmap.MAP_SHARED | mmap.MAP_POPULATE)
