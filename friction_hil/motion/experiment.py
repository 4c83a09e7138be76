"""The motion to record for an identification: from presliding to rated speed, within bounds.

Sines that swell and fade, one frequency after another. Two slow ones with large motions show the levels of friction,
the Stribeck curve, viscous friction and inertia. Three fast ones grow from a few encoder counts to sliding: they show
stiffness and damping of presliding, and pass the break-away of any axis without knowing it. The motion never creeps:
below the resolution of the encoder the state of a dynamic model is lost, and no estimator recovers it.

>>> from friction_hil.motion import experiment
>>> sweeps = experiment.plan(rated_velocity=2.0, travel=0.5, resolution=6e-6)
>>> [round(sweep.frequency, 2) for sweep in sweeps]
[0.75, 2.02, 10.0, 20.0, 40.0]
>>> position, velocity = experiment.demand([0.001 * k for k in range(60_300)], sweeps)
>>> float(abs(position).max().round(2)), float(abs(velocity).max().round(2)), float(position[-1])
(0.42, 2.0, 0.0)
"""

import math

import numpy as np
from numpy.typing import ArrayLike

from friction_hil.errors import UsageError
from friction_hil.motion.trajectory import Sweep, sweeps_path
from friction_hil.numerics.jit import Array

LEAST_S = 10.0
LEAST_RATE_HZ = 500.0  # of samples that show presliding
_RATE_SLACK = 1e-3  # of it: a rate that comes from time stamps or from a period is rounded

_PRESLIDING_HZ = (10.0, 20.0, 40.0)
_TIME_FRACTIONS = (0.35, 0.20, 0.15, 0.15, 0.15)  # of the time
_TRAVEL_FRACTION = 0.85  # an axis that follows overshoots a little
_SECOND = 2.7  # times the first frequency, with no simple ratio to it
_SECOND_SPEED = 0.75  # of the first one's
_SECOND_FORCE = _SECOND * _SECOND_SPEED  # acceleration over the first one's
_PRESLIDING_SPEED = 0.2  # of the rated one, at most
_SINE_FRACTION = 0.9  # of the acceleration; swelling and fading take the rest
_LEAST_PERIODS = 8.0
_FASTEST_SLOW_HZ = 3.0
_LEAST_COUNTS = 25.0  # of the encoder, in the smallest amplitude
_LEAST_SWELL = 2.0  # largest over smallest amplitude in presliding


def is_fast(rate_hz: float) -> bool:
    """Return True if samples are frequent enough to show presliding: `LEAST_RATE_HZ` or more."""
    return rate_hz >= (1.0 - _RATE_SLACK) * LEAST_RATE_HZ


