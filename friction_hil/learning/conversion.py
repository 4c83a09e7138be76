"""A friction model as one of another family: the same levels while sliding, the same presliding stiffness. Pure."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.special import lambertw

from friction_hil import friction
from friction_hil.friction import FrictionModel

_ELEMENTS = 4  # of a Maxwell-slip model: each further one adds a stiffness that the motion has to show
_BREAKAWAY_RATIO = 0.5
_STRIBECK = 0.05  # of the top speed: a hump that is not known is beside the speeds at which the level is

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


def converted(model: FrictionModel, name: str, *, speed: float, deflection: float) -> FrictionModel:
    """Return a model of another family that agrees with a given one as far as it can.

    Levels, Stribeck velocity and viscous friction stay, and so do all modifiers and the torque per deflection at the
    begin of a motion. A Maxwell-slip model has `_ELEMENTS` elements of equal weight, whose torque over the deflection
    is that of a bristle, ``static (1 - exp(-stiffness x / static))``, by pieces of straight lines.

    ``model``: without a network, of a family in `ALTERNATIVES`. ``name``: lugre, elasto_plastic or gms. ``speed``: top
    speed of the motion, rad/s or m/s. ``deflection``: of the bristles at break-away, rad or m, where the model has
    none. Raises `UsageError`: a level is zero.
    """
    elastic = model.level / deflection  # of a map, which has none of its own
    given = _parameters(model.name, model.given, name, speed, elastic)
    modifiers = dict(model.modifiers)
    if "direction" in modifiers:
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
    stribeck_velocity = float(known.get("stribeck_velocity", _STRIBECK * speed))
    found: dict[str, float | list[float]] = {
        "coulomb": coulomb,
        "static": static,
        "stribeck_velocity": stribeck_velocity,
    }
    if name == "gms":
        shares, weights = _elements(_ELEMENTS)
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
    return found if name == "lugre" else {**found, "breakaway_ratio": _BREAKAWAY_RATIO}


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
