"""Time for the loop: clocks, and what the operating system has to be asked for punctuality."""

import contextlib
import ctypes
import gc
import os
import struct
import time
from collections.abc import Iterator

_MCL_CURRENT, _MCL_FUTURE = 1, 2


class RealClock:
    """Monotonic time; sleeps to absolute deadlines and spins through the last ``spin_us`` microseconds."""

    is_real = True

    def __init__(self, spin_us: int = 200) -> None:
        self._spin_ns = spin_us * 1000

    def now_ns(self) -> int:
        """Monotonic time, ns."""
        return time.monotonic_ns()

    def doze_until(self, deadline_ns: int) -> bool:
        """Sleep until the spin before ``deadline_ns``; whether it has not begun yet."""
        left = deadline_ns - self._spin_ns - time.monotonic_ns()
        if left > 0:
            time.sleep(left * 1e-9)
        return left > 0 and self._spin_ns > 0

    def sleep_until(self, deadline_ns: int) -> None:
        """Return at ``deadline_ns``, at once when it has passed."""
        self.doze_until(deadline_ns)
        while time.monotonic_ns() < deadline_ns:
            pass


class SteppedClock:
    """Simulated time, which passes only while the loop sleeps: everything happens in no time at all."""

    is_real = False

    def __init__(self) -> None:
        self._now_ns = 0

    def now_ns(self) -> int:
        """Simulated time, ns."""
        return self._now_ns

    def doze_until(self, deadline_ns: int) -> bool:
        """Do nothing: there is no time in which to get ready."""
        return False

    def sleep_until(self, deadline_ns: int) -> None:
        """Go on to ``deadline_ns``."""
        self._now_ns = max(self._now_ns, deadline_ns)


@contextlib.contextmanager
def punctuality(priority: int) -> Iterator[list[str]]:
    """Ask for everything that makes a process wake up on time, and give it back afterwards.

    SCHED_FIFO, locked memory, no garbage collection, no deep sleep of the processor.

    Parameters
    ----------
    priority : int
        SCHED_FIFO priority 1 to 99; 0 asks for nothing at all.

    Yields
    ------
    list of str
        What was not granted, in words, with what would help.
    """
    refused: list[str] = []
    if priority == 0:
        yield refused
        return
    with contextlib.ExitStack() as stack:
        _lock_memory(refused, stack)
        try:
            before = os.sched_getscheduler(0), os.sched_getparam(0)
            os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(priority))
            stack.callback(os.sched_setscheduler, 0, *before)
        except OSError as error:
            refused.append(
                f"no SCHED_FIFO priority {priority} ({error.strerror}): the loop runs at ordinary priority; "
                "run as root, or give the user rtprio in /etc/security/limits.conf"
            )
        try:
            # held open, it keeps the processor out of states that take long to wake from
            latency = os.open("/dev/cpu_dma_latency", os.O_WRONLY)
            stack.callback(os.close, latency)
            os.write(latency, struct.pack("i", 0))
        except OSError as error:
            refused.append(f"/dev/cpu_dma_latency cannot be held ({error.strerror}): wake-ups may take longer")
        gc.collect()
        gc.freeze()
        if gc.isenabled():
            gc.disable()
            stack.callback(gc.enable)
        stack.callback(gc.unfreeze)
        yield refused


def _lock_memory(refused: list[str], stack: contextlib.ExitStack) -> None:
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.mlockall(_MCL_CURRENT | _MCL_FUTURE) != 0:
        reason = os.strerror(ctypes.get_errno())
        refused.append(f"memory is not locked ({reason}): raise memlock in /etc/security/limits.conf")
    else:
        stack.callback(libc.munlockall)
