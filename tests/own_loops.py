"""Joints of a loop of one's own: configurations, motions, and what `friction_hil.Compensator` makes of them."""

import numpy as np

import friction_hil as fh
from friction_hil.config import from_dict

PERIOD_S = 2e-3
LIMITS = {"torque": 0.12, "torque_slew": 30.0, "velocity": 20.0}
LOADED = {"load": {"motoring": 0.1, "driven": 0.05}}
FRICTION = {"model": "lugre", "parameters": dict(fh.models.describe("lugre").example), "modifiers": LOADED}
STRIBECK = {"model": "stribeck", "parameters": {"coulomb": 0.07, "static": 0.1, "stribeck_velocity": 0.2}}


def axis(friction=FRICTION, **changes):
    model = {"axis": "rotary", "friction": friction, "mechanics": {"inertia": 2e-4}}
    common = {"position_resolution": 1e-5, "limits": LIMITS, "model": model, "compensation": {"fade_s": 0.05}}
    return common | changes


def configuration(*axes, **changes):
    named = {f"j{k}": each for k, each in enumerate(axes or (axis(), axis(STRIBECK), axis()))}
    return from_dict({"version": 1, "period_s": PERIOD_S, "axes": named, **changes}, "test")


def loop(*axes, record_s=0.0, **changes):
    return fh.Compensator(configuration(*axes, **changes), record_s=record_s)


def motion(cycles, n, seed=0):
    """Positions, velocities, torques and demands of joints that swing about, each by itself, by cycles (cycles, n)."""
    random = np.random.default_rng(seed)
    rate, phase = random.uniform(3.0, 9.0, (2, n))
    t = np.arange(cycles)[:, None] * PERIOD_S
    q_des, dq_des = 0.3 * np.sin(rate * t + phase), 0.3 * rate * np.cos(rate * t + phase)
    ddq_des = -0.3 * rate**2 * np.sin(rate * t + phase)
    q = np.round((q_des + 1e-3 * np.sin(70.0 * t)) / 1e-5) * 1e-5
    tau = 0.05 * np.sign(dq_des) + 0.01 * random.normal(size=(cycles, n))
    return {"q": q, "dq": dq_des.copy(), "tau": tau, "q_des": q_des, "dq_des": dq_des, "ddq_des": ddq_des,
            "load": 0.2 * np.cos(t + phase)}  # fmt: skip


def steps(one, cycles, **given):
    """Outputs of the cycles, (cycles, n)."""
    rows = (dict(zip(given, row, strict=True)) for row in zip(*given.values(), strict=True))
    return np.array([one.step(**{"dt": PERIOD_S} | row).copy() for row, _ in zip(rows, range(cycles), strict=False)])
