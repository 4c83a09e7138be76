"""Lives of the processes beside the loop, in shared memory that all of them have.

Each process holds a byte of the memory locked while it lives, so that it runs once, whoever started it; the kernel
gives the lock back whatever ends the process. The memory counts starts and early deaths: whoever starts the processes
next goes on from there.
"""

import contextlib
import os
import struct
import time

MOST_SHORT_LIVES = 3
_SHORT_LIFE_S = 5.0
_ENTRY = struct.Struct("<qqqq")  # starts, short lives in a row, time of the last start in ns, 1 once it is over
_FLOCK = struct.Struct("hhqqi4x")  # `struct flock`


def make_lives(count: int) -> int:
    """Return the descriptor of a memory for the lives of so many processes."""
    descriptor = os.memfd_create("friction_hil-lives")
    os.ftruncate(descriptor, count * _ENTRY.size)
    return descriptor


class Lives:
    """The memory, which a process must not close: its lock would be gone. ``place``: of a process, from 0."""

    def __init__(self, descriptor: int) -> None:
        self.descriptor = descriptor

    def take(self, place: int) -> bool:
        """Lock the byte of a process for the one that calls; return False if another one has it."""
        import fcntl  # imported here: Windows lacks it, and what reads this module there starts no process

        with contextlib.suppress(BlockingIOError, PermissionError):
            fcntl.lockf(self.descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB, 1, place)
            return True
        return False

    def holder(self, place: int) -> int:
        """Return the number of the process that lives; 0 for none."""
        import fcntl  # as above

        asked = _FLOCK.pack(fcntl.F_WRLCK, os.SEEK_SET, place, 1, 0)
        kind, _, _, _, pid = _FLOCK.unpack(fcntl.fcntl(self.descriptor, fcntl.F_GETLK, asked))
        return 0 if kind == fcntl.F_UNLCK else int(pid)

    def starts(self, place: int) -> int:
        """Return how often a process was started."""
        return self._entry(place)[0]

    def is_over(self, place: int) -> bool:
        """Return True if a process is not to be started any more."""
        return bool(self._entry(place)[3])

    def begin(self, place: int) -> None:
        """Note a start."""
        starts, short, _, is_over = self._entry(place)
        self._write(place, starts + 1, short, time.monotonic_ns(), is_over)

    def die(self, place: int) -> bool:
        """Note a death; return True if it was one short life too many."""
        starts, short, born_ns, is_over = self._entry(place)
        short = short + 1 if time.monotonic_ns() - born_ns < _SHORT_LIFE_S * 1e9 else 0
        self._write(place, starts, short, born_ns, is_over)
        return short >= MOST_SHORT_LIVES

    def finish(self, place: int) -> None:
        """Note that a process has done its work, or has died too often."""
        self._write(place, *self._entry(place)[:3], 1)

    def _entry(self, place: int) -> tuple[int, int, int, int]:
        starts, short, born_ns, is_over = _ENTRY.unpack(os.pread(self.descriptor, _ENTRY.size, place * _ENTRY.size))
        return starts, short, born_ns, is_over

    def _write(self, place: int, *entry: int) -> None:
        os.pwrite(self.descriptor, _ENTRY.pack(*entry), place * _ENTRY.size)
