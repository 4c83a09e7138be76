"""Lock of the loop to the SYNC of another controller: period and phase from time stamps. Pure: no bus, no clock."""

import math
from collections.abc import Sequence

import numpy as np

_PHASE_GAIN = 0.05
_PERIOD_GAIN = 0.25 * _PHASE_GAIN**2  # damping ratio 1
_CAPTURE = 0.25  # of the period: a stamp further away is an outlier
_OUTLIERS_TO_CAPTURE = 8  # in a row: the other clock has jumped
_LARGEST_DEVIATION = 0.01  # of the nominal period
_SMOOTHING = 0.02  # of the mean square of the phase error
_LOCKED = 0.125  # of the period, RMS of the phase error
_LEAST_STAMPS = 10


class PhaseLock:
    """Phase-locked loop of second order that follows the SYNC of another clock.

    Each stamp corrects the phase by a twentieth of its error, and the period so that the loop is critically damped:
    jitter of 100 us RMS is reduced to some 20 us, and a drift of the other clock leaves no lasting phase error.
    Source: F. M. Gardner, Phaselock Techniques, 3rd edition, 2005, chapter 2.

    Examples
    --------
    >>> lock = PhaseLock(1e-3)
    >>> lock.acquire([k * 1_000_100 for k in range(50)])
    ''
    >>> lock.start(60_000_000)
    >>> lock.sync_ns(0), round(lock.deviation_ppm)
    (60006000, 100)
    """

    __slots__ = ("_at_ns", "_cycle", "_nominal_ns", "_outliers", "_period_ns", "_square", "error_ns")

    def __init__(self, period_s: float) -> None:
        self._nominal_ns = self._period_ns = period_s * 1e9
        self._cycle = 0
        self._at_ns = 0.0
        self._square = math.inf
        self._outliers = 0
        self.error_ns = 0.0  # of the phase, of the last stamp: positive where SYNC came later than expected

    @property
    def is_locked(self) -> bool:
        """True if the RMS of the phase error is below an eighth of the period."""
        return self._square < (_LOCKED * self._nominal_ns) ** 2

    @property
    def jitter_ns(self) -> float:
        """RMS of the phase error, smoothed over some 50 stamps."""
        return math.sqrt(self._square)

    @property
    def deviation_ppm(self) -> float:
        """Deviation of the measured period from the nominal one, parts per million."""
        return (self._period_ns / self._nominal_ns - 1.0) * 1e6

    def acquire(self, stamps_ns: Sequence[int]) -> str:
        """Take period and phase from the stamps of successive SYNCs, some of which may be missing.

        Returns why they give no lock; empty if they do.
        """
        if len(stamps_ns) < _LEAST_STAMPS:
            return f"{len(stamps_ns)} of them are too few"
        stamps = np.asarray(stamps_ns, np.float64) - stamps_ns[0]
        steps = np.diff(stamps)
        typical = float(np.median(steps))
        if not abs(typical - self._nominal_ns) < 0.2 * self._nominal_ns:
            return f"it comes every {typical * 1e-6:.4g} ms and not every {self._nominal_ns * 1e-6:.4g} ms (period_s)"
        counts = np.concatenate(([0.0], np.cumsum(np.round(steps / self._nominal_ns))))
        is_kept = np.ones(stamps.size, np.bool_)
        for _ in range(2):  # the second time without outliers
            period, begin = np.polyfit(counts[is_kept], stamps[is_kept], 1)
            residuals = np.abs(stamps - (begin + period * counts))
            middle = float(np.median(residuals))
            is_kept = residuals <= 4.0 * middle + 1.0
        if middle > _CAPTURE * self._nominal_ns:
            shortest, longest = steps.min() * 1e-6, steps.max() * 1e-6
            causes = "do two controllers send it, or is this computer too busy?"
            return f"it comes unevenly, after {shortest:.3g} to {longest:.3g} ms: {causes}"
        if abs(period / self._nominal_ns - 1.0) > _LARGEST_DEVIATION:
            return f"it comes every {period * 1e-6:.5g} ms and not every {self._nominal_ns * 1e-6:.4g} ms (period_s)"
        self._period_ns = float(period)
        self._cycle, self._at_ns = 0, float(begin + period * counts[-1]) + stamps_ns[0]
        self._square = float(np.mean(residuals[is_kept] ** 2))
        self._outliers = 0
        return ""

    def start(self, now_ns: int) -> None:
        """Count cycles from now on: cycle 0 begins with the first SYNC expected after ``now_ns``."""
        ahead = math.floor((now_ns - self._at_ns) / self._period_ns) + 1
        self._cycle, self._at_ns = 0, self._at_ns + ahead * self._period_ns

    def sync_ns(self, cycle: int) -> int:
        """Return the time at which the SYNC of ``cycle`` is expected, ns."""
        return round(self._at_ns + (cycle - self._cycle) * self._period_ns)

    def cycle_at(self, time_ns: int) -> int:
        """Return the cycle whose SYNC is expected nearest to a time."""
        return self._cycle + round((time_ns - self._at_ns) / self._period_ns)

    def take(self, cycle: int, stamp_ns: int) -> bool:
        """Correct period and phase by the SYNC of ``cycle``; return False for an outlier, which corrects nothing."""
        expected = self._at_ns + (cycle - self._cycle) * self._period_ns
        self.error_ns = error = stamp_ns - expected
        if not abs(error) <= _CAPTURE * self._nominal_ns:
            self._outliers += 1
            if self._outliers >= _OUTLIERS_TO_CAPTURE:
                self.capture(cycle, stamp_ns)
            return False
        self._outliers = 0
        elapsed = max(cycle - self._cycle, 1)
        self._cycle, self._at_ns = cycle, expected + _PHASE_GAIN * error
        period = self._period_ns + _PERIOD_GAIN * error / elapsed
        bound = _LARGEST_DEVIATION * self._nominal_ns
        self._period_ns = min(max(period, self._nominal_ns - bound), self._nominal_ns + bound)
        self._square += _SMOOTHING * (error * error - self._square)
        return True

    def capture(self, cycle: int, stamp_ns: int) -> None:
        """Take the phase from one stamp: the other clock has jumped. The period stays."""
        self._cycle, self._at_ns, self._outliers = cycle, float(stamp_ns), 0
