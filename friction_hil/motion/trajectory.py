"""Set-points of the axes: paths over a path time that starts and stops smoothly."""

import math
from bisect import bisect_right
from collections.abc import Callable, Sequence
from itertools import accumulate
from typing import NamedTuple

from friction_hil.motion.catch_up import HeldTime, smooth_step

TWO_PI = 2.0 * math.pi

Path = Callable[[float], tuple[float, float, float]]

_LEAST_FADE_S = 0.5

# Catching up after missed periods
_MOST_EXCESS = 0.1  # of the rate of path time over 1
_HEADROOM = 0.5  # part of the way from the speed of a path to the velocity limit of its axis
_EXTRA_ACCELERATION = 0.2  # part of a path's own largest acceleration, for changes of the rate
_STEEPEST = 1.5  # largest derivative of the rate while path time starts, times ramp_s


def sine_path(amplitude: float, frequency: float, phase: float) -> Path:
    """Return the path amplitude sin(2 pi frequency s + phase) over path time s."""
    omega = TWO_PI * frequency

    def path(s: float) -> tuple[float, float, float]:
        angle = omega * s + phase
        sine, cosine = math.sin(angle), math.cos(angle)
        return amplitude * sine, amplitude * omega * cosine, -amplitude * omega * omega * sine

    return path


def circle_path(radius: float, frequency: float, phase: float) -> Path:
    """Return one axis of a circle: radius cos(2 pi frequency s + phase)."""
    return sine_path(radius, frequency, phase + 0.5 * math.pi)


def triangle_path(amplitude: float, frequency: float, rounding: float) -> Path:
    """Return a path of constant speed, whose corners are rounded over a fraction ``rounding`` of a quarter period.

    The fraction counts on each side of a corner. The straight lines aim at +-``amplitude``; a rounded corner stays a
    little inside.
    """
    quarter = 0.25 / frequency
    speed = amplitude / quarter
    corner = rounding * quarter

    def path(s: float) -> tuple[float, float, float]:
        # from -quarter (lower corner) over 0 (upwards through zero) to 3 quarters (lower corner again)
        phase = (s + quarter) % (4.0 * quarter) - quarter
        side = 1.0 if phase <= quarter else -1.0
        from_zero = phase if side > 0.0 else phase - 2.0 * quarter
        to_corner = quarter - abs(from_zero)
        if to_corner >= corner:
            return side * speed * from_zero, side * speed, 0.0
        end = math.copysign(1.0, from_zero)
        bend = speed / corner
        position = amplitude - 0.5 * speed * corner - 0.5 * bend * to_corner * to_corner
        return side * end * position, side * bend * to_corner, -side * end * bend

    return path


class Sweep(NamedTuple):
    """Sine whose amplitude grows geometrically from ``smallest`` to ``largest`` and shrinks again."""

    frequency: float  # Hz
    smallest: float  # rad or m
    largest: float  # rad or m
    duration_s: float  # whole periods


def sweeps_path(sweeps: Sequence[Sweep]) -> Path:
    """Return a path of one sweep after another, then standstill; position and velocity are zero between sweeps."""
    ends = list(accumulate(sweep.duration_s for sweep in sweeps))

    def path(s: float) -> tuple[float, float, float]:
        number = bisect_right(ends, s)
        if s <= 0.0 or number == len(ends):
            return 0.0, 0.0, 0.0
        sweep = sweeps[number]
        return _swelling(sweep, s - (ends[number] - sweep.duration_s))

    return path


