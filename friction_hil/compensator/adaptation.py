"""Slow adaptation of the friction level, for what temperature and wear change; off unless asked for.

For each direction the factor that fits the model's torque F to the torque that friction is seen to take,
tau - load - J dv/dt, by recursive least squares with forgetting. Both sides go through the same low-pass, which
makes dv/dt a difference of velocities. It learns only from steady sliding in one direction, starts at 1 with the
weight of one full forgetting time, and stays between bounds.
"""

import math
from typing import Any

from friction_hil.numerics.jit import inlined

FILTER_S = 0.02
_SETTLED = 5.0  # filter times of motion in one direction until it learns
_MOVING_NOISES = 4.0  # velocity, in its own noise, that counts as sliding


@inlined
def forget(r: Any) -> None:
    """Let the filters begin anew; what was learned stays."""
    r.sliding_s = 0.0


@inlined
def learn(c: Any, r: Any, model: float, torque: float, load: float, dt: float) -> None:
    """Take one cycle.

    Parameters
    ----------
    c, r : record
        Settings and state of the compensator.
    model, torque, load : float
        The model's friction without any factor, the drive's actual torque and the load, N m.
    """
    v = r.motion.velocity
    way = 1.0 if v > 0.0 else -1.0
    if abs(v) < max(_MOVING_NOISES * c.noise, c.sliding_velocity) or way * model <= 0.0 or not math.isfinite(torque):
        r.sliding_s = 0.0
        return
    if r.sliding_s == 0.0 or way * r.filtered_velocity < 0.0:
        r.filtered_velocity, r.filtered_torque, r.filtered_model, r.sliding_s = v, torque - load, model, 0.0
    share = dt / (dt + FILTER_S)
    r.filtered_torque += share * (torque - load - r.filtered_torque)
    r.filtered_model += share * (model - r.filtered_model)
    r.filtered_velocity += share * (v - r.filtered_velocity)
    r.sliding_s += dt
    if r.sliding_s < _SETTLED * FILTER_S:
        return
    seen = r.filtered_torque - c.inertia * (v - r.filtered_velocity) / FILTER_S
    k = 0 if way > 0.0 else 1
    share = dt / c.adaptation_s
    r.weight[k] += share * (r.filtered_model * r.filtered_model - r.weight[k])
    r.product[k] += share * (r.filtered_model * seen - r.product[k])
    bound = c.adaptation_bound
    r.factor[k] = min(max(r.product[k] / r.weight[k], 1.0 - bound), 1.0 + bound)


@inlined
def factor(r: Any, torque: float) -> float:
    """What the model's torque is multiplied by."""
    return float(r.factor[0] if torque > 0.0 else r.factor[1])
