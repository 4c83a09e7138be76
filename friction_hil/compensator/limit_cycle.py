"""Limit cycles by over-compensation: seen within a second, answered with less gain, which is not given back.

An axis that gets more torque than its friction takes swings by itself: the compensation changes its sign though
the demand does not. Every such change counts, and is forgotten over half a second. A hand that moves the axis to
and fro stays below the count that is too much. While the demand moves a change counts less: an axis that sticks and
slips, as it would without compensation and worse, has some of them too.
"""

import math
from typing import Any

from friction_hil.numerics.jit import inlined

FORGETTING_S = 0.5
TOO_MANY = 6.0
_MOVING_SHARE = 0.3
STEP = 0.8  # the gain is multiplied by this
_SIGNIFICANT = 0.05  # of the model's level: smaller compensations have no sign


@inlined
def watch(c: Any, r: Any, torque: float, demand: float, dt: float) -> None:
    """Take the compensation of one cycle, N m, and the demanded velocity (NaN: none); changes ``r.reduction``."""
    r.alternations *= math.exp(-dt / FORGETTING_S)
    if math.isfinite(demand) and demand * r.demanded_sign < 0.0:
        r.compensation_sign = 0.0  # the demand turns: the compensation may
    if math.isfinite(demand) and demand != 0.0:
        r.demanded_sign = math.copysign(1.0, demand)
    if abs(torque) <= _SIGNIFICANT * c.level:
        return
    sign = math.copysign(1.0, torque)
    if sign * r.compensation_sign < 0.0:
        r.alternations += _MOVING_SHARE if math.isfinite(demand) and demand != 0.0 else 1.0
        if r.alternations > TOO_MANY:
            r.alternations = 0.0
            r.reduction *= STEP
    r.compensation_sign = sign