def _swelling(sweep: Sweep, s: float) -> tuple[float, float, float]:
    """Return a(s) sin(2 pi f s) and two derivatives; the amplitude a fades in and out and swells in between."""
    frequency, smallest, largest, duration = sweep
    rate = math.pi / duration
    swell, swell1, swell2 = (
        math.sin(rate * s) ** 2,
        rate * math.sin(2.0 * rate * s),
        2.0 * rate * rate * math.cos(2.0 * rate * s),
    )
    decades = math.log(largest / smallest)
    inner = smallest * math.exp(decades * swell)
    inner1 = inner * decades * swell1
    inner2 = inner * ((decades * swell1) ** 2 + decades * swell2)
    fade_s = min(max(_LEAST_FADE_S, 0.25 / frequency), 0.5 * duration)  # not quicker than the sine itself
    side, since = (1.0, s) if s <= 0.5 * duration else (-1.0, duration - s)
    x = min(max(since / fade_s, 0.0), 1.0)
    edge = x * x * (3.0 - 2.0 * x)
    edge1 = side * 6.0 * x * (1.0 - x) / fade_s
    edge2 = 6.0 * (1.0 - 2.0 * x) / (fade_s * fade_s) if x < 1.0 else 0.0
    a = inner * edge
    a1 = inner1 * edge + inner * edge1
    a2 = inner2 * edge + 2.0 * inner1 * edge1 + inner * edge2
    omega = TWO_PI * frequency
    sine, cosine = math.sin(omega * s), math.cos(omega * s)
    return a * sine, a1 * sine + a * omega * cosine, (a2 - a * omega * omega) * sine + 2.0 * a1 * omega * cosine


def still_path(s: float) -> tuple[float, float, float]:
    """Stand still."""
    return 0.0, 0.0, 0.0


class Setpoint(NamedTuple):
    """Demanded position, velocity and acceleration at one instant, SI."""

    position: float
    velocity: float
    acceleration: float


class PathTime:
    """Path time s(t): stands still, accelerates to 1 s per s within ``ramp_s``, and stops on request.

    The rate follows 3 x^2 - 2 x^3, so that velocity and acceleration of the axis are continuous (in a stop during the
    start, only the velocity). All axes of a machine share one, so that they stay on their common path while they
    start, stop, and catch up after missed periods (`friction_hil.motion.catch_up`).
    """

    __slots__ = (
        "_change",
        "_excess",
        "_held",
        "_ramp_s",
        "_start_s",
        "_stop_duration",
        "_stop_path",
        "_stop_rate",
        "_stop_s",
    )

    def __init__(self, ramp_s: float) -> None:
        self._ramp_s = ramp_s
        self._start_s = math.inf
        self._stop_s = math.inf
        self._stop_path = self._stop_rate = self._stop_duration = 0.0
        self._held: HeldTime | None = None  # only after missed periods: else time is time, to the bit
        self._excess, self._change = _MOST_EXCESS, _STEEPEST / ramp_s

    def keep_within(self, velocity_limit: float, speed: float, acceleration: float) -> None:
        """Bound the catching up after missed periods by the limits of one more axis.

        The rate of path time exceeds 1 by at most a tenth, and so little that the axis stays at least half as far
        below its velocity limit as on its path. The rate changes no faster than while the axis starts, and so slowly
        that this adds no more than a fifth to the largest acceleration of the path.

        ``speed``, ``acceleration``: largest ones of the path at a rate of 1, SI; 0 for an axis that stands.
        """
        if speed > 0.0 and acceleration > 0.0:
            self._excess = min(self._excess, max(_HEADROOM * (velocity_limit / speed - 1.0), 0.0))
            self._change = min(self._change, _EXTRA_ACCELERATION * acceleration / speed)

    @property
    def ramp_s(self) -> float:
        """Time from rest to full speed, s."""
        return self._ramp_s

    def start(self, time_s: float) -> None:
        """Start at ``time_s``, from the beginning of the path; also again after a stop."""
        self._start_s = time_s
        self._stop_s = math.inf
        self._held = None

    def stop(self, time_s: float) -> None:
        """Begin to stop at ``time_s``; a second call has no effect."""
        if math.isinf(self._stop_s):
            if self._held is not None:
                time_s = self._held.at(time_s)[0]
            self._stop_path, self._stop_rate, _ = self._running(time_s)
            self._stop_duration = self._ramp_s * max(self._stop_rate, 0.1)
            self._stop_s = time_s

    def hold(self, now_s: float, missed_s: float, later_s: float) -> None:
        """Go on at ``now_s`` from where path time was ``missed_s`` before, and catch up from ``later_s`` on.

        Before the start there is nothing to hold. ``missed_s``: of the periods that were missed; set-points up to
        ``later_s`` were sent already.
        """
        if self._start_s >= later_s:
            return
        if self._held is None:
            self._held = HeldTime(self._excess, self._change)
        self._held.hold(now_s, missed_s, later_s)

    def lag_s(self, time_s: float) -> float:
        """Return by how much missed periods have put path time behind at ``time_s``, s."""
        return 0.0 if self._held is None else self._held.lag_s(time_s)

    def is_standing(self, time_s: float) -> bool:
        """Return True if the path time has stopped for good by ``time_s``."""
        if self._held is not None:
            time_s = self._held.at(time_s)[0]
        return time_s >= self._stop_s + self._stop_duration

    def at(self, time_s: float) -> tuple[float, float, float]:
        """Return path time, its rate and the derivative of the rate at ``time_s``."""
        if self._held is None:
            since_s = time_s - self._start_s
            if since_s >= self._ramp_s and time_s < self._stop_s:  # in most cycles, three times in each
                return since_s - 0.5 * self._ramp_s, 1.0, 0.0
            return self._running(time_s) if time_s < self._stop_s else self._stopping(time_s)
        motion_s, pace, bend = self._held.at(time_s)
        s, rate, change = self._running(motion_s) if motion_s < self._stop_s else self._stopping(motion_s)
        return s, rate * pace, change * pace * pace + rate * bend

    def _stopping(self, time_s: float) -> tuple[float, float, float]:
        x = (time_s - self._stop_s) / self._stop_duration
        if x >= 1.0:
            return self._stop_path + 0.5 * self._stop_rate * self._stop_duration, 0.0, 0.0
        travelled = self._stop_rate * self._stop_duration * (x - x**3 + 0.5 * x**4)
        rate = self._stop_rate * (1.0 - x * x * (3.0 - 2.0 * x))
        return self._stop_path + travelled, rate, -6.0 * self._stop_rate * x * (1.0 - x) / self._stop_duration

    def _running(self, time_s: float) -> tuple[float, float, float]:
        if time_s <= self._start_s:
            return 0.0, 0.0, 0.0
        x = (time_s - self._start_s) / self._ramp_s
        if x >= 1.0:
            return time_s - self._start_s - 0.5 * self._ramp_s, 1.0, 0.0
        travelled, rate, change = smooth_step(x)
        return self._ramp_s * travelled, rate, change / self._ramp_s


