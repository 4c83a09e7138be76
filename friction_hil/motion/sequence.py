"""Paths with rest: strokes with rests between them, and motions one after another."""

from bisect import bisect_right
from collections.abc import Sequence
from itertools import accumulate
from typing import NamedTuple

from friction_hil.motion.catch_up import smooth_step
from friction_hil.motion.trajectory import Path

STROKE_SPEED = 1.875  # largest speed of a stroke over its mean one
STROKE_ACCELERATION = 10.0 / 3.0**0.5  # largest acceleration of a stroke, times its duration squared over its length


def strokes_path(stroke: float, frequency: float, rest: float) -> Path:
    """Return a path to and fro between 0 and ``stroke`` that rests at both ends.

    A stroke has the least jerk: x = 10 u^3 - 15 u^4 + 6 u^5 (Flash and Hogan 1985, "The coordination of arm
    movements"), so that velocity and acceleration are zero at its ends.

    ``stroke``: distance between the ends, rad or m. ``frequency``: strokes to and fro per second, Hz. ``rest``:
    fraction of the time at rest, 0 <= rest < 1.
    """
    half = 0.5 / frequency
    length = (1.0 - rest) * half

    def path(s: float) -> tuple[float, float, float]:
        since = s % (2.0 * half)
        is_back = since >= half
        u = min((since - half if is_back else since) / length, 1.0)
        position = stroke * u**3 * (10.0 - 15.0 * u + 6.0 * u * u)
        velocity = 30.0 * stroke * (u * (1.0 - u)) ** 2 / length
        acceleration = 60.0 * stroke * u * (1.0 - u) * (1.0 - 2.0 * u) / (length * length)
        return (stroke - position, -velocity, -acceleration) if is_back else (position, velocity, acceleration)

    return path


def moving_s(length_s: float, ramp_s: float) -> float:
    """Return the time from the start of a motion to its stop, s: twice the ramp at half of the speed, on average."""
    return length_s + min(ramp_s, length_s)


class Part(NamedTuple):
    """One motion of a sequence: it starts and stops smoothly, ends where it began, and is followed by a rest."""

    path: Path
    length_s: float  # of its path, whole periods
    ramp_s: float  # from rest to full speed and back; zero for a path that rests at its ends
    rest_s: float

    @property
    def moving_s(self) -> float:
        """Time from its start to its stop, s."""
        return moving_s(self.length_s, self.ramp_s)

    @property
    def duration_s(self) -> float:
        """Time until the next motion begins, s."""
        return self.moving_s + self.rest_s


def sequence_path(parts: Sequence[Part]) -> Path:
    """Return a path of one motion after another, all from the same position, then standstill there.

    The rate of each motion's own path time follows 3 x^2 - 2 x^3 at its start and its stop, so that position and
    velocity are continuous, as they are at the start of a run (`friction_hil.motion.trajectory.PathTime`).
    """
    ends = list(accumulate(part.duration_s for part in parts))
    origins = [part.path(0.0)[0] for part in parts]

    def path(s: float) -> tuple[float, float, float]:
        number = bisect_right(ends, s)
        if s <= 0.0 or number == len(parts):
            return 0.0, 0.0, 0.0
        part = parts[number]
        own_s, rate, change = _path_time(part, s - (ends[number] - part.duration_s))
        if rate == 0.0:
            return 0.0, 0.0, 0.0
        position, velocity, acceleration = part.path(own_s)
        return position - origins[number], velocity * rate, acceleration * rate * rate + velocity * change

    return path


def _path_time(part: Part, s: float) -> tuple[float, float, float]:
    """Return path time of a motion ``s`` after its start, its rate, and the derivative of the rate."""
    ramp_s, left_s = min(part.ramp_s, part.length_s), part.moving_s - s
    if s <= 0.0 or left_s <= 0.0:
        return 0.0, 0.0, 0.0
    if s < ramp_s:
        travelled, rate, change = smooth_step(s / ramp_s)
        return ramp_s * travelled, rate, change / ramp_s
    if left_s < ramp_s:
        left, rate, change = smooth_step(left_s / ramp_s)
        return part.length_s - ramp_s * left, rate, -change / ramp_s
    return s - 0.5 * ramp_s, 1.0, 0.0
