"""The torque that the transmission carries, from the demanded motion: weight and inertia of the load.

It is the load of load-dependent friction, and with the load's friction it tells gap and twist of the transmission. All
of it comes from the demand: computed from the measured motion, the compensation would change what it is computed from.
Without a demand only the weight is known, at the measured position. A caller that knows the load, such as that of a
joint of an arm, gives it instead.
"""

import math
from typing import Any, TypeVar

import numpy as np

from friction_hil.numerics.jit import Array, inlined

Position = TypeVar("Position", float, Array)


def gravity_torque(constant: float, sine: float, cosine: float, position: Position) -> Position:
    """Return the torque of gravity at a position or at each of an array, positive if it opposes positive motion.

    ``sine`` and ``cosine`` are factors of those of the position, rad or m; all three are N m or N.
    """
    torque: Position = constant + sine * np.sin(position) + cosine * np.cos(position)
    return torque


_compiled_gravity_torque = inlined(gravity_torque)


@inlined
def gravity(c: Any, position: float) -> float:
    """Return the torque of gravity in the settings ``c`` of a compensator at a position, N m; see `gravity_torque`."""
    if c.gravity_sine == 0.0 and c.gravity_cosine == 0.0:
        return float(c.gravity_constant)
    return float(_compiled_gravity_torque(c.gravity_constant, c.gravity_sine, c.gravity_cosine, position))


@inlined
def weight(c: Any, position: float, given: float) -> float:
    """Return the load beside the inertia at a measured position, N m: the one that the caller gives, or `gravity`."""
    return given if math.isfinite(given) else gravity(c, position)


@inlined
def transmitted_torque(
    c: Any, reached: float, position_demand: float, velocity_ahead: float, acceleration: float, given: float
) -> float:
    """Return the torque of the load when this cycle's torque acts, N m, positive if it opposes positive motion.

    ``reached``: measured position, advanced to that moment; used where no position is demanded. ``position_demand`` is
    that of now, ``velocity_ahead`` and ``acceleration`` are demanded at that moment; NaN where unknown. ``given``: the
    load as the caller knows it, which then is all of it; NaN where it is that of the settings.
    """
    if math.isfinite(given):
        return given
    if math.isfinite(position_demand) and math.isfinite(velocity_ahead):
        reached = position_demand + c.lead_s * velocity_ahead
    held = gravity(c, reached)
    return float(held + c.load_inertia * acceleration) if math.isfinite(acceleration) else held
