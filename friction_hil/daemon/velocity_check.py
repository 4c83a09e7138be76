"""Comparison of the velocity that a drive reports with the derivative of the position that it reports. Pure.

Both come from the same drive, so a lasting contradiction means a frozen or slipping encoder, a wrong unit of one of
them, or a value that is no longer updated. Displacement is compared with the integral of the velocity over a window:
unlike a derivative, it is not made worse by a coarse encoder.

Use of `VelocityCheck`: call `take` once a cycle with the feedback as it came. It returns a `Window` at the end of each
window and None otherwise. `Window.is_contradictory` is one window's verdict; `is_lasting` is true after
`WINDOWS_TO_FAULT` contradictory windows in a row. `Window.ratio` is the reported velocity divided by the derivative:
9.55 if a drive reports rpm where rad/s are expected, 0 if it reports no velocity while it moves, infinity if its
position is frozen.

>>> check = VelocityCheck(1e-3, velocity_limit=10.0, position_resolution=1e-5)
>>> windows = [check.take(0.002 * cycle, 2.0 * 9.55) for cycle in range(61)]
>>> window = windows[-1]
>>> round(window.ratio, 2), window.is_contradictory, check.is_lasting
(9.55, True, True)
"""

import math
from typing import NamedTuple

WINDOWS_TO_FAULT = 2  # contradictory ones in a row
_WINDOW_S = 0.02
_FEWEST_CYCLES = 10
_RATIO = 0.3  # tolerated part of the larger of both: gears, filters, a load-side encoder
_FLOOR = 0.1  # tolerated part of the velocity limit: offsets, slow axes
_LAG_S = 0.01  # tolerated delay between the two, of filters in the drive
_COUNTS = 4.0  # tolerated steps of the position
_MOST_MISSING = 0.25  # part of a window without usable feedback that voids it


class Window(NamedTuple):
    """Result of one window."""

    displacement: float  # change of the position, SI
    integral: float  # of the reported velocity over the same time, SI
    duration_s: float
    is_contradictory: bool  # both differ by more than filters, delays and resolutions explain

    @property
    def ratio(self) -> float:
        """Reported velocity divided by the derivative of the position; NaN if the axis stood."""
        if self.displacement:
            return self.integral / self.displacement
        return math.copysign(math.inf, self.integral) if self.integral else math.nan


class VelocityCheck:
    """Compare velocity and position of one axis over windows of 20 ms, at least 10 cycles.

    ``velocity_limit``: largest velocity of the axis, SI; a tenth of it is the smallest difference that counts. The
    resolutions are the smallest steps of the position and of the reported velocity, SI.
    """

    __slots__ = (
        "_contradictions",
        "_count",
        "_cycles",
        "_floor",
        "_high",
        "_integral",
        "_lag_s",
        "_low",
        "_missing",
        "_period_s",
        "_start",
        "_velocity",
        "is_lasting",
        "last",
    )

    def __init__(
        self, period_s: float, velocity_limit: float, position_resolution: float, velocity_resolution: float = 0.0
    ) -> None:
        self._period_s = period_s
        self._cycles = max(_FEWEST_CYCLES, math.ceil(_WINDOW_S / period_s - 1e-9))
        duration_s = self._cycles * period_s
        slowest = max(_FLOOR * velocity_limit, velocity_resolution)
        self._floor = slowest * duration_s + _COUNTS * position_resolution
        self._lag_s = _LAG_S + 2.0 * period_s
        self.last: Window | None = None  # result of the last window that was not void
        self.is_lasting = False  # the last `WINDOWS_TO_FAULT` windows were contradictory
        self._contradictions = 0
        self.restart()

    def restart(self) -> None:
        """Begin a new window at the next cycle, e.g. after the position was set anew."""
        self._start = math.nan  # position at the beginning of the window
        self._velocity = 0.0
        self._begin_window()

    def _begin_window(self) -> None:
        self._count = self._missing = 0
        self._integral = 0.0
        self._low = self._high = self._velocity

    def take(self, position: float, velocity: float, *, is_usable: bool = True) -> Window | None:
        """Take one cycle's feedback; return the result of the window that ends with it.

        ``position``, ``velocity``: as the drive reports them, SI. ``is_usable``: False for a cycle without feedback:
        the velocity before is taken for it.
        """
        is_usable = is_usable and math.isfinite(position) and math.isfinite(velocity)
        if not math.isfinite(self._start):
            if is_usable:
                self._start, self._velocity = position, velocity
                self._begin_window()
            return None
        if is_usable:
            self._integral += 0.5 * (self._velocity + velocity)
            self._velocity = velocity
            if velocity < self._low:
                self._low = velocity
            elif velocity > self._high:
                self._high = velocity
        else:
            self._integral += self._velocity
            self._missing += 1
        self._count += 1
        if self._count < self._cycles:
            return None
        if not is_usable:  # the window ends with the next usable cycle
            if self._missing > _MOST_MISSING * self._count:
                self.restart()
            return None
        return self._end_window(position)

    def _end_window(self, position: float) -> Window | None:
        """Judge the window that ends at ``position``; None if too much of it was missing."""
        is_void = self._missing > _MOST_MISSING * self._count
        displacement, integral = position - self._start, self._integral * self._period_s
        tolerance = (
            self._floor + _RATIO * max(abs(displacement), abs(integral)) + self._lag_s * (self._high - self._low)
        )
        is_contradictory = abs(displacement - integral) > tolerance
        window = Window(displacement, integral, self._count * self._period_s, is_contradictory)
        self._start = position
        self._begin_window()
        if is_void:
            return None
        self.last = window
        self._contradictions = self._contradictions + 1 if is_contradictory else 0
        self.is_lasting = self._contradictions >= WINDOWS_TO_FAULT
        return window
