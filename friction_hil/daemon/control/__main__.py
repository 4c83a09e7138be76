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

    def answer(self, line: bytes, user: int) -> dict[str, Any]:
        try:
            with self._lock:
                if self._desk is None:
                    self._desk = self._make()
            answer: dict[str, Any] = self._desk.answer(line, user)
        except Exception as error:  # noqa: BLE001 - an error of this process must not keep others from stopping axes
            return {"ok": False, "problems": [f"an error in friction-hil: {type(error).__name__}: {error}"]}
        return answer

    def begin(self) -> None:
        """Take back what the process before this one, which died, knew to be on trial: nobody watches over it."""
        if entries(self._descriptors[1]):
            with self._lock:
                self._desk = self._desk or self._make()
            self._desk.take_back("the process of the control socket died")

    def _make(self) -> Any:
        from friction_hil.daemon.control.desk import Desk
        from friction_hil.daemon.control.job import ControlJob

        return Desk(ControlJob(**read_document(self._job)), *self._descriptors)


def main(descriptor: int, ring: int, journal: int, job: int, learning: int, plan: int) -> None:
    """Serve the socket until the daemon ends; ``learning`` is -1 without a process that learns."""
    heir = Heir(plan)
    desk = _LazyDesk(ring, journal, job, learning if learning >= 0 else None)
    threading.Thread(target=desk.begin, daemon=True).start()
    serve(descriptor, desk.answer, _INPUT, heir.look)
    os._exit(0)  # threads may wait for clients that never hang up


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