class Trajectory:
    """Set-points of one axis over time: its path, shifted to begin where the axis stands."""

    __slots__ = ("_offset", "_path", "_time")

    def __init__(self, path: Path, time: PathTime) -> None:
        self._path = path  # position, velocity and acceleration over path time
        self._time = time  # shared by the axes of a machine
        self._offset = 0.0

    def begin_at(self, position: float) -> None:
        """Shift the path so that it starts at ``position``."""
        self._offset = position - self._path(0.0)[0]

    def at(self, time_s: float) -> Setpoint:
        """Return the set-point at ``time_s``, by the chain rule over path time."""
        s, rate, change = self._time.at(time_s)
        position, velocity, acceleration = self._path(s)
        return Setpoint(self._offset + position, velocity * rate, acceleration * rate * rate + velocity * change)


def extent(path: Path, duration_s: float, count: int = 2048) -> tuple[float, float, float]:
    """Return lowest and highest position relative to the start, and highest speed, within ``duration_s``."""
    samples = [path(duration_s * k / count) for k in range(count + 1)]
    start = samples[0][0]
    positions = [sample[0] - start for sample in samples]
    return min(positions), max(positions), max(abs(sample[1]) for sample in samples)


def largest_acceleration(path: Path, duration_s: float, count: int = 2048) -> float:
    """Return the largest of ``count`` samples of the acceleration within ``duration_s``, without its sign."""
    return max(abs(path(duration_s * (k + 0.5) / count)[2]) for k in range(count))
