"""Clocks of the loop, and real-time scheduling of its process."""

import contextlib
import ctypes
import gc
import os
import re
import struct
import time
from collections.abc import Iterator
from pathlib import Path

from friction_hil.drive.finding import Finding, system_text

_MCL_CURRENT, _MCL_FUTURE = 1, 2
_CAP_IPC_LOCK = 14


class RealClock:
    """Monotonic time; sleeps to absolute deadlines and spins through the last ``spin_us`` microseconds."""

    is_real = True
    now_ns = staticmethod(time.monotonic_ns)

    def __init__(self, spin_us: int = 200) -> None:
        self.spin_ns = spin_us * 1000

    def doze_until(self, deadline_ns: int) -> bool:
        """Sleep until the spin before ``deadline_ns``; return True if the spin has not begun yet."""
        left = deadline_ns - self.spin_ns - time.monotonic_ns()
        if left > 0:
            time.sleep(left * 1e-9)
        return left > 0 and self.spin_ns > 0

    def sleep_until(self, deadline_ns: int) -> None:
        """Return at ``deadline_ns``, or at once if it has passed."""
        self.doze_until(deadline_ns)
        while time.monotonic_ns() < deadline_ns:
            pass


class SteppedClock:
    """Simulated time, which passes only while the loop sleeps; all else takes no time."""

    is_real = False

    def __init__(self) -> None:
        self._now_ns = 0

    def now_ns(self) -> int:
        """Simulated time, ns."""
        return self._now_ns

    def doze_until(self, deadline_ns: int) -> bool:
        """Do nothing and return False: simulated time leaves none before a deadline."""
        return False

    def sleep_until(self, deadline_ns: int) -> None:
        """Advance the time to ``deadline_ns``."""
        self._now_ns = max(self._now_ns, deadline_ns)


@contextlib.contextmanager
def punctuality(priority: int) -> Iterator[list[Finding]]:
    """Make the process wake up on time, and undo that afterwards.

    Asks for SCHED_FIFO, locked memory, no garbage collection and no deep sleep of the processor.

    ``priority``: of SCHED_FIFO, 1 to 99; 0 changes nothing. Yields one finding for each request, granted or not, with
    its remedy.
    """
    if priority == 0:
        yield []
        return
    with contextlib.ExitStack() as stack:
        findings = [_lock_memory(stack), _take_priority(priority, stack), _prevent_deep_sleep(stack)]
        gc.collect()
        gc.freeze()
        if gc.isenabled():
            gc.disable()
            stack.callback(gc.enable)
        stack.callback(gc.unfreeze)
        yield findings


def _lock_memory(stack: contextlib.ExitStack) -> Finding:
    import resource  # imported here: Windows has none, and doctor is imported there too

    check, fix = "memory", "raise memlock in /etc/security/limits.conf (of a container: --ulimit memlock=-1)"
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.mlockall(_MCL_CURRENT | _MCL_FUTURE) != 0:
        return Finding(check, "warn", f"memory is not locked ({os.strerror(ctypes.get_errno())})", fix, "FH-310")
    stack.callback(libc.munlockall)
    limit = resource.getrlimit(resource.RLIMIT_MEMLOCK)[0]
    if limit == resource.RLIM_INFINITY or _may_lock_anything():
        return Finding(check, "pass", "memory is locked")
    detail = f"memory is locked, but the limit of {limit / 1e6:.0f} MB leaves little room: more is not granted"
    return Finding(check, "warn", detail, fix, "FH-311")


def _may_lock_anything() -> bool:
    """Return True if the process has the capability CAP_IPC_LOCK, which lifts the limit."""
    status = system_text(Path("/proc/self/status")) or ""
    found = re.search(r"^CapEff:\s*([0-9a-f]+)$", status, re.MULTILINE)
    return found is not None and bool(int(found[1], 16) >> _CAP_IPC_LOCK & 1)


def _take_priority(priority: int, stack: contextlib.ExitStack) -> Finding:
    check = "priority"
    try:
        before = os.sched_getscheduler(0), os.sched_getparam(0)
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(priority))
    except OSError as error:
        return Finding(
            check,
            "warn",
            f"no SCHED_FIFO priority {priority} ({error.strerror}): the loop runs at ordinary priority",
            "run as root (in a container: --cap-add SYS_NICE), or give the user rtprio in /etc/security/limits.conf",
            "FH-312",
        )
    stack.callback(os.sched_setscheduler, 0, *before)
    return Finding(check, "pass", f"SCHED_FIFO priority {priority} is granted")


def _prevent_deep_sleep(stack: contextlib.ExitStack) -> Finding:
    check = "processor sleep"
    try:
        # while this file is open, the processor stays out of states that take long to leave
        latency = os.open("/dev/cpu_dma_latency", os.O_WRONLY)
        stack.callback(os.close, latency)
        os.write(latency, struct.pack("i", 0))
    except OSError as error:
        detail = f"/dev/cpu_dma_latency cannot be held ({error.strerror}): wake-ups may take longer"
        is_there = not isinstance(error, FileNotFoundError)
        fix = "run as root, or let a udev rule give the user write access to it"
        if not is_there:
            fix = "a container needs --device /dev/cpu_dma_latency"
        return Finding(check, "warn", detail, fix, "FH-314")
    return Finding(check, "pass", "/dev/cpu_dma_latency can be held: the processor stays out of deep sleep")
