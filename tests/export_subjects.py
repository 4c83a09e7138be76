"""What the tests export: every model, compensators of every kind, motions for them, and what this library computes."""

import math
from functools import cache

import numpy as np

import friction_hil as fh
from friction_hil.compensator import ThermalObserver
from tests.compensators import LUGRE, MODELS, compensator
from tests.networks import alone, beside, random_network

MODIFIERS = {
    "load": {"motoring": 0.1, "driven": 0.05},
    "temperature": {"reference": 40.0, "coefficient": -0.004},
    "viscous": {"quadratic": 1e-3, "cubic": 1e-4},
    "ripple": [{"order": 7, "cosine": 0.001, "sine": 0.002}],
    "reversal": {"distance": [1e-5, 1e-4, 1e-3], "positive": [0.003, -0.002, 0.001], "negative": [0.002, 0.004, 0.0]},
    "speed": {"velocity": [0.1, 1.0], "positive": [0.003, -0.002], "negative": [-0.004, 0.002]},
}


def modified(name):
    example = fh.models.describe(name).example
    sides = {"positive": {"coulomb": 0.09}, "negative": {"coulomb": 0.07}}
    chosen = MODIFIERS | ({"direction": sides} if "coulomb" in example else {})
    return fh.models.create(name, modifiers=chosen, **example)


EVERY_MODEL = {
    **MODELS,
    **{f"{name}_modified": modified(name) for name in ("armstrong", "gms", "lugre", "table")},
    **{f"net_{name}": alone(random_network(name)) for name in ("narx", "every_input")},
    "dahl_2": fh.models.create("dahl", **dict(fh.models.describe("dahl").example) | {"exponent": 2.0}),
    "bouc_wen_2": fh.models.create("bouc_wen", **dict(fh.models.describe("bouc_wen").example) | {"exponent": 1.7}),
    "residual": beside(random_network("gated_2", is_residual=True), modifiers=MODIFIERS),
}
_GIVEN = {"position_resolution": 1e-4, "lead_s": 1.5e-3}
COMPENSATORS = {
    "tracking": compensator(MODELS["gms"], velocity="tracking", source="demand", max_acceleration=1e3, **_GIVEN),
    "kalman": compensator(
        modified("lugre"),
        **{"velocity": "kalman", "gravity": (0.01, 0.02, 0.03), "thermal": ThermalObserver(50.0, 2.0, 20.0, 25.0, 1.0)},
        **_GIVEN,
    ),
    "drive": compensator(MODELS["stribeck"], velocity="drive", smoothing=0.3, dead_band=0.01, **_GIVEN),
    "adapting": compensator(LUGRE, adaptation_s=1.0, gain_negative=0.7, torque_slew=5.0, torque_limit=0.1, **_GIVEN),
    "geared": compensator(
        modified("lugre"),
        **{"load_inertia": 1e-4, "load_friction": 0.03, "backlash": 1e-3, "stiffness": 200.0, "velocity_limit": 20.0},
        **{"offset_acceleration": 100.0, "offset_velocity": 5.0, "offset_limit": 0.01, "setpoint_delay_s": 1.5e-3},
        **_GIVEN,
    ),
}


@cache
def steps(count=1500):
    """Rows of a rough motion with rests for a model."""
    random = np.random.default_rng(0)
    v = 0.02 * np.cumsum(random.normal(size=count))
    v[random.integers(0, count, count // 10)] = 0.0
    v[count // 3 : count // 2] *= 1e-3
    load, applied = 0.1 * random.normal(size=(2, count))
    celsius = np.where(random.random(count) < 0.1, math.nan, 40.0 + 10.0 * random.normal(size=count))
    dt = np.where(np.arange(count) % 7, 1e-3, 2.6e-3)
    return np.column_stack((v, dt, 30.0 + np.cumsum(v) * 1e-3, load, celsius, applied)).tolist()


@cache
def cycles(count=3000):
    """Rows of a motion with following errors for a compensator: gaps, stale feedback, glitches, demands that go."""
    random, nan = np.random.default_rng(1), math.nan
    t = np.arange(count) * 1e-3
    demand = 0.3 * np.sin(4.4 * t) + 0.05 * np.sin(19.5 * t)
    speed = np.gradient(demand, 1e-3)
    acceleration = np.gradient(speed, 1e-3)
    error = 1e-3 * np.sin(70.0 * t) * np.exp(-(t % 0.7) / 0.2) + 7e-6 * np.cumsum(random.normal(size=count))
    position = np.round((demand + error) / 1e-4) * 1e-4
    measured = np.gradient(position, 1e-3)
    rows, cycle = [], 0
    for k in range(count):
        has_demand, is_fresh = not 1000 < k < 1700, random.random() > 0.02 and not 700 < k < 730
        torque = 0.05 * np.sign(measured[k]) + 0.01 * random.normal()
        known = demand[k] if k < 2500 else nan
        now = (known, speed[k], speed[min(k + 2, count - 1)]) if has_demand else (nan, nan, nan)
        glitch = 0.1 if random.random() < 0.002 else 0.0
        flags = float(is_fresh), float(k > 100 and not 2000 < k < 2100)
        last = acceleration[k] if has_demand else nan, 30.0 + 5.0 * math.sin(t[k]) if k % 3 else nan
        last += (0.1 * math.cos(3.0 * t[k]) if k % 5 > 2 else nan,)
        rows.append((float(cycle), position[k] + glitch, measured[k], torque, *now, *flags, *last))
        cycle += 1 if random.random() > 0.01 else int(random.integers(1, 25))
    return rows


@cache
def model_torques(name):
    """Torque of every one of the `steps` by this library."""
    names = ("position", "load_torque", "temperature", "applied_torque")
    runner = EVERY_MODEL[name].start("simulation")
    return np.array([runner.step(v, dt, **dict(zip(names, rest, strict=True))) for v, dt, *rest in steps()])


@cache
def compensations(name):
    """Compensation of every one of the `cycles` by this library."""
    each = COMPENSATORS[name]
    state = each.state.copy()
    result = np.array([each.step(*row) for row in cycles()])
    each.state[:] = state
    return result
