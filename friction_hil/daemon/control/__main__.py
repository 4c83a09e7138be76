"""Process of the control socket. It imports nothing heavy before somebody asks for something that needs it."""

import os
import sys
import threading
from typing import Any

from friction_hil.daemon.control.journal import entries
from friction_hil.daemon.control.server import serve
from friction_hil.daemon.shared_document import read_document
from friction_hil.daemon.supervisor import Heir

_INPUT = 0


class _LazyDesk:
    """The desk, made at the first request: numpy and what reads the rows are imported then."""

    def __init__(self, ring: int, journal: int, job: int, learning: int | None) -> None:
        self._descriptors = ring, journal, learning
        self._job = job
        self._desk: Any = None
        self._lock = threading.Lock()

    def made(self) -> Any:
        """Return the desk."""
        with self._lock:
            if self._desk is None:
                from friction_hil.daemon.control.desk import Desk
                from friction_hil.daemon.control.job import ControlJob

                self._desk = Desk(ControlJob(**read_document(self._job)), *self._descriptors)
            return self._desk

    def begin(self) -> None:
        """Take back what the process before this one, which died, knew to be on trial: nobody watches over it."""
        if entries(self._descriptors[1]):
            self.made().take_back("the process of the control socket died")


def main(descriptor: int, ring: int, journal: int, job: int, learning: int, plan: int) -> None:
    """Serve the socket until the daemon ends; ``learning`` is -1 without a process that learns."""
    heir = Heir(plan)
    desk = _LazyDesk(ring, journal, job, learning if learning >= 0 else None)
    threading.Thread(target=desk.begin, daemon=True).start()
    serve(descriptor, lambda: desk.made().answer, _INPUT, heir.look)
    os._exit(0)  # threads may wait for clients that never hang up


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
