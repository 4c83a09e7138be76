"""Uncertainty of the steady torque of a model that follows from the errors of its parameters."""

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from friction_hil.friction import dispatch, kernel
from friction_hil.friction.arrays import require_finite, vector
from friction_hil.friction.model import FrictionModel
from friction_hil.numerics.jit import Array

_STEP = 1e-3  # of a standard error, for the derivative: within it the torque is a straight line


def steady_uncertainty(
    model: FrictionModel,
    velocity: ArrayLike,  # (n,), rad/s or m/s
    # of parameters by their names in ``model.free``; those without one count as exact
    standard_errors: Mapping[str, float],
    # two names and their correlation; other pairs count as independent
    correlations: Iterable[tuple[str, str, float]] = (),
) -> Array:
    """Compute the standard deviation of the steady torque at constant velocity, by propagation of the errors.

    Returns (n,), N m or N, without load, at the reference temperature; 0 at rest. Raises `UsageError`: a velocity is
    not finite.
    """
    v = vector("velocity", velocity)
    require_finite("velocity", v)
    names = [name for name in model.free if standard_errors.get(name, 0.0) > 0.0]
    changes = np.array([_change(model, v, name, standard_errors[name]) for name in names]).reshape(len(names), v.size)
    variance = np.sum(changes**2, axis=0)
    for one, other, correlation in correlations:
        if one in names and other in names:
            variance += 2.0 * correlation * changes[names.index(one)] * changes[names.index(other)]
    # single correlations of a matrix may contradict each other, so that a variance is negative
    return np.asarray(np.sqrt(np.maximum(variance, 0.0)))


def _change(model: FrictionModel, velocity: Array, name: str, error: float) -> Array:
    """Return the change of the torque (n,) by one standard error of a parameter, to first order."""
    torques = []
    for side in (1.0, -1.0):
        values = model.values.copy()
        for index, factor in model.places_of(name):
            values[index] += side * _STEP * error * factor
        torque = np.empty(velocity.size)
        kernel.steady_curve(dispatch.tag(model.kind), values, velocity, 0.0, np.nan, torque)
        torques.append(torque)
    return (torques[0] - torques[1]) / (2.0 * _STEP)


def errors_of(fit: Mapping[str, Any] | None) -> tuple[dict[str, float], list[tuple[str, str, float]]]:
    """Return standard errors and correlations of parameters that the provenance of a model file has.

    It is free text to everybody else: what is no number, or not finite, is left out.
    """
    fit = fit or {}
    errors, pairs = fit.get("standard_errors"), fit.get("correlations")
    found = {str(name): float(error) for name, error in _items(errors) if _is_finite(error) and error >= 0.0}
    kept = [
        (str(pair[0]), str(pair[1]), float(pair[2]))
        for pair in (pairs if isinstance(pairs, list | tuple) else ())
        if isinstance(pair, list | tuple) and len(pair) == 3 and _is_finite(pair[2]) and abs(pair[2]) <= 1.0
    ]
    return found, kept


def _items(values: Any) -> Iterable[tuple[Any, Any]]:
    return values.items() if isinstance(values, Mapping) else ()


def _is_finite(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and bool(np.isfinite(value))
