"""What is put to the test: every friction model, brought to the same levels."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from friction_hil.friction import FrictionModel, create, describe

Example = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Levels:
    """What one axis is known by, whatever the model: SI, rotary (N m, rad) or linear (N, m).

    ``top_velocity`` is the fastest motion of the experiment, where a law that is not linear meets the viscous one.
    """

    coulomb: float
    static: float
    stribeck_velocity: float
    viscous: float
    stiffness: float
    damping: float
    damping_velocity: float
    top_velocity: float

    @property
    def presliding(self) -> float:
        """Natural length of presliding: Coulomb level over stiffness."""
        return self.coulomb / self.stiffness

    def curve(self, velocity: float) -> float:
        """Steady friction at ``velocity`` >= 0."""
        fall = math.exp(-((velocity / self.stribeck_velocity) ** 2))
        return self.coulomb + (self.static - self.coulomb) * fall + self.viscous * velocity


# 1 kg on a plane: Canudas de Wit, Olsson, Astrom, Lischinsky, IEEE Transactions on Automatic Control 40(3), 1995.
REFERENCE = Levels(
    coulomb=1.0,
    static=1.5,
    stribeck_velocity=1e-3,
    viscous=0.4,
    stiffness=1e5,
    damping=math.sqrt(1e5),
    damping_velocity=math.inf,
    top_velocity=0.1,
)


def servo_levels(top_velocity: float) -> Levels:
    """Levels of a typical small servo: those of the example of ``lugre``, N m and rad."""
    example = describe("lugre").example
    return Levels(
        coulomb=example["coulomb"],
        static=example["static"],
        stribeck_velocity=example["stribeck_velocity"],
        viscous=example["sigma2"],
        stiffness=example["sigma0"],
        damping=example["sigma1"],
        damping_velocity=example["damping_velocity"],
        top_velocity=top_velocity,
    )


def without_viscous(levels: Levels) -> Levels:
    """The same axis as a compensation should know it that leaves the viscous damping to the axis."""
    return replace(levels, viscous=0.0)


def break_away(name: str, levels: Levels) -> float:
    """Force or torque at which a matched model gives way after a slow rise."""
    parameters = matched(name, levels).parameters
    if "points" in parameters:
        return float(parameters["points"][0][1])
    return float(parameters.get("static_released", parameters.get("static", levels.coulomb)))


def matched(name: str, levels: Levels) -> FrictionModel:
    """Make the model ``name`` with the shape of its family's example and the levels of an axis.

    Levels, Stribeck velocity, stiffness and damping are those of the axis as far as the model has them. What is
    left, the shape, comes from the family's example, in the natural units of friction: force in Coulomb levels,
    length in Coulomb level over stiffness, velocity in Stribeck velocities. Times in seconds stay as they are.
    """
    example = describe(name).example
    given = _RECIPES[name](levels, example, _own_levels(example))
    return create(name, **given)


def _own_levels(example: Example) -> Levels:
    """Levels that an example has, with one in place of what it lacks."""
    stiffness = example.get("sigma0", example.get("stiffness", 1.0))
    static = example.get("static", example.get("static_rested", example.get("coulomb", 1.0)))
    return Levels(
        coulomb=example.get("coulomb", 1.0),
        static=static,
        stribeck_velocity=example.get("stribeck_velocity", 1.0),
        viscous=0.0,
        stiffness=float(np.sum(stiffness)),
        damping=0.0,
        damping_velocity=math.inf,
        top_velocity=1.0,
    )


def _coulomb(levels: Levels, example: Example, own: Levels) -> dict[str, Any]:
    return {"coulomb": levels.coulomb, "viscous": levels.viscous}


def _stribeck(levels: Levels, example: Example, own: Levels) -> dict[str, Any]:
    return {
        "coulomb": levels.coulomb,
        "static": levels.static,
        "stribeck_velocity": levels.stribeck_velocity,
        "viscous": levels.viscous,
    }


def _karnopp(levels: Levels, example: Example, own: Levels) -> dict[str, Any]:
    share = example["stick_velocity"] / own.stribeck_velocity
    return {**_stribeck(levels, example, own), "stick_velocity": share * levels.stribeck_velocity}


def _armstrong(levels: Levels, example: Example, own: Levels) -> dict[str, Any]:
    share = (example["static_released"] - own.coulomb) / (example["static_rested"] - own.coulomb)
    return {
        "coulomb": levels.coulomb,
        "viscous": levels.viscous,
        "static_released": levels.coulomb + share * (levels.static - levels.coulomb),
        "static_rested": levels.static,
        "stribeck_velocity": levels.stribeck_velocity,
        "lag_s": example["lag_s"],
        "rise_s": example["rise_s"],
        "stiffness": levels.stiffness,
    }


def _table(levels: Levels, example: Example, own: Levels) -> dict[str, Any]:
    """The axis's own curve, as it would be measured: at a dozen speeds, closer where it bends."""
    slow = [share * levels.stribeck_velocity for share in (0.0, 0.25, 0.5, 0.75, 1.0, 1.25, 1.5, 2.0, 3.0)]
    fast = [share * levels.top_velocity for share in (0.25, 0.5, 1.0, 2.0, 4.0)]
    speeds = slow + [speed for speed in fast if speed > slow[-1]]
    return {"points": [[speed, levels.curve(speed)] for speed in speeds]}


