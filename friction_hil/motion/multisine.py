"""The motion that shows resonances: strokes of constant speed with a multisine on top, so that the axis keeps sliding.

Friction that changes its sign is no part of a linear system, and hides the response of the machine behind it. The axis
therefore travels to and fro at constant speed, and the multisine on top is slower than that: the velocity never changes
its sign between two corners. The period of the multisine is longer than a stroke, so that each stroke has another part
of it: what friction makes of the motion by its nonlinearity differs from stroke to stroke and shows as scatter.

The phases are those of a low crest factor, by clipping (E. Van der Ouderaa, J. Schoukens, J. Renneboog, IEEE
Transactions on Instrumentation and Measurement 37(1), 1988): a signal of the same peaks with more power. Its lines are
those of R. Pintelon, J. Schoukens, System Identification: A Frequency Domain Approach, 2nd ed., 2012, chapter 5.

>>> from friction_hil.motion import multisine
>>> plan = multisine.plan(velocity=2.0, travel=1.0, period_s=1e-3)
>>> round(plan.amplitude, 3), plan.frequency, plan.high_hz, plan.duration_s
(0.85, 0.21875, 250.0, 32.0)
"""

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from friction_hil.errors import UsageError
from friction_hil.motion.experiment import fastest_acceleration
from friction_hil.motion.trajectory import Path, triangle_path
from friction_hil.numerics.jit import Array

LOW_HZ = 2.0
LEAST_S, DURATION_S = 16.0, 32.0
REPEAT_S = 8.0  # period of the multisine
_HIGHEST_HZ = 250.0  # by default; machines of two masses that matter to a servo resonate below
_LOOP_SHARE = 0.4  # of the loop rate, by default
_LEAST_STROKE_S = 2.0  # the resolution of the spectrum is its inverse
_TRAVEL_FRACTION = 0.85  # an axis that follows overshoots a little, and the multisine adds to the strokes
_SHARE = 0.65  # of the speed of the strokes, for the peaks of the multisine
_ROUNDING = 0.15  # of a quarter period, for a corner
_GENTLE = 0.25  # of the acceleration of an experiment: many lines at once need less of each
_CORNER_SHARE = 0.3  # of the acceleration, for the corners; the multisine takes the rest
_KNOTS = 10.0  # of the table, for each period of the highest frequency
_BETWEEN_KNOTS = 0.97  # of the bounds: a peak may lie between two knots
_CLIPPINGS, _CLIP = 100, 1.4  # rounds, and the level over the RMS at which each of them clips


class MultisinePlan(NamedTuple):
    """Strokes and the multisine on top of them."""

    amplitude: float  # distance of the corners of the strokes from the start, rad or m
    frequency: float  # strokes to and fro per second, Hz
    sine_velocity: float  # bound of the multisine, rad/s or m/s
    sine_acceleration: float  # bound of the multisine, rad/s^2 or m/s^2
    low_hz: float  # band of the multisine
    high_hz: float
    duration_s: float  # whole strokes and whole periods of the multisine


def highest_hz(high_hz: float | None, period_s: float) -> float:
    """Return the highest frequency of a multisine, Hz: as given, or what the loop can send well."""
    return min(_HIGHEST_HZ, _LOOP_SHARE / period_s) if high_hz is None else high_hz


def plan(
    velocity: float,  # highest speed of strokes and multisine together, rad/s or m/s
    travel: float,  # largest distance from the start, to either side, rad or m; 85 % of it are used for the strokes
    *,
    period_s: float,  # of the loop
    # highest frequency of the multisine; by default 250 Hz, but at most 0.4 of the loop rate
    high_hz: float | None = None,
    # largest one, rad/s^2 or m/s^2; a quarter of that of an experiment of the same velocity is enough, and is not
    # exceeded
    acceleration: float | None = None,
    duration_s: float = DURATION_S,  # longest; it is rounded down to periods of the multisine, 8 s
) -> MultisinePlan:
    """Plan the motion within bounds.

    Raises `UsageError`: a bound is not above zero, the band is empty or reaches half of the loop rate, or the time is
    too short.
    """
    acceleration = min(_GENTLE * fastest_acceleration(velocity), math.inf if acceleration is None else acceleration)
    for name, value in (("velocity", velocity), ("travel", travel), ("acceleration", acceleration)):
        if not 0.0 < value < math.inf:
            raise UsageError(f"a multisine needs {name} above zero and finite, not {value:g}")
    top = highest_hz(high_hz, period_s)
    if not 2.0 * LOW_HZ <= top < 0.5 / period_s:
        raise UsageError(
            f"a multisine needs high_hz from {2.0 * LOW_HZ:g} Hz to less than half of the set-points per second, "
            f"{0.5 / period_s:g} Hz, not {top:g} Hz"
        )
    if not LEAST_S <= duration_s < math.inf:
        raise UsageError(f"a multisine takes {LEAST_S:g} s or more, not {duration_s:g} s")
    amplitude, corner = _TRAVEL_FRACTION * travel, _CORNER_SHARE * acceleration
    speed = min(velocity / (1.0 + _SHARE), 2.0 * amplitude / _LEAST_STROKE_S, math.sqrt(corner * _ROUNDING * amplitude))
    periods = math.floor(duration_s / REPEAT_S)
    strokes = max(1, math.floor(0.25 * speed / amplitude * periods * REPEAT_S))
    while strokes > 1 and math.gcd(strokes, periods) > 1:  # else parts of the multisine come back
        strokes -= 1
    length_s = periods * REPEAT_S
    frequency = strokes / length_s
    # one stroke may have to be shorter than it could be: its corners are then nearer to each other
    amplitude = min(amplitude, 0.25 * speed / frequency, corner * _ROUNDING / (4.0 * frequency) ** 2)
    speed = 4.0 * amplitude * frequency
    return MultisinePlan(
        amplitude, frequency, _SHARE * speed, (1.0 - _CORNER_SHARE) * acceleration, LOW_HZ, top, length_s
    )


