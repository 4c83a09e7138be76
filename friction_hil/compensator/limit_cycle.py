"""Limit cycles by over-compensation: detected within a second, answered with a lower gain for the rest of the run.

An axis that gets more torque than its friction takes oscillates by itself: the compensation changes its sign though
the demand does not. Every such change is counted, and forgotten over half a second. A hand that moves the axis to
and fro stays below the threshold. While the demand moves, a change counts less: stick-slip, which the axis would have
without compensation too, and worse, causes some of them.
"""

import math
from typing import Any

from friction_hil.numerics.jit import inlined

STATE = [
    ("alternations", "f8"),
    ("compensation_sign", "f8"),
    ("demanded_sign", "f8"),
    ("gain_factor", "f8"),  # below 1 after limit cycles
]
FORGETTING_S = 0.5
TOO_MANY = 6.0  # changes of sign
STEP = 0.8  # factor on the gain each time
_MOVING_WEIGHT = 0.3  # of a change of sign while the demand moves
_SIGNIFICANT = 0.05  # of the model's level: smaller compensations have no sign
# the same without a demand: where a coarse encoder moves, each count is a pulse of the damping of the model's bristles
_SIGNIFICANT_GUIDED = 0.3


@inlined
def watch(c: Any, r: Any, torque: float, demand: float, dt: float) -> None:
    """Take one cycle's compensation, N m, and demanded velocity (NaN: none); lowers ``r.gain_factor``."""
    r.alternations *= math.exp(-dt / FORGETTING_S)
    if math.isfinite(demand) and demand * r.demanded_sign < 0.0:
        r.compensation_sign = 0.0  # the demand reverses, and so may the compensation
    if math.isfinite(demand) and demand != 0.0:
        r.demanded_sign = math.copysign(1.0, demand)
    if abs(torque) <= (_SIGNIFICANT if math.isfinite(demand) else _SIGNIFICANT_GUIDED) * c.level:
        return
    sign = math.copysign(1.0, torque)
    if sign * r.compensation_sign < 0.0:
        r.alternations += _MOVING_WEIGHT if math.isfinite(demand) and demand != 0.0 else 1.0
        if r.alternations > TOO_MANY:
            r.alternations = 0.0
            r.gain_factor *= STEP
    r.compensation_sign = sign
