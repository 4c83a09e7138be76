"""Slow adaptation of the friction level to temperature and wear; off by default.

For each direction, recursive least squares with forgetting fits a factor on the model's torque F to the measured
friction torque tau - load - J dv/dt. Both sides pass the same low-pass filter, which turns dv/dt into a difference of
velocities. Only steady sliding in one direction counts, and only once the presliding of the reversal is behind: then
the friction is the model's level at this velocity, below the Stribeck velocity as above it. The factor starts at 1
with the weight of one full forgetting time, and stays between bounds.
"""

import math
from typing import Any

from friction_hil.numerics.jit import inlined

STATE = [
    ("factor", "f8", (2,)),  # learned, for positive and negative torque
    ("weight", "f8", (2,)),
    ("product", "f8", (2,)),
    ("filtered_velocity", "f8"),
    ("filtered_torque", "f8"),
    ("filtered_model", "f8"),
    ("sliding_s", "f8"),
    ("sliding_travel", "f8"),  # since then
    ("learned_s", "f8"),  # in which it has learned
]
FILTER_S = 0.02
_SETTLED = 5.0  # filter times of sliding in one direction before the fit begins
SETTLED_S = _SETTLED * FILTER_S
DEFLECTIONS = 10.0  # of the presliding, as travel before the fit begins; the softest of several elements yields last
MOVING_NOISES = 4.0  # velocity, in its own noise, that counts as sliding


def begin(r: Any, level: float) -> None:
    """Forget what was learned, before the first cycle and with another model, whose friction level is ``level``."""
    r["factor"] = 1.0
    r["weight"] = r["product"] = level**2
    r["sliding_s"] = r["sliding_travel"] = r["learned_s"] = 0.0


@inlined
def forget(r: Any) -> None:
    """Restart the filters; the factors stay."""
    r.sliding_s = r.sliding_travel = 0.0


@inlined
def learn(c: Any, r: Any, v: float, model: float, torque: float, load: float, dt: float) -> None:
    """Update the factor of the present direction with one cycle.

    ``v``: measured velocity, ``model``: friction of the model without any factor, ``torque``: actual torque of the
    drive, ``load``: load torque, all in N m.
    """
    direction = 1.0 if v > 0.0 else -1.0
    is_sliding = abs(v) >= MOVING_NOISES * c.noise
    if not is_sliding or direction * model <= 0.0 or not math.isfinite(torque):
        forget(r)
        return
    if r.sliding_s == 0.0 or direction * r.filtered_velocity < 0.0:
        r.filtered_velocity, r.filtered_torque, r.filtered_model, r.sliding_s = v, torque - load, model, 0.0
        r.sliding_travel = 0.0
    coefficient = dt / (dt + FILTER_S)
    r.filtered_torque += coefficient * (torque - load - r.filtered_torque)
    r.filtered_model += coefficient * (model - r.filtered_model)
    r.filtered_velocity += coefficient * (v - r.filtered_velocity)
    r.sliding_s += dt
    r.sliding_travel += abs(v) * dt
    if r.sliding_s < SETTLED_S or r.sliding_travel < c.sliding_travel:
        return
    r.learned_s += dt
    measured = r.filtered_torque - c.inertia * (v - r.filtered_velocity) / FILTER_S
    k = 0 if direction > 0.0 else 1
    forgetting = dt / c.adaptation_s
    r.weight[k] += forgetting * (r.filtered_model * r.filtered_model - r.weight[k])
    r.product[k] += forgetting * (r.filtered_model * measured - r.product[k])
    bound = c.adaptation_bound
    r.factor[k] = min(max(r.product[k] / r.weight[k], 1.0 - bound), 1.0 + bound)


@inlined
def factor(r: Any, torque: float) -> float:
    """Return the learned factor on a model torque of this sign."""
    return float(r.factor[0] if torque > 0.0 else r.factor[1])
