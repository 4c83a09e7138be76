"""The compared methods to compute a feed-forward torque, each multiplied by the gain of the condition."""

import numpy as np

from friction_hil.models import FrictionModel
from friction_hil.numerics.jit import StructuredArray
from tools.benchmarks.compensation import machine
from tools.benchmarks.compensation.belief import converted

NONE, OURS = "none", "ours"
METHODS = {
    "coulomb_measured": "Coulomb and viscous friction of the measured velocity",
    "lugre_measured": "LuGre of the measured velocity",
    "true_late": "the true friction torque, with the same delay",
    OURS: "the compensator",
}
_SMOOTHING = 0.5  # of the measured velocity of the two plain methods


def feedforward(
    method: str, believed: FrictionModel, gain: float, period_s: float, resolution: float
) -> StructuredArray:
    """Return the `machine.FEEDFORWARD` record of a method.

    The methods with measured velocity use the encoder difference behind a one-pole filter, without lead and limits. The
    jump of the map at zero velocity is smoothed over two encoder steps a period.
    """
    record = np.zeros(1, machine.FEEDFORWARD)
    c = record[0]
    origins = {NONE: machine.NONE, "true_late": machine.TRUE_LATE, OURS: machine.OURS}
    c["origin"] = origins.get(method, machine.MEASURED)
    c["gain"] = gain
    c["smoothing"] = _SMOOTHING
    c["epsilon"] = 2.0 * resolution / period_s
    if method not in origins:
        model = converted(believed, method.removesuffix("_measured"))
        c["kind"], c["friction"] = model.kind, model.values
    return record
