"""Dynamic models in two steps: the steady curve from where the axis slides, the rest from the whole experiment. Pure.

A coarse encoder loses the state of a dynamic model in the fast sweeps, and so does a family that is not quite that of
the axis. A fit of all parameters at once then bends the Stribeck curve to make up for it. The slow sweeps show that
curve without any state.
"""

import math
from collections.abc import Collection, Mapping, Sequence

import numpy as np

from friction_hil import friction as models
from friction_hil.friction import create
from friction_hil.friction.parameters import Parameter
from friction_hil.identification import Fit, Identification
from friction_hil.identification.choice import by_likelihood, choose, is_sound
from friction_hil.identification.refine import is_dynamic

_STEADY = ("stribeck", "coulomb")
_LEVELS = ("coulomb", "static", "stribeck_velocity")
_POWER = 4.0  # of the ratio of errors where the axis slides: how much a worse steady curve counts


def with_steady_curve(families: Collection[str]) -> tuple[str, ...]:
    """Return the dynamic families of these whose steady curve is that of Stribeck's model."""
    return tuple(
        family
        for family in families
        if not models.describe(family).is_static and {*_LEVELS} <= {each.name for each in _parameters(family)}
    )


def steady_curve(found: Sequence[Identification], family: str) -> Mapping[str, float]:
    """Return the parameters of a family that the slow sweeps give, by name, and the inertia.

    They are those of the Stribeck or Coulomb fit that is chosen among those without modifiers other than direction: the
    others spread over their modifiers what this family has no place for. A hump that the data determine is taken even
    if these rows are hardly predicted better with it: it is highest where the axis breaks away, in rows that do not
    count. The result is empty if there is no such fit.
    ``found``: of the rows in which the axis slides. ``family``: one of `with_steady_curve`.
    """
    fits = [
        fit
        for each in found
        for fit in each.fits
        if fit.structure.family in _STEADY and set(fit.structure.modifiers) <= {"direction"}
    ]
    if not by_likelihood(fits):
        return {}
    humps = [fit for fit in fits if fit.structure.family == "stribeck" and not fit.structure.is_flat and is_sound(fit)]
    best, _ = choose(humps if by_likelihood(humps) else fits)
    if not best.mechanics["inertia"] > 0.0:
        return {}
    viscous = "sigma2" if any(each.name == "sigma2" for each in _parameters(family)) else "viscous"
    held = {"inertia": best.mechanics["inertia"]}
    for name, value in best.values.items():
        side, dot, last = name.rpartition(".")
        if last in _LEVELS:
            held[name] = value
        elif last == "viscous":
            held[f"{side}{dot}{viscous}"] = value
    for name in list(held):
        if name.endswith("coulomb"):
            held.setdefault(name.replace("coulomb", "static"), held[name])
    return held


def _parameters(family: str) -> Sequence[Parameter]:
    return models.describe(family).parameters


def label(identification: Identification, fit: Fit) -> str:
    """Return the name of a fit for tables and messages, which says if it was fitted in two steps."""
    return f"{fit.label} in two steps" if identification.settings.held else fit.label


def steady_weights(fits: Mapping[int, Fit], found: Sequence[Identification]) -> dict[int, float]:
    """Return by how much fits are less likely, 0 to 1, because of what they predict where the axis slides.

    ``fits``: by index. ``found``: those without presliding among them have the rows in which the axis slides.
    """
    static = [each.best for each in found if not is_dynamic(each.best.structure)]
    if not static:
        return dict.fromkeys(fits, 1.0)
    curves = static[0].curves
    measured = curves.friction + curves.residual
    errors = {}
    for k, fit in fits.items():
        parameters, modifiers = fit.friction
        model = create(fit.structure.family, modifiers=modifiers, axis=fit.structure.axis, **parameters)
        left = measured - model.steady_state(curves.velocity)
        offset = fit.mechanics["offset"] - static[0].mechanics["offset"]
        errors[k] = float(np.sqrt(np.mean((left - offset) ** 2)))
    least = min(errors.values(), default=0.0)
    return {
        k: (least / error) ** _POWER if error > 0.0 and math.isfinite(error) else 0.0 for k, error in errors.items()
    }
