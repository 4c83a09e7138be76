"""Coordinates of the parameters that are refined: relative changes from those of the model file, all about 0."""

import math
import re
from collections.abc import Mapping
from copy import deepcopy
from dataclasses import dataclass
from typing import Any

import numpy as np

from friction_hil import friction
from friction_hil.friction import FrictionModel
from friction_hil.learning import thresholds as th
from friction_hil.numerics.jit import Array

# Exponents and weights shape a curve: the motion of a machine in service hardly tells them from its levels.
_FIXED = re.compile(r"(^|\.)(weight\[\d+\]|.*exponent|reference|order|A|interpolation|rise_s|lag_s)$")
_INDEX = re.compile(r"(.+)\[(\d+)\]$")


@dataclass(frozen=True, slots=True)
class Coordinates:
    """Parameters of a friction model as coordinates of a fit.

    A parameter with a sign is ``value exp(x)``, x being its coordinate: it keeps its sign. One with an upper bound,
    such as a share, is a logistic curve of the same slope at x = 0: it stays below. The two components of a ripple are
    ``value + amplitude x``.
    """

    model: FrictionModel  # at x = 0
    names: tuple[str, ...]  # from ``model.free``
    values: Array  # (m,) parameters at x = 0
    scales: Array  # (m,) NaN for an exponential or logistic coordinate, else the unit of a linear one
    uppers: Array  # (m,) upper bounds; infinite where there is none
    errors: Array  # (m,) standard deviations before anything was learned

    def at(self, x: Array) -> Array:
        """Return the parameters (m,) at coordinates (m,)."""
        is_linear, share = np.isfinite(self.scales), self.values / self.uppers
        growth = np.exp(np.where(share > 0.0, x / (1.0 - share), x))
        bounded = growth / (1.0 + share * (growth - 1.0)) if np.any(share > 0.0) else growth
        most = np.where(np.isfinite(self.uppers), (1.0 - th.LEAST_BELOW) * self.uppers, np.inf)
        return np.where(
            is_linear, self.values + np.nan_to_num(self.scales) * x, np.minimum(self.values * bounded, most)
        )

    def inverse(self, parameters: Mapping[str, float]) -> Array:
        """Return the coordinates (m,) of parameters by name; 0 for those that are missing or of the other sign."""
        found = np.zeros(len(self.names))
        for k, name in enumerate(self.names):
            value, unit = parameters.get(name, self.values[k]), self.scales[k]
            if math.isfinite(unit):
                found[k] = (value - self.values[k]) / unit
            elif value * self.values[k] > 0.0 and value < self.uppers[k]:
                before, after = self.values[k] / self.uppers[k], value / self.uppers[k]
                found[k] = (1.0 - before) * (
                    math.log(value / self.values[k]) - math.log1p(-after) + math.log1p(-before)
                )
        return found

    def slopes(self, x: Array) -> Array:
        """Return the derivative of each parameter with respect to its coordinate, (m,)."""
        values = self.at(x)
        bounded = values * (1.0 - values / self.uppers) / (1.0 - self.values / self.uppers)
        return np.where(np.isfinite(self.scales), self.scales, bounded)

    def named(self, x: Array) -> dict[str, float]:
        """Return the parameters at coordinates (m,) by name."""
        return dict(zip(self.names, self.at(x).tolist(), strict=True))

    def model_at(self, x: Array) -> FrictionModel:
        """Create the model at coordinates (m,); a `UsageError`: the parameters are not consistent."""
        return with_values(self.model, self.named(x))

    def simulate(self, x: Array, velocity: Array, dt: float, **inputs: Any) -> tuple[Array, Array]:
        """Return the friction torque (n,) of a motion and its derivatives with respect to the coordinates (n, m).

        ``velocity``: (n,) rad/s or m/s. ``dt``: period of sampling, s. ``inputs``: see `FrictionModel.simulate`. Raises
        `UsageError`: the parameters are not consistent.
        """
        columns = [{name: float(slope)} for name, slope in zip(self.names, self.slopes(x), strict=True)]
        return self.model_at(x).simulate_with_gradient(velocity, dt, free=columns, **inputs)


def coordinates_of(model: FrictionModel, standard_errors: Mapping[str, float]) -> Coordinates:
    """Return the coordinates of a model.

    ``model``: without a network. ``standard_errors``: absolute ones of the parameters by name, as `identify` writes
    them into a model file; parameters without one get a relative error of `th.DEFAULT_ERROR`.
    """
    names, values, scales, uppers, errors = [], [], [], [], []
    for name in model.free:
        value = value_of(model, name)
        scale = _amplitude(model, name)
        if _FIXED.search(name) or not math.isfinite(value) or (scale is None and value == 0.0) or scale == 0.0:
            continue
        given = standard_errors.get(name, math.nan)
        relative = abs(given / (value if scale is None else scale)) if math.isfinite(given) else th.DEFAULT_ERROR
        names.append(name)
        values.append(value)
        scales.append(math.nan if scale is None else scale)
        uppers.append(_upper(model, name))
        errors.append(min(max(relative, th.LEAST_ERROR), th.MOST_ERROR))
    arrays = (np.array(each) for each in (values, scales, uppers, errors))
    return Coordinates(model, tuple(names), *arrays)


def value_of(model: FrictionModel, name: str) -> float:
    """Return a parameter of a model by its name in ``model.free``; NaN if it is not a number of its own."""
    group, key = _place(name, model.parameters, model.modifiers)
    try:
        return float(group[key])
    except (KeyError, IndexError, TypeError):
        return math.nan


def with_values(model: FrictionModel, values: Mapping[str, float]) -> FrictionModel:
    """Return a model of the same family with other parameters, by their names in ``model.free``."""
    parameters = deepcopy(dict(model.given))
    modifiers = deepcopy(dict(model.modifiers))
    for name, value in values.items():
        head = name.partition("[")[0]
        if "." not in name and head not in parameters:
            parameters[head] = deepcopy(model.parameters[head])
        group, key = _place(name, parameters, modifiers)
        group[key] = value
    return friction.create(model.name, modifiers=modifiers, axis=model.axis, **parameters)


def _place(name: str, parameters: Any, modifiers: Any) -> tuple[Any, Any]:
    """Return the group that holds a parameter, and its key there."""
    head, _, rest = name.partition(".")
    group: Any = parameters if not rest else modifiers[head.partition("[")[0]]
    key: Any = rest or name
    if rest and (index := _INDEX.match(head)):
        group = group[int(index[2])]
    if head == "direction":
        side, _, key = rest.partition(".")
        group = group.setdefault(side, {})
    if index := _INDEX.match(key):
        group, key = group[index[1]], int(index[2])
        if index[1] == "points":
            group, key = group[key], 1
    return group, key


def _upper(model: FrictionModel, name: str) -> float:
    """Return the upper bound of a parameter; infinite if there is none."""
    head, _, rest = name.rpartition(".")
    if head and not head.startswith("direction"):
        return math.inf
    for parameter in model.family.parameters:
        if parameter.name == rest.partition("[")[0] and parameter.upper is not None:
            return parameter.upper
    return math.inf


def _amplitude(model: FrictionModel, name: str) -> float | None:
    """Return the amplitude of the harmonic that a parameter belongs to; None for other parameters."""
    if not name.startswith("ripple["):
        return None
    group, _ = _place(name, model.parameters, model.modifiers)
    return math.hypot(group["cosine"], group["sine"])