def _power_law(levels: Levels, example: Example, own: Levels) -> dict[str, Any]:
    exponent = example["exponent"]
    factor = levels.viscous * levels.top_velocity ** (1.0 - exponent)
    return {"coulomb": levels.coulomb, "factor": factor, "exponent": exponent}


def _dahl(levels: Levels, example: Example, own: Levels) -> dict[str, Any]:
    return {**_coulomb(levels, example, own), "sigma0": levels.stiffness}


def _lugre(levels: Levels, example: Example, own: Levels) -> dict[str, Any]:
    return {
        "sigma0": levels.stiffness,
        "sigma1": levels.damping,
        "sigma2": levels.viscous,
        "coulomb": levels.coulomb,
        "static": levels.static,
        "stribeck_velocity": levels.stribeck_velocity,
        "damping_velocity": levels.damping_velocity,
    }


def _elasto_plastic(levels: Levels, example: Example, own: Levels) -> dict[str, Any]:
    return {**_lugre(levels, example, own), "breakaway_ratio": example["breakaway_ratio"]}


def _gms(levels: Levels, example: Example, own: Levels) -> dict[str, Any]:
    return {
        **_stribeck(levels, example, own),
        "stiffness": [levels.stiffness * each / own.stiffness for each in example["stiffness"]],
        "weight": list(example["weight"]),
        "attraction": example["attraction"] * levels.coulomb / own.coulomb,
    }


def _bouc_wen(levels: Levels, example: Example, own: Levels) -> dict[str, Any]:
    exponent = example.get("exponent", 1.0)
    share = example["beta"] / (example["beta"] + example["gamma"])
    both = (1.0 / levels.presliding) ** exponent
    return {
        "stiffness": levels.stiffness,
        "A": 1.0,
        "beta": share * both,
        "gamma": (1.0 - share) * both,
        "exponent": exponent,
        "viscous": levels.viscous,
    }


_RECIPES: dict[str, Callable[[Levels, Example, Levels], dict[str, Any]]] = {
    "armstrong": _armstrong,
    "bouc_wen": _bouc_wen,
    "coulomb": _coulomb,
    "dahl": _dahl,
    "elasto_plastic": _elasto_plastic,
    "gms": _gms,
    "karnopp": _karnopp,
    "lugre": _lugre,
    "power_law": _power_law,
    "stribeck": _stribeck,
    "table": _table,
}
