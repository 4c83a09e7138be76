"""Delay of a drive's set-points, from a following error that is in proportion to the speed. Pure.

Where the demand that is compared with the position is older or newer than the drive's own, the error has a part
v * dt, which neither friction nor its compensation changes: it hides both. It is fitted beside what goes with the
direction and the acceleration, and the errors are compared without it. The largest error without it cannot be found
afterwards, so it is kept for every delay in question.
"""

import math

import numpy as np

from friction_hil.numerics.jit import Array, compiled

_REACH, _STEP = 4.0, 0.02  # periods of delay, in both directions
_COUNT = round(2.0 * _REACH / _STEP) + 1
_TERMS = 5  # error; way in a period, direction, acceleration, constant
_LEAST = 0.05  # periods: less is no finding
_MOST_ALIKE = 50.0  # 1 / (1 - R^2) of the way, explained by direction, acceleration and constant
_ALIKE = 0.15  # periods
_MOST_LEFT = 0.5  # of the square of the error, if a delay is to explain it
_LONGEST = 10.0  # periods that can be configured


@compiled
def _add(moments: Array, peaks: Array, error: float, way: float, acceleration: float) -> None:
    x = (error, way, 1.0 if way > 0.0 else -1.0 if way < 0.0 else 0.0, acceleration, 1.0)
    for i in range(_TERMS):
        for j in range(_TERMS):
            moments[i, j] += x[i] * x[j]
    for k in range(peaks.size):
        peaks[k] = max(peaks[k], abs(error - (_STEP * k - _REACH) * way))


class DelaySums:
    """Sums over cycles, from which a delay follows, and the errors without it.

    Examples
    --------
    >>> sums = DelaySums()
    >>> for k in range(1000):
    ...     way = 0.01 * math.sin(0.01 * k)
    ...     sums.add(0.5 * way + 1e-5 * math.cos(0.3 * k), way, 0.0)
    >>> round(sums.delay(2.0), 2), round(sums.rms(0.5), 6), round(sums.peak(0.5), 6)
    (0.5, 7e-06, 1e-05)
    """

    __slots__ = ("moments", "peaks")

    def __init__(self) -> None:
        self.moments, self.peaks = np.zeros((_TERMS, _TERMS)), np.zeros(_COUNT)

    def add(self, error: float, way: float, acceleration: float) -> None:
        """Add a cycle: following error, demanded way in a period, and demanded acceleration."""
        _add(self.moments, self.peaks, error, way, acceleration if math.isfinite(acceleration) else 0.0)

    def join(self, other: "DelaySums") -> None:
        """Add the cycles of another sum."""
        self.moments += other.moments
        np.maximum(self.peaks, other.peaks, out=self.peaks)

    def _left(self, delay: float) -> float:
        """Return the mean square of the error without a delay, about its mean."""
        m = self.moments
        square = m[0, 0] - 2.0 * delay * m[0, 1] + delay * delay * m[1, 1]
        return float(square - (m[0, 4] - delay * m[1, 4]) ** 2 / m[4, 4])

    def delay(self, configured: float) -> float:
        """Return by how many periods the drive's demand is later than ``configured``; 0 if the errors show no delay."""
        if not (self.moments[4, 4] > 0.0 and self.moments[1, 1] > 0.0):
            return 0.0
        scale = np.sqrt(np.maximum(np.diag(self.moments)[1:], 1e-300))
        normal = self.moments[1:, 1:] / np.outer(scale, scale) + 1e-9 * np.eye(_TERMS - 1)
        inverse = np.linalg.inv(normal)
        if inverse[0, 0] > _MOST_ALIKE:  # one speed in both directions: friction would look the same
            return 0.0
        found = float((inverse @ (self.moments[1:, 0] / scale) / scale)[0])
        # what is left of friction after reversals pulls at the other terms: where both agree, the plain fit is closer
        m = self.moments
        plain = float((m[0, 1] - m[0, 4] * m[1, 4] / m[4, 4]) / (m[1, 1] - m[1, 4] ** 2 / m[4, 4]))
        found = plain if abs(plain - found) <= _ALIKE else found
        is_clear = _LEAST <= abs(found) <= _REACH and self._left(found) < _MOST_LEFT * self._left(0.0)
        return found if is_clear and 0.0 <= configured + found <= _LONGEST else 0.0

    def rms(self, delay: float) -> float:
        """Return the root mean square of the errors without a delay."""
        m = self.moments
        square = m[0, 0] - 2.0 * delay * m[0, 1] + delay * delay * m[1, 1]
        return math.sqrt(max(float(square / m[4, 4]), 0.0))

    def peak(self, delay: float) -> float:
        """Return the largest absolute error without a delay."""
        return float(np.interp((delay + _REACH) / _STEP, np.arange(_COUNT), self.peaks))
