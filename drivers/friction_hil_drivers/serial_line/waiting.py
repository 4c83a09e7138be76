"""Waiting for replies on several lines, until a time that is the same in each period.

A time-out shorter than the system's tick makes the kernel program its clock twice: when the wait begins and when it
ends. In a virtual machine that takes as long as the rest of the wait. For a periodic timer the kernel programs its
clock once a period, when no process waits.
"""

import contextlib
import ctypes
import os
import select
import time
from collections.abc import Collection, Sequence

from friction_hil_drivers.serial_line.scheduler import BusScheduler

_TICK_MS = 10  # tick of the system: a longer time-out does not program the clock
_LEAD_NS = 150_000  # time by which the timer expires early; a time-out covers the rest
_MAX_LEAD_NS = 300_000


class _Time(ctypes.Structure):
    _fields_ = (("s", ctypes.c_long), ("ns", ctypes.c_long))


class _Setting(ctypes.Structure):
    _fields_ = (("period", _Time), ("first", _Time))


class PeriodicTimer:
    """Timer of the operating system (timerfd of Linux) that expires once a period, shortly before a given time.

    Raises `OSError`: the operating system has no such timer.
    """

    def __init__(self, period_ns: int) -> None:
        self._period_ns = period_ns
        self.expiry_ns = 0  # one of its expiries, of the monotonic clock; 0: it does not run
        self._libc = ctypes.CDLL(None, use_errno=True)
        if not hasattr(self._libc, "timerfd_create"):
            raise OSError("no timerfd")
        # readable when the timer has expired since `clear`
        self.descriptor: int = self._libc.timerfd_create(time.CLOCK_MONOTONIC, os.O_NONBLOCK | os.O_CLOEXEC)
        if self.descriptor < 0:
            raise OSError(ctypes.get_errno(), "timerfd_create")

    def expire_before(self, moment_ns: int, now_ns: int) -> bool:
        """Return True if the timer expires shortly before ``moment_ns``; else set it to do so from the next period on.

        ``moment_ns``: the same in each period; both times are of the monotonic clock.
        """
        if moment_ns - now_ns > self._period_ns:  # not in this period
            return False
        lead_ns = (moment_ns - self.expiry_ns) % self._period_ns
        if lead_ns <= _MAX_LEAD_NS and self.expiry_ns:
            return max(now_ns + 1, self.expiry_ns) <= moment_ns - lead_ns  # false in the period in which it was set
        self.expiry_ns = moment_ns - _LEAD_NS + self._period_ns
        period, first = divmod(self._period_ns, 1_000_000_000), divmod(self.expiry_ns, 1_000_000_000)
        setting = _Setting(_Time(*period), _Time(*first))
        is_absolute = 1
        if self._libc.timerfd_settime(self.descriptor, is_absolute, ctypes.byref(setting), None) != 0:
            self.expiry_ns = 0
        return False

    def clear(self) -> None:
        """Reset the descriptor: an expiry until now does not end a later wait."""
        with contextlib.suppress(BlockingIOError):
            os.read(self.descriptor, 8)

    def close(self) -> None:
        """Close the descriptor. Safe to call twice."""
        if self.descriptor >= 0:
            os.close(self.descriptor)
            self.descriptor = -1


class LineSelector:
    """Waits for bytes on some lines. ``period_ns``: of the times until which it usually waits."""

    def __init__(self, period_ns: int | None = None) -> None:
        self.timer: PeriodicTimer | None = None
        if period_ns is not None:
            with contextlib.suppress(OSError):  # without a timer each wait has a time-out
                self.timer = PeriodicTimer(period_ns)
        self._poll = select.poll()
        self._polled: list[int] = []

    def wait(self, descriptors: Sequence[int], until_ns: int, now_ns: int, *, is_periodic: bool) -> Collection[int]:
        """Wait for bytes, a closed connection, or ``until_ns``, or less long; return the descriptors that can be read.

        Times are of the monotonic clock. ``is_periodic``: ``until_ns`` is the same time in each period.
        """
        wait_ns = until_ns - now_ns
        wait_ms = wait_ns // 1_000_000
        timer = self.timer
        if wait_ms < _TICK_MS:
            if not (is_periodic and timer is not None and timer.expire_before(until_ns, now_ns)):
                return select.select(descriptors, (), (), wait_ns * 1e-9 if wait_ns > 0 else 0.0)[0]
            wait_ms += _TICK_MS
        if descriptors != self._polled:
            self._register(descriptors)
        ready = dict(self._poll.poll(wait_ms))
        if timer is not None and timer.descriptor in ready:
            timer.clear()
        return ready

    def _register(self, descriptors: Sequence[int]) -> None:
        self._poll = select.poll()
        for descriptor in descriptors:
            self._poll.register(descriptor, select.POLLIN)
        if self.timer is not None:
            self._poll.register(self.timer.descriptor, select.POLLIN)
        self._polled = list(descriptors)

    def forget(self) -> None:
        """Clear an expiry of the timer until now: it does not end a later wait."""
        if self.timer is not None:
            self.timer.clear()

    def close(self) -> None:
        """Release the timer. Safe to call twice."""
        if self.timer is not None:
            self.timer.close()
            self.timer = None
            self._polled = []


def run_schedulers(
    schedulers: Sequence[BusScheduler],
    until_ns: int,  # monotonic; if the selector has a period, it should be the same time in each period
    selector: LineSelector,
    *,
    until_answered: bool = True,  # False: only until everything has been sent
) -> bool:
    """Run schedulers until all has been sent and answered, or until ``until_ns``; return False for the latter."""
    while True:
        lines: list[int] = []
        for scheduler in schedulers:
            if scheduler.queue or (until_answered and scheduler.outstanding):
                # the line is open: on a closed line nothing is queued or outstanding
                lines.append(scheduler.line.descriptor)  # noqa: PERF401  a comprehension costs one more call
        if not lines:
            return True
        now = time.monotonic_ns()
        if now >= until_ns:
            return False
        next_ns = until_ns
        for scheduler in schedulers:
            # `due_ns` is None while replies are outstanding; the check before it saves time
            if not scheduler.outstanding and (due := scheduler.due_ns) is not None and due < next_ns:
                next_ns = due
        ready = selector.wait(lines, next_ns, now, is_periodic=next_ns == until_ns)
        for scheduler in schedulers:
            if scheduler.line.descriptor in ready:
                scheduler.poll(is_ready=True)
            elif (due := scheduler.due_ns) is not None and due <= time.monotonic_ns():
                scheduler.poll()
