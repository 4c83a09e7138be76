"""Waiting until a moment in each period without a time-out of its own for each wait.

A time-out that is shorter than the system's tick makes the kernel program its clock anew, twice: when the wait begins
and when it ends. In a virtual machine that takes as long as all else of the wait. A timer that expires once a period
by itself needs that once, and while nobody waits.
"""

import contextlib
import ctypes
import os
import time

_LEAD_NS = 150_000  # before the moment; what is left then is waited for with a time-out
_MOST_LEAD_NS = 300_000


class _Time(ctypes.Structure):
    _fields_ = (("s", ctypes.c_long), ("ns", ctypes.c_long))


class _Setting(ctypes.Structure):
    _fields_ = (("period", _Time), ("first", _Time))


class Ticker:
    """A timer of the operating system (timerfd of Linux) that expires once a period, shortly before a moment.

    Parameters
    ----------
    period_ns : int

    Attributes
    ----------
    descriptor : int
        It is ready when the timer has expired since `clear`.

    Raises
    ------
    OSError
        The operating system has none.
    """

    def __init__(self, period_ns: int) -> None:
        self._period_ns = period_ns
        self._expiry_ns = 0  # one of its expiries; 0: it does not run
        self._libc = ctypes.CDLL(None, use_errno=True)
        if not hasattr(self._libc, "timerfd_create"):
            raise OSError("no timerfd")
        self.descriptor: int = self._libc.timerfd_create(time.CLOCK_MONOTONIC, os.O_NONBLOCK | os.O_CLOEXEC)
        if self.descriptor < 0:
            raise OSError(ctypes.get_errno(), "timerfd_create")

    def expires_before(self, moment_ns: int, now_ns: int) -> bool:
        """Whether it expires shortly before a moment; if not, see to it for the periods to come.

        Parameters
        ----------
        moment_ns : int
            Of the monotonic clock; the same in each period.
        now_ns : int
            Of the monotonic clock.
        """
        if moment_ns - now_ns > self._period_ns:  # no moment of this period
            return False
        lead_ns = (moment_ns - self._expiry_ns) % self._period_ns
        if lead_ns <= _MOST_LEAD_NS and self._expiry_ns:
            return max(now_ns + 1, self._expiry_ns) <= moment_ns - lead_ns  # not so in the period in which it was set
        self._expiry_ns = moment_ns - _LEAD_NS + self._period_ns
        period, first = divmod(self._period_ns, 1_000_000_000), divmod(self._expiry_ns, 1_000_000_000)
        setting = _Setting(_Time(*period), _Time(*first))
        is_absolute = 1
        if self._libc.timerfd_settime(self.descriptor, is_absolute, ctypes.byref(setting), None) != 0:
            self._expiry_ns = 0
        return False

    def clear(self) -> None:
        """Forget that it has expired."""
        with contextlib.suppress(BlockingIOError):
            os.read(self.descriptor, 8)

    def close(self) -> None:
        """Give it back. Safe to call twice."""
        if self.descriptor >= 0:
            os.close(self.descriptor)
            self.descriptor = -1
