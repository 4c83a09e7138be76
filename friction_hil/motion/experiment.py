"""The motion to record for an identification: from presliding to rated speed, within bounds.

Sines that swell and fade, one frequency after another. Two slow ones with large motions show the levels of friction,
the Stribeck curve, viscous friction and inertia. Up to three fast ones grow from a few encoder counts to sliding: they
show stiffness and damping of presliding, and pass the break-away of any axis without knowing it. The motion never
creeps: below the resolution of the encoder the state of a dynamic model is lost, and no estimator recovers it.

A fast sweep is left out where the encoder would see too few counts of it; a slower one with a larger amplitude takes
its place if there is one. Below 500 samples a second there are none. `not_shown` says what that costs.

>>> from friction_hil.motion import experiment
>>> sweeps = experiment.plan(rated_velocity=2.0, travel=0.5, resolution=6e-6)
>>> [round(sweep.frequency, 2) for sweep in sweeps]
[0.75, 2.02, 10.0, 20.0, 40.0]
>>> position, velocity = experiment.demand([0.001 * k for k in range(60_300)], sweeps)
>>> float(abs(position).max().round(2)), float(abs(velocity).max().round(2)), float(position[-1])
(0.42, 2.0, 0.0)
>>> coarse = experiment.plan(rated_velocity=8.0, travel=3.0, resolution=3.8e-4)
>>> [sweep.frequency for sweep in experiment.fast(coarse)]
[5.0, 10.0]
"""

import math

import numpy as np
from numpy.typing import ArrayLike

from friction_hil.errors import UsageError
from friction_hil.motion.trajectory import Sweep, sweeps_path
from friction_hil.numerics.jit import Array

LEAST_S = 10.0
LEAST_RATE_HZ = 500.0  # of samples that show all of presliding
_RATE_SLACK = 1e-3  # of it: a rate that comes from time stamps or from a period is rounded

_SAMPLES_PER_PERIOD, _SAMPLING_ERROR, _ROUNDING = 100, 5e-3, 1e-9  # of the check of a sweep against its bounds
_PRESLIDING_HZ = (5.0, 10.0, 20.0, 40.0)
_MOST_FAST = 3  # sweeps, the fastest that can be shown
_SLOW_SWEEPS = 2
_SLOW_RATIO = 0.35 / 0.55  # time of the first slow sweep over that of both
_FAST_TIME = 0.15  # of all the time, for each fast sweep; the slow ones take the rest
_TRAVEL_FRACTION = 0.85  # an axis that follows overshoots a little
_SECOND = 2.7  # times the first frequency, with no simple ratio to it
_SECOND_SPEED = 0.75  # of the first one's
_SECOND_FORCE = _SECOND * _SECOND_SPEED  # acceleration over the first one's
_PRESLIDING_SPEED = 0.2  # of the rated one, at most
_SINE_FRACTION = 0.9  # of the acceleration; swelling and fading take the rest
_LEAST_PERIODS = 8.0  # of the first sweep
_FOUR_PERIODS_S, _EIGHT_PERIODS_S = 15.0, 30.0  # in between, a shorter experiment has fewer of them
_FASTEST_SLOW_HZ = 3.0
LEAST_COUNTS = 25.0  # of the encoder, in the smallest amplitude of a fast sweep
_LEAST_SWELL = 2.0  # largest over smallest amplitude in presliding
_SLOW_SWELL = 100.0  # the same in slow sweeps, where the encoder is fine enough
_LEAST_TRAVEL_COUNTS = 4.0  # in the largest amplitude of all: with less, no velocity is known
_COST = (
    "stiffness and damping of presliding (sigma0, sigma1) are not determined, and only static models are identified "
    "unless --models names others; the friction while sliding is found, the more exactly the longer duration_s is"
)


def is_fast(rate_hz: float) -> bool:
    """Return True if samples are frequent enough to show all of presliding: `LEAST_RATE_HZ` or more."""
    return rate_hz >= (1.0 - _RATE_SLACK) * LEAST_RATE_HZ