def plan(
    rated_velocity: float,
    travel: float,
    resolution: float,
    duration_s: float = 60.0,
    *,
    acceleration: float = math.inf,
    period_s: float = 0.0,
) -> tuple[Sweep, ...]:
    """Return sweeps for an axis of which little is known.

    The top speed is below ``rated_velocity`` if ``travel`` or ``acceleration`` leaves no room for it.

    Parameters
    ----------
    rated_velocity : float
        Highest speed wanted, rad/s or m/s.
    travel : float
        Largest distance from the start, to either side, rad or m; 85 % of it are used.
    resolution : float
        One count of the encoder, rad or m.
    duration_s : float
        Length of all sweeps together, at least 10 s; each is rounded to whole periods.
    acceleration : float
        Largest one wanted, rad/s^2 or m/s^2.
    period_s : float
        Of sampling, s. Where it is too long to see presliding, the slow sweeps take all the time.

    Raises
    ------
    UsageError
        A value is not above zero, or the time too short; or the encoder is too coarse, or the acceleration too
        low, for presliding amplitudes that the encoder sees.
    """
    given = {"rated_velocity": rated_velocity, "travel": travel, "resolution": resolution, "acceleration": acceleration}
    for name, value in given.items():
        if not value > 0.0 or (math.isinf(value) and name != "acceleration"):
            raise UsageError(f"an experiment needs {name} above zero and finite, not {value:g}")
    if not LEAST_S <= duration_s < math.inf:
        raise UsageError(f"an experiment takes {LEAST_S:g} s or more, not {duration_s:g} s")
    is_presliding_seen = period_s == 0.0 or is_fast(1.0 / period_s)
    fractions = (
        _TIME_FRACTIONS if is_presliding_seen else [part / sum(_TIME_FRACTIONS[:2]) for part in _TIME_FRACTIONS[:2]]
    )
    acceleration *= _SINE_FRACTION
    slowest = _LEAST_PERIODS / (fractions[0] * duration_s)
    least_omega = math.tau * slowest
    largest = min(
        _TRAVEL_FRACTION * travel, rated_velocity / least_omega, acceleration / _SECOND_FORCE / least_omega**2
    )
    speed = min(
        rated_velocity, math.sqrt(acceleration * largest / _SECOND_FORCE), math.tau * _FASTEST_SLOW_HZ * largest
    )
    slow = max(speed / (math.tau * largest), slowest)
    second = _SECOND_SPEED * largest / _SECOND
    rows = [(slow, 0.1 * largest, largest), (_SECOND * slow, 0.1 * largest / _SECOND, second)]
    smallest = _LEAST_COUNTS * resolution
    for frequency in _PRESLIDING_HZ if is_presliding_seen else ():
        omega = math.tau * frequency
        most = min(largest, _PRESLIDING_SPEED * rated_velocity / omega, acceleration / omega**2)
        needed = _LEAST_SWELL * smallest
        if most < needed:
            enough = {  # of each bound, for this amplitude at the fastest frequency, which asks for the most
                "velocity": (rated_velocity, needed * math.tau * _PRESLIDING_HZ[-1] / _PRESLIDING_SPEED),
                "acceleration": (
                    acceleration / _SINE_FRACTION,
                    needed * (math.tau * _PRESLIDING_HZ[-1]) ** 2 / _SINE_FRACTION,
                ),
                "travel": (travel, needed / _TRAVEL_FRACTION),
            }
            advice = " and ".join(f"{name} to {_up(least)}" for name, (given, least) in enough.items() if given < least)
            raise UsageError(
                f"the encoder is too coarse for this experiment: at {frequency:g} Hz its amplitude is {most:.3g}, "
                f"{most / resolution:.0f} counts of {resolution:.3g}, and presliding shows from "
                f"{_LEAST_SWELL * _LEAST_COUNTS:g} on; raise {advice}, use a finer encoder, or take a period_s of more "
                f"than {1.0 / LEAST_RATE_HZ:g}, at which presliding is not looked for"
            )
        rows.append((frequency, smallest, most))
    return tuple(
        Sweep(f, low, high, round(fraction * duration_s * f) / f)
        for (f, low, high), fraction in zip(rows, fractions, strict=True)
    )


def _up(value: float) -> str:
    """Return a number rounded up to two digits, as text."""
    step = 10.0 ** (math.floor(math.log10(value)) - 1)
    return f"{math.ceil(value / step) * step:.2g}"


def demand(time_s: ArrayLike, sweeps: tuple[Sweep, ...]) -> tuple[Array, Array]:
    """Return position and velocity of the motion relative to its start; both are zero before and after it.

    Parameters
    ----------
    time_s : (n,) array_like
        Time from the beginning of the motion, s.
    sweeps : tuple of Sweep
        From `plan`.

    Returns
    -------
    position, velocity : (n,) array
        rad and rad/s, or m and m/s.
    """
    path = sweeps_path(sweeps)
    points = np.array([path(t)[:2] for t in np.asarray(time_s, dtype=np.float64).ravel().tolist()]).reshape(-1, 2)
    return np.ascontiguousarray(points[:, 0]), np.ascontiguousarray(points[:, 1])


def sliding_s(sweeps: tuple[Sweep, ...]) -> float:
    """Return the length of the slow sweeps, s, which come first: the axis slides mainly in these."""
    return duration_s(tuple(sweep for sweep in sweeps if sweep.frequency < _PRESLIDING_HZ[0]))


def duration_s(sweeps: tuple[Sweep, ...]) -> float:
    """Return the length of all sweeps together, s."""
    return math.fsum(sweep.duration_s for sweep in sweeps)
