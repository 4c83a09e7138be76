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
from typing import Any, NamedTuple

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


# what `take` needs, as fields of a record or attributes of an object
SETTINGS = [
    ("period_s", "f8"),
    ("cycles", "f8"),  # of a window, at least
    ("floor", "f8"),  # tolerated difference, SI
    ("lag_s", "f8"),
]
STATE = [
    ("start", "f8"),  # position at the beginning of the window; NaN before the first
    ("velocity", "f8"),  # of the last cycle
    ("count", "f8"),  # cycles of the window so far
    ("missing", "f8"),  # of these, without usable feedback
    ("integral", "f8"),  # of the velocity, per period
    ("low", "f8"),
    ("high", "f8"),
    ("contradictions", "f8"),  # windows in a row
    ("displacement", "f8"),  # of the last window
    ("way", "f8"),  # the same by the velocity
    ("duration_s", "f8"),
]
NO_WINDOW, AGREES, CONTRADICTS = range(3)


def take(c: Any, r: Any, position: float, velocity: float, is_usable: bool) -> int:
    """Take one cycle's feedback; return what the window showed that ends with it.

    One function for the daemon, which runs it as it is, and for the loops that compile it. ``c``, ``r``: have the
    fields of `SETTINGS` and `STATE`.
    """
    is_usable = is_usable and math.isfinite(position) and math.isfinite(velocity)
    verdict, is_beginning = NO_WINDOW, False
    if not math.isfinite(r.start):
        if is_usable:
            r.start, r.velocity, is_beginning = position, velocity, True
    else:
        if is_usable:
            r.integral += 0.5 * (r.velocity + velocity)
            r.velocity = velocity
            if velocity < r.low:
                r.low = velocity
            elif velocity > r.high:
                r.high = velocity
        else:
            r.integral += r.velocity
            r.missing += 1.0
        r.count += 1.0
        if r.count >= c.cycles:
            is_void = r.missing > _MOST_MISSING * r.count
            if is_usable:
                displacement, way = position - r.start, r.integral * c.period_s
                if not is_void:
                    tolerance = c.floor + _RATIO * max(abs(displacement), abs(way)) + c.lag_s * (r.high - r.low)
                    is_contradictory = abs(displacement - way) > tolerance
                    verdict = CONTRADICTS if is_contradictory else AGREES
                    r.contradictions = r.contradictions + 1.0 if is_contradictory else 0.0
                    r.displacement, r.way, r.duration_s = displacement, way, r.count * c.period_s
                r.start, is_beginning = position, True
            elif is_void:  # otherwise the window ends with the next usable cycle
                r.start, r.velocity, is_beginning = math.nan, 0.0, True
    if is_beginning:
        r.count = r.missing = r.integral = 0.0
        r.low = r.high = r.velocity
    return verdict


class VelocityCheck:
    """Compare velocity and position of one axis over windows of 20 ms, at least 10 cycles.

    ``velocity_limit``: largest velocity of the axis, SI; a tenth of it is the smallest difference that counts. The
    resolutions are the smallest steps of the position and of the reported velocity, SI.
    """

    __slots__ = (*(name for name, _ in (*SETTINGS, *STATE)), "is_lasting", "last")

    count: float
    missing: float
    integral: float
    low: float
    high: float

    def __init__(
        self, period_s: float, velocity_limit: float, position_resolution: float, velocity_resolution: float = 0.0
    ) -> None:
        self.period_s = period_s
        self.cycles = float(max(_FEWEST_CYCLES, math.ceil(_WINDOW_S / period_s - 1e-9)))
        slowest = max(_FLOOR * velocity_limit, velocity_resolution)
        self.floor = slowest * self.cycles * period_s + _COUNTS * position_resolution
        self.lag_s = _LAG_S + 2.0 * period_s
        self.last: Window | None = None  # result of the last window that was not void
        self.is_lasting = False  # the last `WINDOWS_TO_FAULT` windows were contradictory
        self.contradictions = self.displacement = self.way = self.duration_s = 0.0
        self.restart()

    def restart(self) -> None:
        """Begin a new window at the next cycle, e.g. after the position was set anew."""
        self.start, self.velocity = math.nan, 0.0
        self.count = self.missing = self.integral = self.low = self.high = 0.0

    def take(self, position: float, velocity: float, *, is_usable: bool = True) -> Window | None:
        """Take one cycle's feedback; return the result of the window that ends with it.

        ``position``, ``velocity``: as the drive reports them, SI. ``is_usable``: False for a cycle without feedback:
        the velocity before is taken for it.
        """
        verdict = take(self, self, position, velocity, is_usable)
        if verdict == NO_WINDOW:
            return None
        self.last = Window(self.displacement, self.way, self.duration_s, verdict == CONTRADICTS)
        self.is_lasting = self.contradictions >= WINDOWS_TO_FAULT
        return self.last

    @property
    def fields(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Values of `SETTINGS` and `STATE`, for records."""
        settings, state = (tuple(float(getattr(self, name)) for name, _ in each) for each in (SETTINGS, STATE))
        return settings, state
