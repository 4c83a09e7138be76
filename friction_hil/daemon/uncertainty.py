"""Uncertainty of the compensation over the velocity, as a small table: the loop never computes it."""

from typing import TYPE_CHECKING

import numpy as np

from friction_hil.friction.uncertainty import errors_of, steady_uncertainty

if TYPE_CHECKING:
    from friction_hil.config import AxisConfig

_POINTS = 40
_SLOWEST = 1e-4  # of the largest speed
_DIGITS = 4

Table = dict[str, list[float]]
"""Speeds, ``speed``, and the standard deviation of the model's torque at each, ``forward`` and ``backward``."""


def uncertainty_table(axis: "AxisConfig") -> Table | None:
    """Return the standard deviation of a model's torque over the velocity; None if its errors are not known.

    The model file of ``axis`` has standard errors where `friction-hil identify` or `tune` wrote it.
    """
    model = axis.model.friction_model
    errors, correlations = errors_of(axis.model.fit)
    if not any(errors.get(name, 0.0) > 0.0 for name in model.free):
        return None
    speed = np.geomspace(_SLOWEST, 1.0, _POINTS) * axis.limits.velocity
    sides = (steady_uncertainty(model, sign * speed, errors, correlations) for sign in (1.0, -1.0))
    return {
        name: [float(f"{value:.{_DIGITS}g}") for value in values]
        for name, values in zip(("speed", "forward", "backward"), (speed, *sides), strict=True)
    }
