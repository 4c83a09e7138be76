"""A friction model in another form: another family, or the same one with levels for each direction. Pure."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.special import lambertw

from friction_hil import friction
from friction_hil.friction import FrictionModel
from friction_hil.friction.modifiers import SIDES
from friction_hil.learning import thresholds as th

_LEVELS = ("coulomb", "static", "viscous", "sigma2")

# Families that express what the present one cannot: a static map has no presliding, Dahl and Bouc-Wen have no Stribeck
# curve, LuGre has neither memory of inner loops nor a range without drift. Those that have them need not be right, and
# LuGre is the way back. Curves that LuGre cannot follow (table, power_law, armstrong) have no alternative, and Dahl is
# none: it is a LuGre model whose levels are equal.
ALTERNATIVES = {
    "coulomb": ("lugre",),
    "stribeck": ("lugre",),
    "karnopp": ("lugre",),
    "dahl": ("lugre",),
    "bouc_wen": ("lugre",),
    "lugre": ("gms", "elasto_plastic"),
    "gms": ("lugre",),
    "elasto_plastic": ("lugre",),
}


@dataclass(frozen=True, slots=True)
class Form:
    """Form of a friction model."""

    family: str
    has_directions: bool = False  # levels of each direction

    def __str__(self) -> str:
        return f"{self.family} + direction" if self.has_directions else self.family


def form_of(model: FrictionModel) -> Form:
    """Return the form of a model."""
    return Form(model.name, "direction" in model.modifiers)


def alternatives(model: FrictionModel) -> tuple[Form, ...]:
    """Return the forms that express what the present one cannot; first, where it has none, that with directions.

    A map has no presliding, without which it cannot tell a static level: its form with directions is that of LuGre.
    """
    own = form_of(model)
    others = tuple(replace(own, family=each) for each in ALTERNATIVES.get(model.name, ()))
    if own.has_directions or "coulomb" not in model.parameters:
        return others
    base = others[0] if others and model.family.is_static else own
    return (replace(base, has_directions=True), *others)


def converted(model: FrictionModel, form: Form, *, speed: float, deflection: float) -> FrictionModel:
    """Return a model of another form that agrees with a given one as far as it can.

    Levels, Stribeck velocity and viscous friction stay, and so do all modifiers and the torque per deflection at the
    begin of a motion. A Maxwell-slip model has elements of equal weight, whose torque over the deflection is that of a
    bristle, ``static (1 - exp(-stiffness x / static))``, by pieces of straight lines.

    ``model``: without a network. ``form``: of its `alternatives`. ``speed``: top speed of the motion, rad/s or m/s.
    ``deflection``: of the bristles at break-away, rad or m, where the model has none. Raises `UsageError`: a level is
    zero.
    """
    name, modifiers = form.family, dict(model.modifiers)
    elastic = model.level / deflection  # of a map, which has none of its own
    given = dict(model.given) if name == model.name else _parameters(model.name, model.given, name, speed, elastic)
    viscous = "viscous" if name == "gms" else "sigma2"
    if name in ("lugre", "gms", "elasto_plastic") and not given.get(viscous):
        given[viscous] = th.VISCOUS_OF_LEVEL * model.level / speed
    if form.has_directions and "direction" not in modifiers:
        modifiers["direction"] = {side: {key: given[key] for key in _LEVELS if given.get(key)} for side in SIDES}
    elif "direction" in modifiers:
        modifiers["direction"] = {
            side: {
                key: value
                for key, value in _parameters(model.name, {**model.given, **own}, name, speed, elastic).items()
                if value != given[key]
            }
            for side, own in modifiers["direction"].items()
        }
    return friction.create(name, modifiers=modifiers, axis=model.axis, **given)


def _parameters(
    of: str, given: Mapping[str, Any], name: str, speed: float, elastic: float
) -> dict[str, float | list[float]]:
    """Return the parameters of a family for a model ``of`` another one."""
    plain = friction.create(of, **given)
    known = plain.parameters
    coulomb = float(known.get("coulomb", plain.level))
    static = float(known.get("static", coulomb))
    viscous = float(known.get("sigma2", known.get("viscous", 0.0)))
    stiffness = float(np.sum(known.get("sigma0", known.get("stiffness", elastic)))) * float(known.get("A", 1.0))
    stribeck_velocity = float(known.get("stribeck_velocity", th.STRIBECK_OF_SPEED * speed))
    found: dict[str, float | list[float]] = {
        "coulomb": coulomb,
        "static": static,
        "stribeck_velocity": stribeck_velocity,
    }
    if name == "gms":
        shares, weights = _elements(th.MAXWELL_ELEMENTS)
        return {
            **found,
            "viscous": viscous,
            # a bristle follows its level within level / stiffness of travel: at the Stribeck velocity with this rate
            "attraction": stiffness * stribeck_velocity,
            "stiffness": [stiffness * share for share in shares],
            "weight": weights,
        }
    found |= {
        "sigma0": stiffness,
        "sigma1": float(known.get("sigma1", 0.0)),
        "sigma2": viscous,
        "damping_velocity": float(known.get("damping_velocity", math.inf)),
    }
    return found if name == "lugre" else {**found, "breakaway_ratio": th.BREAKAWAY_RATIO}


def _elements(count: int) -> tuple[list[float], list[float]]:
    """Return shares of the stiffness and equal weights of elements that together slip like a bristle.

    With u the deflection over static / stiffness, the slope exp(-u) falls where elements slip: those that slip between
    u and u + du have the stiffness exp(-u) du and the weight u exp(-u) du. Bounds of equal weight solve
    (1 + u) exp(-u) = 1 - k / count (Lambert's W); exp(-u) between them is the stiffness.
    """
    left = 1.0 - np.arange(1, count) / count
    bounds = -1.0 - np.real(lambertw(-left / math.e, -1))
    slopes = np.concatenate([[1.0], np.exp(-bounds), [0.0]])
    return (-np.diff(slopes)).tolist(), [1.0 / count] * count
