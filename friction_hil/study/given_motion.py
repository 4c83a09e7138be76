"""Experiments 1, static curve, 2, pulse, 4, stress and strain, and 5, lag: the friction of a prescribed motion."""

import numpy as np

from friction_hil.friction import FrictionModel, kernel
from friction_hil.numerics.jit import Array
from friction_hil.study.result import ExperimentResult, thin
from friction_hil.study.subjects import DEFAULT, Levels, StudySettings, matched

LAG_RATES = (1.0, 10.0, 25.0)  # rad/s
_PULSE, _LAG_READ_AT = 2.0, 1.5  # Stribeck velocities
_STRAIN_SPEED = 0.1  # Stribeck velocities: slow against it
_STRAIN = (0.0, 3.0, -3.0, 0.0, -0.6, 0.0, 3.0)  # presliding lengths


def static_curve(name: str, given: StudySettings = DEFAULT) -> ExperimentResult:
    """Compute the friction at constant velocity."""
    slow = given.friction.stribeck_velocity
    velocity = np.geomspace(1e-2 * slow, 100.0 * slow, 300)
    force = matched(name, given.friction).steady_state(velocity)
    facts = {"curve_at_slow_N": float(force[0]), "curve_minimum_N": float(force.min())}
    return ExperimentResult(facts, {"force": (velocity, force)})


def velocity_pulse(name: str, given: StudySettings = DEFAULT) -> ExperimentResult:
    """Move forward, rest, move back, rest; each change of velocity takes 0.1 s."""
    dt = 5e-5
    corners = np.cumsum([0.0, 0.05, 0.1, 0.1, 0.1, 0.1, 0.1, 0.1, 0.1, 0.1])
    heights = _PULSE * given.friction.stribeck_velocity * np.array([0, 0, 1, 1, 0, 0, -1, -1, 0, 0])
    time = dt * np.arange(1, round(corners[-1] / dt) + 1)
    velocity = np.interp(time, corners, heights)
    force = _force(matched(name, given.friction), velocity, dt)
    end_of_pulse, in_rest = (round(float(corners[k] - 1e-3) / dt) for k in (3, 5))
    sliding = float(force[end_of_pulse])
    facts = {
        "pulse_overshoot_N": float(force[: end_of_pulse + 1].max()) - sliding,
        "pulse_at_rest_N": float(force[in_rest]),
    }
    return ExperimentResult(facts, {"force": thin(time, force, 1000), "velocity": thin(time, velocity)})


def stress_strain(name: str, given: StudySettings = DEFAULT) -> ExperimentResult:
    """Compute the friction over a displacement to and fro, with a small loop inside the large one."""
    dt = 5e-5
    speed = _STRAIN_SPEED * given.friction.stribeck_velocity
    corners = given.friction.presliding * np.array(_STRAIN)
    step = speed * dt
    lengths = np.round(np.abs(np.diff(corners)) / step).astype(int)
    velocity = np.repeat(np.sign(np.diff(corners)) * speed, lengths)
    model = matched(name, given.friction)
    force = _force(model, velocity, dt)
    position = np.cumsum(velocity) * dt
    facts = {}
    if not model.family.is_static:
        leaving, closing = (int(lengths[:k].sum()) - 1 for k in (3, 5))
        facts = {
            "stiffness_N_per_um": float((force[20] - force[10]) / (position[20] - position[10])) * 1e-6,
            "small_loop_gap_mN": 1e3 * float(force[closing] - force[leaving]),
        }
    return ExperimentResult(facts, {"force": thin(position, force, 1200)})


def frictional_lag(name: str, given: StudySettings = DEFAULT) -> ExperimentResult:
    """Compute the friction over a velocity that oscillates without changing its sign, at three rates."""
    facts, lines = {}, {}
    model = matched(name, given.friction)
    for rate in LAG_RATES:
        width, line = _lag_loop(model, rate, given.friction)
        facts[f"lag_width_{rate:g}_mN"] = 1e3 * width
        lines[f"{rate:g} rad/s"] = line
    return ExperimentResult(facts, lines)


def _lag_loop(model: FrictionModel, rate: float, levels: Levels) -> tuple[float, tuple[Array, Array]]:
    """Return the height of the loop at 1.5 Stribeck velocities, N, and the loop, of the second of two periods."""
    n = 20_000
    phase = 2.0 * np.pi * np.arange(1, 2 * n + 1) / n - 0.5 * np.pi  # begins and ends at rest
    velocity = levels.stribeck_velocity * (1.0 + np.sin(phase))
    force = _force(model, velocity, 2.0 * np.pi / (rate * n))
    v, f = velocity[n:], force[n:]
    at = _LAG_READ_AT * levels.stribeck_velocity
    rising, falling = slice(0, n // 2), slice(n - 1, n // 2, -1)
    width = np.interp(at, v[rising], f[rising]) - np.interp(at, v[falling], f[falling])
    return float(width), thin(v, f, 500)


def _force(model: FrictionModel, velocity: Array, dt: float) -> Array:
    """Compute the friction of every sample, by one loop for all models; one per model would take long to compile."""
    return kernel.run_any(model.kind, model.values, velocity, dt)
