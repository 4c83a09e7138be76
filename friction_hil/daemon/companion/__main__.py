"""The process that records; `friction_hil.daemon.supervisor` starts it. It imports nothing heavy before it has to."""

import sys

from friction_hil.daemon.companion.job import Job, warn
from friction_hil.daemon.shared_document import read_document
from friction_hil.daemon.supervisor import Heir


def main(ring: int, job: int, journal: int, memory: int, plan: int) -> int:
    """Serve the ring; return the exit status.

    All are descriptors of shared memory; ``journal`` and ``memory``, that of the last minute, are -1 for none.
    """
    heir = Heir(plan)
    try:
        # imported here: the lock of this process must not wait for numpy
        from friction_hil.daemon.companion.worker import work

        return work(Job(**read_document(job)), ring, memory, journal, heir)
    except MemoryError:
        warn("the companion process has no memory left")
        return 1


if __name__ == "__main__":
    sys.exit(main(*map(int, sys.argv[1:])))