def plan(
    rated_velocity: float,  # highest speed wanted, rad/s or m/s
    travel: float,  # largest distance from the start, to either side, rad or m; 85 % of it are used
    resolution: float,  # one count of the encoder, rad or m; fast sweeps of fewer than 50 counts are left out
    duration_s: float = 60.0,  # of all sweeps together, at least 10 s; each is rounded to whole periods
    *,
    acceleration: float = math.inf,  # largest one wanted, rad/s^2 or m/s^2
    period_s: float = 0.0,  # of sampling; where it is too long to see presliding, the slow sweeps take all the time
) -> tuple[Sweep, ...]:
    """Return sweeps for an axis of which little is known: two slow ones, then the fast ones that can be shown.

    The top speed is below ``rated_velocity`` if ``travel`` or ``acceleration`` leaves no room for it. Raises
    `UsageError`: a value is not above zero, or the time too short; or even the largest amplitude is less than four
    counts of the encoder.
    """
    given = {"rated_velocity": rated_velocity, "travel": travel, "resolution": resolution, "acceleration": acceleration}
    for name, value in given.items():
        if not value > 0.0 or (math.isinf(value) and name != "acceleration"):
            raise UsageError(f"an experiment needs {name} above zero and finite, not {value:g}")
    if not LEAST_S <= duration_s < math.inf:
        raise UsageError(f"an experiment takes {LEAST_S:g} s or more, not {duration_s:g} s")
    slowest = _slowest(duration_s, period_s)
    acceleration *= _SINE_FRACTION
    least_omega = math.tau * slowest
    largest = min(
        _TRAVEL_FRACTION * travel, rated_velocity / least_omega, acceleration / _SECOND_FORCE / least_omega**2
    )
    if largest < _LEAST_TRAVEL_COUNTS * resolution:
        raise UsageError(_too_coarse(rated_velocity, travel, resolution, duration_s, acceleration, largest, period_s))
    speed = min(
        rated_velocity, math.sqrt(acceleration * largest / _SECOND_FORCE), math.tau * _FASTEST_SLOW_HZ * largest
    )
    slow = max(speed / (math.tau * largest), slowest)
    rows = []
    for frequency in _PRESLIDING_HZ if _is_sampled(period_s) else ():
        most = min(largest, _fast_amplitude(frequency, rated_velocity, acceleration))
        if most >= _LEAST_SWELL * LEAST_COUNTS * resolution:
            rows.append((frequency, LEAST_COUNTS * resolution, most, _FAST_TIME))
    rows = rows[-_MOST_FAST:]
    slow_time = 1.0 - _FAST_TIME * len(rows)
    second = _SECOND_SPEED * largest / _SECOND
    swells = (
        (slow, largest, _SLOW_RATIO * slow_time),
        (_SECOND * slow, second, (1.0 - _SLOW_RATIO) * slow_time),
    )
    first = [(f, _smallest(high, resolution), high, share) for f, high, share in swells]
    sweeps = [Sweep(f, low, high, round(share * duration_s * f) / f) for f, low, high, share in [*first, *rows]]
    bounds = rated_velocity, acceleration / _SINE_FRACTION
    return (*(_within(sweep, *bounds) for sweep in sweeps[:_SLOW_SWEEPS]), *sweeps[_SLOW_SWEEPS:])


def _within(sweep: Sweep, velocity: float, acceleration: float) -> Sweep:
    """Return a slow sweep, smaller if its swelling and fading exceed a bound: one of few periods does so quickly."""
    path = sweeps_path((sweep,))
    count = math.ceil(_SAMPLES_PER_PERIOD * sweep.frequency * sweep.duration_s)
    points = [path(sweep.duration_s * k / count) for k in range(1, count)]
    speed, force = max(abs(point[1]) for point in points), max(abs(point[2]) for point in points)
    excess = max(speed / velocity, force / acceleration)
    if excess <= 1.0 + _ROUNDING:
        return sweep
    fraction = 1.0 / (excess * (1.0 + _SAMPLING_ERROR))
    return sweep._replace(smallest=fraction * sweep.smallest, largest=fraction * sweep.largest)


def _slowest(duration_s: float, period_s: float) -> float:
    """Return the lowest frequency of the first sweep, Hz: it has enough periods beside as many fast ones as may be."""
    slow_time = 1.0 - _MOST_FAST * _FAST_TIME if _is_sampled(period_s) else 1.0
    first_s = _SLOW_RATIO * slow_time * duration_s
    # faster periods are shorter strokes, which show less of a soft axis; so there are fewer, but never under four
    is_short = _FOUR_PERIODS_S <= duration_s < _EIGHT_PERIODS_S
    return _LEAST_PERIODS * (duration_s / _EIGHT_PERIODS_S if is_short else 1.0) / first_s


def _smallest(largest: float, resolution: float) -> float:
    """Return the amplitude from which a slow sweep swells; on a coarse encoder it swells less."""
    return min(max(largest / _SLOW_SWELL, LEAST_COUNTS * resolution), largest)


