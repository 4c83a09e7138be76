"""The compared ways to come by a feed-forward torque, each times the condition's gain."""

import numpy as np

from friction_hil.models import FrictionModel
from friction_hil.numerics.jit import StructuredArray
from tools.benchmarks.compensation import machine
from tools.benchmarks.compensation.belief import converted

NONE, OURS = "none", "ours"
METHODS = {
    "coulomb_measured": "Coulomb and viscous friction of the measured velocity",
    "lugre_measured": "LuGre of the measured velocity",
    "true_late": "the true friction torque, as late as any",
    OURS: "the compensator",
}
_SMOOTHING = 0.5  # of the measured velocity that the two plain ones take


def feedforward(
    method: str, believed: FrictionModel, gain: float, period_s: float, resolution: float
) -> StructuredArray:
    """Return the `machine.FEEDFORWARD` record of a method.

    The measured ones take the encoder difference through a one-pole filter, as it comes: no lead, no limit; the
    map's jump at zero velocity is smoothed over two encoder steps a period.
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