def multisine_path(made: MultisinePlan) -> Path:
    """Return the path over path time: strokes and multisine, which begins anew every 8 s."""
    strokes = triangle_path(made.amplitude, made.frequency, _ROUNDING)
    table = multisine_table(made.low_hz, made.high_hz, made.sine_velocity, made.sine_acceleration)
    rows: list[tuple[float, float, float]] = [tuple(row) for row in table.tolist()]
    count, step = len(rows), REPEAT_S / len(rows)

    def path(s: float) -> tuple[float, float, float]:
        q, v, a = strokes(s)
        whole = math.floor(s / step)
        x = s / step - whole
        q0, v0, a0 = rows[whole % count]
        q1, v1, a1 = rows[(whole + 1) % count]
        # quintic through position, velocity and acceleration of both knots: all three are continuous
        rise = q1 - q0 - step * (v0 + 0.5 * step * a0)
        turn = step * (v1 - v0 - step * a0)
        bend = step * step * (a1 - a0)
        c3, c4, c5 = (
            10.0 * rise - 4.0 * turn + 0.5 * bend,
            -15.0 * rise + 7.0 * turn - bend,
            6.0 * rise - 3.0 * turn + 0.5 * bend,
        )
        dq = x * (step * v0 + x * (0.5 * step * step * a0 + x * (c3 + x * (c4 + x * c5))))
        dv = x * (step * step * a0 + x * (3.0 * c3 + x * (4.0 * c4 + x * 5.0 * c5))) / step
        da = x * (6.0 * c3 + x * (12.0 * c4 + x * 20.0 * c5)) / (step * step)
        return q + q0 + dq, v + v0 + dv, a + a0 + da

    return path


@lru_cache(maxsize=8)
def multisine_table(low_hz: float, high_hz: float, velocity: float, acceleration: float) -> Array:
    """Return position, velocity and acceleration (n, 3) of one period of a multisine, evenly sampled.

    Its spectrum is flat in velocity at low frequencies and flat in acceleration at high ones.

    Of ``velocity`` and ``acceleration``, its largest ones, SI, that which gives the smaller multisine counts.
    """
    count = 2 ** math.ceil(math.log2(_KNOTS * high_hz * REPEAT_S))
    numbers = np.arange(math.ceil(low_hz * REPEAT_S), math.floor(high_hz * REPEAT_S) + 1)
    omega = math.tau * numbers / REPEAT_S
    sizes = 1.0 / np.hypot(1.0, omega * velocity / acceleration)
    lines = sizes * np.exp(1j * np.random.default_rng(0).uniform(0.0, math.tau, len(numbers)))

    def waves(spectrum: Array) -> Array:
        padded = np.zeros(count // 2 + 1, dtype=complex)
        padded[numbers] = 0.5 * count * spectrum
        return np.asarray(np.fft.irfft(padded, count))

    bounds = (velocity, 1.0), (acceleration, 1j * omega)
    for _ in range(_CLIPPINGS):
        # what is nearest to its bound is clipped; of the result, only the phases are kept
        signals = [waves(lines * factor) / bound for bound, factor in bounds]
        worst = int(np.argmax([np.max(np.abs(each)) for each in signals]))
        peak = _CLIP * float(np.std(signals[worst]))
        clipped = np.fft.rfft(np.clip(signals[worst], -peak, peak))[numbers]
        lines = sizes * np.exp(1j * np.angle(clipped / bounds[worst][1]))
    columns = np.column_stack([waves(lines / (1j * omega)), waves(lines), waves(1j * omega * lines)])
    peaks = np.max(np.abs(columns), axis=0)
    return np.asarray(columns * _BETWEEN_KNOTS * min(velocity / peaks[1], acceleration / peaks[2]))
