"""Steady friction of a model over velocity, as it is drawn and exported."""

import numpy as np

from friction_hil.friction.model import FrictionModel
from friction_hil.numerics.jit import Array

_POINTS = 300  # on each side
_SLOWEST = 1e-4  # of the largest speed: where a curve begins beside rest
_STRIBECK_VELOCITIES = 10.0  # range of the velocity, in Stribeck velocities


def steady_curve(model: FrictionModel, fastest: float, points: int = _POINTS) -> tuple[Array, Array]:
    """Return velocity and steady torque of a model up to ``fastest``, without load; NaN at rest.

    Both are (2 points + 1,): ``points`` on each side of rest, more of them at low speed. ``fastest``: largest speed,
    rad/s or m/s.
    """
    side = np.geomspace(_SLOWEST, 1.0, points) * fastest
    velocity = np.concatenate([-side[::-1], [0.0], side])
    load = 0.0 if "load" in model.modifiers else None
    return velocity, np.where(velocity == 0.0, np.nan, model.steady_state(velocity, load_torque=load))


def velocity_range(model: FrictionModel) -> float:
    """Return the velocity up to which the steady torque shows what the model does, rad/s or m/s.

    Ten Stribeck velocities; of a table, beyond its last point; otherwise the velocity at which the torque is 1.5 times
    that in slow motion.
    """
    sides = [
        model.parameters,
        *({**model.parameters, **each} for each in model.modifiers.get("direction", {}).values()),
    ]
    if "stribeck_velocity" in model.parameters:
        return _STRIBECK_VELOCITIES * max(float(side["stribeck_velocity"]) for side in sides)
    if model.name == "table":
        fastest = max(abs(float(velocity)) for side in sides for velocity, _ in side["points"])
        return 1.1 * fastest or 1.0
    velocity = np.geomspace(1e-6, 1e4, 2001)
    torque = model.steady_state(velocity, load_torque=0.0 if model.depends_on_load else None)
    high = np.flatnonzero(torque >= 1.5 * torque[0])
    return float(velocity[high[0]]) if high.size and model.level > 0.0 else 1.0