def _too_coarse(
    rated_velocity: float,
    travel: float,
    resolution: float,
    duration_s: float,
    acceleration: float,
    largest: float,
    period_s: float,
) -> str:
    """Return the message about a motion that the encoder hardly sees, with what would be enough."""
    needed = _LEAST_TRAVEL_COUNTS * resolution
    slowest = math.tau * _slowest(duration_s, period_s)
    enough = {
        "velocity": (rated_velocity, needed * slowest),
        "acceleration": (acceleration / _SINE_FRACTION, needed * _SECOND_FORCE * slowest**2 / _SINE_FRACTION),
        "travel": (travel, needed / _TRAVEL_FRACTION),
    }
    advice = " and ".join(f"{name} to {_up(least)}" for name, (given, least) in enough.items() if given < least)
    longest = " or take a longer duration_s," if rated_velocity < enough["velocity"][1] else ""
    return (
        f"the encoder is too coarse for this experiment: its largest amplitude is {largest:.3g}, "
        f"{largest / resolution:.2g} counts of {resolution:.3g}, and {_LEAST_TRAVEL_COUNTS:g} are the least; "
        f"raise {advice},{longest} or use a finer encoder"
    )


def _up(value: float) -> str:
    """Return a number rounded up to two digits, as text."""
    step = 10.0 ** (math.floor(math.log10(value)) - 1)
    return f"{math.ceil(value / step) * step:.2g}"


def fast(sweeps: tuple[Sweep, ...]) -> tuple[Sweep, ...]:
    """Return the sweeps of a plan that show presliding; the slow ones come before them."""
    return sweeps[_SLOW_SWEEPS:]


def coarsest(
    rated_velocity: float, travel: float, *, acceleration: float = math.inf, frequency: float = _PRESLIDING_HZ[0]
) -> float:
    """Return the largest count of an encoder that shows presliding within these bounds, rad or m.

    Parameters are those of `plan`; ``frequency`` is that of the fast sweep, by default of the slowest one, Hz.
    """
    most = min(_TRAVEL_FRACTION * travel, _fast_amplitude(frequency, rated_velocity, _SINE_FRACTION * acceleration))
    return most / (_LEAST_SWELL * LEAST_COUNTS)


def not_shown(sweeps: tuple[Sweep, ...], resolution: float, period_s: float = 0.0) -> str:
    """Return a sentence on what a plan leaves out and what that costs; empty if it leaves nothing out.

    ``resolution`` and ``period_s`` are those that `plan` was given.
    """
    shown = [sweep.frequency for sweep in fast(sweeps)]
    if not _is_sampled(period_s):
        return (
            f"presliding is not shown at {1.0 / period_s:.4g} samples a second ({LEAST_RATE_HZ:g} are needed): {_COST}"
        )
    if not shown:
        return f"presliding is not shown by an encoder with counts of {resolution:.3g} within these bounds: {_COST}"
    if shown[-1] < _PRESLIDING_HZ[-1]:
        *others, last = (f"{frequency:g}" for frequency in shown)
        at = f"{', '.join(others)} and {last}" if others else last
        return (
            f"presliding is shown at {at} Hz only, because faster motions within these bounds have fewer than "
            f"{_LEAST_SWELL * LEAST_COUNTS:g} counts of {resolution:.3g} each: its damping (sigma1) is not determined "
            "well"
        )
    return ""


def _is_sampled(period_s: float) -> bool:
    return period_s == 0.0 or is_fast(1.0 / period_s)


def _fast_amplitude(frequency: float, rated_velocity: float, acceleration: float) -> float:
    """Return the largest amplitude of a fast sweep that speed and acceleration leave room for."""
    omega = math.tau * frequency
    return min(_PRESLIDING_SPEED * rated_velocity / omega, acceleration / omega**2)


def fastest_acceleration(rated_velocity: float) -> float:
    """Return the largest acceleration of the fast sweeps if nothing bounds it, rad/s^2 or m/s^2."""
    return _PRESLIDING_SPEED * rated_velocity * math.tau * _PRESLIDING_HZ[-1]


def demand(time_s: ArrayLike, sweeps: tuple[Sweep, ...]) -> tuple[Array, Array]:
    """Return position and velocity of the motion relative to its start; both are zero before and after it.

    They are (n,), rad and rad/s, or m and m/s. ``time_s``: from the beginning of the motion.
    """
    path = sweeps_path(sweeps)
    points = np.array([path(t)[:2] for t in np.asarray(time_s, dtype=np.float64).ravel().tolist()]).reshape(-1, 2)
    return np.ascontiguousarray(points[:, 0]), np.ascontiguousarray(points[:, 1])


def sliding_s(sweeps: tuple[Sweep, ...]) -> float:
    """Return the length of the slow sweeps, s, which come first: the axis slides mainly in these."""
    return duration_s(sweeps[:_SLOW_SWEEPS])


def duration_s(sweeps: tuple[Sweep, ...]) -> float:
    """Return the length of all sweeps together, s."""
    return math.fsum(sweep.duration_s for sweep in sweeps)
