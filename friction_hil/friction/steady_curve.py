"""Steady friction of a model over velocity, as it is drawn."""

import numpy as np

from friction_hil.friction.model import FrictionModel
from friction_hil.numerics.jit import Array

_POINTS = 300  # on each side
_SLOWEST = 1e-4  # of the largest speed: where a curve begins beside rest


def steady_curve(model: FrictionModel, fastest: float, points: int = _POINTS) -> tuple[Array, Array]:
    """Return velocity and steady torque of a model up to ``fastest``, without load; NaN at rest.

    Parameters
    ----------
    model : FrictionModel
    fastest : float
        Largest speed, rad/s or m/s.
    points : int
        Number of points on each side of rest, more of them at low speed.

    Returns
    -------
    velocity, torque : (2 points + 1,) arrays
    """
    side = np.geomspace(_SLOWEST, 1.0, points) * fastest
    velocity = np.concatenate([-side[::-1], [0.0], side])
    load = 0.0 if "load" in model.modifiers else None
    return velocity, np.where(velocity == 0.0, np.nan, model.steady_state(velocity, load_torque=load))
