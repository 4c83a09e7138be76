"""Experiments 3, presliding and drift, and 6, break-away: a force pushes 1 kg."""

import numpy as np

from friction_hil.numerics.jit import Array
from friction_hil.study.mass import push
from friction_hil.study.result import ExperimentResult, thin
from friction_hil.study.subjects import DEFAULT, StudySettings, break_away, matched

FORCE_FRACTION = 0.95  # of the break-away force, in presliding
DRIFT_FRACTIONS = (0.35, 0.2)  # mean and amplitude of the shaking force, as fractions of the break-away force
DRIFT_CYCLES = 10
FORCE_RATES = np.geomspace(0.2, 50.0, 9)  # Coulomb levels per second
DAMPER = 100.0  # N s/m, in presliding: without damping the mass would ring and therefore creep
RATE = 0.1  # Coulomb levels per second, in presliding
_SHAKING_HZ = 5.0
_BREAK_AWAY_DT = 1e-4  # s
_LEAST_SAMPLES = 20_000


def presliding(name: str, given: StudySettings = DEFAULT) -> ExperimentResult:
    """Cycle the force below break-away and record the motion; then shake the mass about a mean force."""
    model = matched(name, given.friction)
    peak = FORCE_FRACTION * break_away(name, given.friction)
    dt = 2e-4
    corners = peak * np.array([0.0, 1.0, -1.0, 1.0])
    lengths = np.round(np.abs(np.diff(corners)) / (RATE * given.friction.coulomb * dt)).astype(int)
    force = np.concatenate(
        [np.linspace(a, b, n, endpoint=False) for a, b, n in zip(corners[:-1], corners[1:], lengths, strict=True)]
    )
    position = push(model, given.mass, force, dt, DAMPER)[0]
    cycle = slice(int(lengths[0]), None)  # from one peak to the next
    energy = float(np.sum(force[cycle][1:] * np.diff(position[cycle])))
    time, shaken = _shake(name, given)
    facts = {
        "presliding_um": 1e6 * float(np.abs(position).max()),
        "presliding_loss_uJ": 1e6 * energy,
        "drift_um": 1e6 * float(shaken[-1] - shaken[shaken.size // 2 - 1]),
    }
    return ExperimentResult(facts, {"force": thin(position, force, 1000), "shaken": thin(time, shaken, 1000)})


def _shake(name: str, given: StudySettings) -> tuple[Array, Array]:
    """Simulate twice `DRIFT_CYCLES` of a sinusoidal force with a mean, the first half to settle; return t and x."""
    dt = 1e-4
    period = round(1.0 / (_SHAKING_HZ * dt))
    time = dt * np.arange(1, 2 * DRIFT_CYCLES * period + 1)
    mean, swing = (fraction * break_away(name, given.friction) for fraction in DRIFT_FRACTIONS)
    rise = np.minimum(time * _SHAKING_HZ, 1.0)
    force = mean * rise + swing * rise * np.sin(2.0 * np.pi * _SHAKING_HZ * time)
    return np.asarray(time), push(matched(name, given.friction), given.mass, np.asarray(force), dt, DAMPER)[0]


def break_away_force(name: str, given: StudySettings = DEFAULT) -> ExperimentResult:
    """Raise the force at several rates; record the largest friction until the mass slides."""
    rates = given.friction.coulomb * FORCE_RATES
    levels = np.array([_largest_friction(name, rate, given) for rate in rates.tolist()])
    facts = {"breakaway_slow_N": float(levels[0]), "breakaway_fast_N": float(levels[-1])}
    return ExperimentResult(facts, {"force": (rates, levels)})


def _largest_friction(name: str, rate: float, given: StudySettings) -> float:
    """Return the largest friction minus its viscous part under a force that rises far beyond break-away, N."""
    peak = 2.0 * given.friction.static
    samples = max(round(peak / (rate * _BREAK_AWAY_DT)), _LEAST_SAMPLES)
    force = np.linspace(0.0, peak, samples)
    _, velocity, friction = push(matched(name, given.friction), given.mass, force, force[1] / rate)
    return float((friction - given.friction.viscous * velocity).max())
