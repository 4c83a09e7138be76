"""Models under test: every friction model, scaled to the same levels."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from friction_hil.friction import FrictionModel, create, describe

Example = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Levels:
    """Friction of an axis independently of the model, in SI units, rotary (N m, rad) or linear (N, m).

    ``top_velocity`` is the highest velocity of the experiment, at which a nonlinear law gives the same torque as the
    viscous one.
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
        """Characteristic length of presliding: Coulomb level over stiffness."""
        return self.coulomb / self.stiffness

    def curve(self, velocity: float) -> float:
        """Compute the steady friction at ``velocity`` >= 0."""
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


@dataclass(frozen=True, slots=True)
class StudySettings:
    """What the experiments are made with; the defaults are those that the explanations of the report refer to."""

    # Of the mass of experiments 1 to 8, N and m. Paths, velocities and forces of the experiments are in proportion.
    friction: Levels = REFERENCE
    # changed levels of the servo of experiment 9, N m and rad, by the names of `Levels`
    servo: Mapping[str, float] = field(default_factory=dict)
    mass: float = 1.0  # kg
    spring: float = 2.0  # stiffness in stick-slip, N/m
    pull: float = 0.1  # speed at which the spring is pulled in stick-slip, m/s
    radius: float = 1.0  # of the circle of experiment 9, rad
    frequency: float = 0.5  # of the circle of experiment 9, Hz

    @property
    def servo_levels(self) -> Levels:
        """Levels of the servo of experiment 9."""
        return replace(servo_levels(math.tau * self.frequency * self.radius), **self.servo)


def servo_levels(top_velocity: float) -> Levels:
    """Return the levels of a small servo, those of the example of ``lugre``, in N m and rad."""
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
    """Return the levels with zero viscous friction, for a compensation that keeps the damping of the axis."""
    return replace(levels, viscous=0.0)


def break_away(name: str, levels: Levels) -> float:
    """Return the force or torque at which a matched model breaks away under a slowly rising load."""
    parameters = matched(name, levels).parameters
    if "points" in parameters:
        return float(parameters["points"][0][1])
    return float(parameters.get("static_released", parameters.get("static", levels.coulomb)))


def matched(name: str, levels: Levels) -> FrictionModel:
    """Create the model ``name`` with the levels of an axis and the shape of its family's example.

    Levels, Stribeck velocity, stiffness and damping are those of the axis, as far as the model has them. The other
    parameters come from the example, scaled by the natural units of friction: the Coulomb level for forces, Coulomb
    level over stiffness for lengths, and the Stribeck velocity for velocities. Times are not scaled.
    """
    example = describe(name).example
    given = _RECIPES[name](levels, example, _own_levels(example))
    return create(name, **given)


def _own_levels(example: Example) -> Levels:
    """Return the levels of an example, with 1 for those that it does not have."""
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
    ratio = example["stick_velocity"] / own.stribeck_velocity
    return {**_stribeck(levels, example, own), "stick_velocity": ratio * levels.stribeck_velocity}


def _armstrong(levels: Levels, example: Example, own: Levels) -> dict[str, Any]:
    ratio = (example["static_released"] - own.coulomb) / (example["static_rested"] - own.coulomb)
    return {
        "coulomb": levels.coulomb,
        "viscous": levels.viscous,
        "static_released": levels.coulomb + ratio * (levels.static - levels.coulomb),
        "static_rested": levels.static,
        "stribeck_velocity": levels.stribeck_velocity,
        "lag_s": example["lag_s"],
        "rise_s": example["rise_s"],
        "stiffness": levels.stiffness,
    }


def _table(levels: Levels, example: Example, own: Levels) -> dict[str, Any]:
    """Sample the curve of the axis at about a dozen speeds, closer together where it bends."""
    slow = [factor * levels.stribeck_velocity for factor in (0.0, 0.25, 0.5, 0.75, 1.0, 1.25, 1.5, 2.0, 3.0)]
    fast = [factor * levels.top_velocity for factor in (0.25, 0.5, 1.0, 2.0, 4.0)]
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
    fraction = example["beta"] / (example["beta"] + example["gamma"])
    both = (1.0 / levels.presliding) ** exponent
    return {
        "stiffness": levels.stiffness,
        "A": 1.0,
        "beta": fraction * both,
        "gamma": (1.0 - fraction) * both,
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

DEFAULT = StudySettings()
