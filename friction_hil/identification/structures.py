"""What is fitted of each family of friction models: which parameters, in which coordinates, from which starts.

A *structure* is a family with modifiers. Its parameters are of three kinds: those that the torque is linear in
and whose column never changes (viscous friction, ripple; they are projected out), those that are searched for,
and constants.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from friction_hil import friction as models
from friction_hil.errors import UsageError, choices
from friction_hil.friction import FrictionModel
from friction_hil.friction.model import Axis
from friction_hil.friction.modifiers import SIDES

GMS_ELEMENTS = 4
TABLE_POINTS = 6
EXTENDS = {"elasto_plastic": "lugre"}  # a family that another one is a special case of
EQUAL_IN_FEEDFORWARD = {"karnopp": "stribeck"}  # they differ in how they stick, which no recording of a drive shows

_MOST = 20.0  # times the level that the data show at low speed: the largest level that is searched
_SPRING_RATIOS = (0.2, 1.0, 3.0, 10.0)  # of the deflections at which elements of gms begin to slip


@dataclass(frozen=True, slots=True)
class Scales:
    """Sizes that the data show before any model is fitted, SI of the axis.

    Attributes
    ----------
    level, static_level : float
        Friction at low speed, and what it tends to at standstill.
    speed : float
        Top speed.
    travel : float
        Range of positions.
    deflections : tuple of float
        Presliding deflections, level over stiffness, best first.
    stribeck_velocities : tuple of float
        Best first.
    speeds : tuple of float
        Where a table gets its points.
    """

    level: float
    static_level: float
    speed: float
    travel: float
    deflections: tuple[float, ...]
    stribeck_velocities: tuple[float, ...]
    speeds: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Coordinate:
    """A number to be searched for.

    Attributes
    ----------
    names : tuple of str
        Parameters that have its value, by their names in `FrictionModel.free`; the first one names it.
    lower, upper : float
        Bounds of the parameter.
    is_log : bool
        Whether its logarithm is searched for.
    """

    names: tuple[str, ...]
    lower: float
    upper: float
    is_log: bool

    @property
    def name(self) -> str:
        """The parameter's name."""
        return self.names[0]

    def inner(self, value: float) -> float:
        """Coordinate of a parameter's value, inside the bounds."""
        value = min(max(value, self.lower), self.upper)
        return math.log(value) if self.is_log else value

    def outer(self, coordinate: float) -> float:
        """Parameter's value."""
        return math.exp(coordinate) if self.is_log else coordinate

    @property
    def bounds(self) -> tuple[float, float]:
        """Bounds of the coordinate."""
        return self.inner(self.lower), self.inner(self.upper)


@dataclass(frozen=True, slots=True)
class Structure:
    """A family with modifiers, and what is to be found of it.

    Attributes
    ----------
    family : str
        Name in the registry.
    coordinates : tuple of Coordinate
        What is searched for.
    linear : dict
        Keys of `data.linear_column` by the names of parameters.
    constants : dict
        Parameters that are held, by name.
    modifiers : tuple of str
        Names of the modifiers.
    axis : str
    without : tuple of str
        Parameters held at zero because the data do not show them.
    """

    family: str
    coordinates: tuple[Coordinate, ...]
    linear: Mapping[str, str]
    constants: Mapping[str, Any] = field(default_factory=dict)
    modifiers: tuple[str, ...] = ()
    axis: Axis = "rotary"
    without: tuple[str, ...] = ()

    @property
    def label(self) -> str:
        """Name for people: ``lugre``, ``lugre + direction``."""
        own = f"{self.family} ({', '.join(self.without)} = 0)" if self.without else self.family
        return " + ".join([own, *self.modifiers])

    @property
    def names(self) -> tuple[str, ...]:
        """All parameters that are looked for."""
        return (*(each.name for each in self.coordinates), *self.linear)

    def values(self, coordinates: Any) -> dict[str, float]:
        """Parameters of coordinates, tied ones included."""
        found: dict[str, float] = {}
        for each, coordinate in zip(self.coordinates, coordinates, strict=True):
            found.update(dict.fromkeys(each.names, each.outer(float(coordinate))))
        return found

    def model(self, values: Mapping[str, float]) -> FrictionModel:
        """Make the model with these values besides the constants; what is not named is left out.

        Raises
        ------
        InvalidParameterError
            They do not go together.
        """
        parameters, modifiers = nested({**self.constants, **values})
        return models.create(self.family, modifiers=modifiers, axis=self.axis, **parameters)

    def hold(self, name: str, value: float) -> "Structure":
        """The structure with one of its parameters held."""
        if name in self.linear:
            linear = {each: key for each, key in self.linear.items() if each != name}
            return replace(self, linear=linear, constants={**self.constants, name: value})
        kept, held = [], dict(self.constants)
        for each in self.coordinates:
            if each.name == name:
                held.update(dict.fromkeys(each.names, value))
            elif name in each.names:  # held apart from the parameter that it was tied to
                kept.append(replace(each, names=tuple(tied for tied in each.names if tied != name)))
                held[name] = value
            else:
                kept.append(each)
        return replace(self, coordinates=tuple(kept), constants={**held, name: value})

    def drop(self, names: Sequence[str]) -> "Structure":
        """The structure with some of its parameters held at 0; a modifier whose only parameter is one goes with it."""
        structure = self
        for name in names:
            structure = structure.hold(name, 0.0)
        gone = {name.partition(".")[0] for name in names if "." in name}
        constants = {name: x for name, x in structure.constants.items() if name.partition(".")[0] not in gone}
        modifiers = tuple(name for name in structure.modifiers if name not in gone)
        kept = tuple(name for name in names if "." not in name)
        return replace(structure, constants=constants, modifiers=modifiers, without=kept)


def nested(values: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Turn ``direction.positive.coulomb`` and ``stiffness[0]`` into the parameters and modifiers of a model file."""
    parameters: dict[str, Any] = {}
    modifiers: dict[str, Any] = {}
    sides: dict[str, dict[str, Any]] = {}
    for name, value in values.items():
        head, _, rest = name.partition(".")
        if head == "direction":
            side, _, inner = rest.partition(".")
            sides.setdefault(side, {})[inner] = value
        elif head.startswith("ripple["):
            harmonics = modifiers.setdefault("ripple", [])
            number = int(head[len("ripple[") : -1])
            harmonics += [{} for _ in range(number + 1 - len(harmonics))]
            harmonics[number][rest] = value
        elif rest:
            modifiers.setdefault(head, {})[rest] = value
        elif name.endswith("]"):
            head, _, number_text = name[:-1].partition("[")
            parameters.setdefault(head, {})[int(number_text)] = value
        else:
            parameters[name] = value
    for head, content in parameters.items():
        if isinstance(content, dict):
            parameters[head] = [content[number] for number in sorted(content)]
    if "points" in parameters:
        parameters["points"] = [
            [speed, torque] for speed, torque in zip(parameters.pop("speeds"), parameters["points"], strict=True)
        ]
    if sides:
        modifiers["direction"] = sides
        for inner in sides.get("positive", {}):  # the model's own value is that of neither side: their mean
            parameters[inner] = sum(sides[side][inner] for side in SIDES) / len(SIDES)
    return parameters, modifiers


@dataclass(frozen=True, slots=True)
class _Recipe:
    """How to fit a family: levels (that differ between directions), other parameters, name of the viscous one."""

    levels: tuple[str, ...]
    others: tuple[str, ...] = ()
    viscous: str | None = "viscous"
    constants: Mapping[str, Any] = field(default_factory=dict)
    tied: Mapping[str, str] = field(default_factory=dict)
    is_directed: bool = True


_BRISTLES = ("sigma0", "sigma1", "stribeck_velocity")
_RECIPES = {
    "coulomb": _Recipe(("coulomb",)),
    "stribeck": _Recipe(("coulomb", "static"), ("stribeck_velocity",), constants={"stribeck_exponent": 2.0}),
    "armstrong": _Recipe(
        ("coulomb", "static_released", "static_rested"), ("stribeck_velocity", "lag_s", "rise_s", "stiffness")
    ),
    "table": _Recipe((), viscous=None, constants={"interpolation": "linear"}),
    "power_law": _Recipe(("coulomb", "factor"), ("exponent",), viscous=None),
    "dahl": _Recipe(("coulomb",), ("sigma0",), constants={"exponent": 1.0}),
    "lugre": _Recipe(("coulomb", "static"), _BRISTLES, "sigma2", tied={"damping_velocity": "stribeck_velocity"}),
    "elasto_plastic": _Recipe(
        ("coulomb", "static"),
        (*_BRISTLES, "breakaway_ratio"),
        "sigma2",
        tied={"damping_velocity": "stribeck_velocity"},
    ),
    "gms": _Recipe(
        ("coulomb", "static"),
        ("attraction", "stribeck_velocity", *(f"stiffness[{i}]" for i in range(GMS_ELEMENTS))),
        constants={f"weight[{i}]": 1.0 / GMS_ELEMENTS for i in range(GMS_ELEMENTS)},
    ),
    "bouc_wen": _Recipe(("beta",), ("stiffness", "gamma", "exponent"), constants={"A": 1.0}),
}


def families() -> tuple[str, ...]:
    """Names of the families that a recording can tell apart."""
    return tuple(_RECIPES)


def build(family: str, scales: Scales, axis: Axis, period_s: float, *, is_directed: bool) -> Structure:
    """Structure of a family, plain or with parameters of its own for each direction.

    Raises
    ------
    UsageError
        No such family can be fitted.
    """
    try:
        recipe = _RECIPES[EQUAL_IN_FEEDFORWARD.get(family, family)]
    except KeyError:
        raise UsageError(f"no friction model {family!r} can be identified; {choices(family, _all())}") from None
    constants = dict(recipe.constants)
    linear: dict[str, str] = {}
    if family == "karnopp":
        constants["stick_velocity"] = 1e-3 * scales.speed
    if family == "table":
        return _table(scales, axis, constants, is_directed)
    if recipe.viscous and is_directed:
        linear = {f"direction.{side}.{recipe.viscous}": f"viscous.{side}" for side in SIDES}
    elif recipe.viscous:
        linear = {recipe.viscous: "viscous"}
    coordinates = []
    known = {parameter.name: parameter for parameter in models.describe(family).parameters}
    for name in (*recipe.levels, *recipe.others):
        lower, upper, is_log = _range(name, scales, period_s)
        allowed = known[name.partition("[")[0]]
        lower = lower if allowed.lower is None else max(lower, allowed.lower)
        upper = upper if allowed.upper is None else min(upper, allowed.upper)
        owners = [f"direction.{side}.{name}" for side in SIDES] if is_directed and name in recipe.levels else [name]
        ties = [tied for tied, source in recipe.tied.items() if source == name]
        coordinates += [Coordinate((owner, *ties), lower, upper, is_log) for owner in owners]
    return Structure(family, tuple(coordinates), linear, constants, ("direction",) if is_directed else (), axis)


def _all() -> tuple[str, ...]:
    return (*_RECIPES, *EQUAL_IN_FEEDFORWARD)


def _table(scales: Scales, axis: Axis, constants: dict[str, Any], is_directed: bool) -> Structure:
    speeds = [*scales.speeds, *(-speed for speed in scales.speeds)] if is_directed else list(scales.speeds)
    high = 1e3 * scales.level
    coordinates = tuple(
        Coordinate((f"points[{i}]",), *((0.0, high) if speed > 0.0 else (-high, 0.0)), False)
        for i, speed in enumerate(speeds)
    )
    modifiers = ("direction",) if is_directed else ()
    return Structure("table", coordinates, {}, {**constants, "speeds": speeds}, modifiers, axis)


def _range(name: str, scales: Scales, period_s: float) -> tuple[float, float, bool]:
    """Lower and upper bound of a parameter, and whether its logarithm is searched for."""
    level, speed = scales.level, scales.speed
    shortest, longest = 1e-7 * scales.travel, 10.0 * scales.travel  # deflections
    simple = {
        "coulomb": (1e-6 * level, _MOST * level, False),
        "static": (1e-6 * level, _MOST * level, False),
        "static_released": (1e-6 * level, _MOST * level, False),
        "static_rested": (1e-6 * level, _MOST * level, False),
        "factor": (0.0, 1e6 * level, False),
        "stribeck_velocity": (1e-4 * speed, 3.0 * speed, True),
        "sigma0": (level / longest, level / shortest, True),
        "sigma1": (1e-4 * level / speed, 1e4 * level / speed, True),
        "stiffness": (level / longest, level / shortest, True),
        "breakaway_ratio": (0.02, 0.98, False),
        "attraction": (1e-2 * level, 1e3 * level * speed / (1e-3 * scales.travel), True),
        "lag_s": (1e-2 * period_s, 0.1, True),
        "rise_s": (1e-3, 1e3, True),
        "beta": (1e-3 / longest, 1e3 / shortest, True),
        "gamma": (-1e3 / shortest, 1e3 / shortest, False),
        "exponent": (0.1, 4.0, True),
    }
    return simple[name.partition("[")[0]]


def starts(structure: Structure, scales: Scales, seed: int, further: int) -> Iterator[dict[str, float]]:
    """Values from which to search: the scales that the data show, then ``further`` random ones about them."""
    pairs = [(x, v) for v in scales.stribeck_velocities for x in scales.deflections]
    for deflection, velocity in pairs:
        yield _start(structure, scales, deflection, velocity)
    random = np.random.default_rng(seed)
    for _ in range(further):
        deflection, velocity = (scale * float(np.exp(random.normal())) for scale in pairs[0])
        values = _start(structure, scales, deflection, velocity)
        for name in values:  # a hump of any height and a damping of any size, whatever the scan has seen
            if "static" in name:
                values[name] = scales.level * float(np.exp(0.5 * abs(random.normal())))
            elif name == "sigma1":
                values[name] *= float(np.exp(2.0 * abs(random.normal())))
        yield values


def _start(structure: Structure, scales: Scales, deflection: float, velocity: float) -> dict[str, float]:
    level = scales.level
    known = {
        "coulomb": level,
        "static": scales.static_level,
        "static_released": scales.static_level,
        "static_rested": scales.static_level,
        "factor": 0.1 * level / math.sqrt(scales.speed),
        "stribeck_velocity": velocity,
        "sigma0": level / deflection,
        "sigma1": 0.1 * level / scales.speed,
        "breakaway_ratio": 0.5,
        "attraction": 0.1 * level * scales.speed / deflection,
        "lag_s": 5e-3,
        "rise_s": 1.0,
        "beta": 0.6 / deflection,
        "gamma": 0.4 / deflection,
        "exponent": 0.5 if structure.family == "power_law" else 1.2,
        "stiffness": level / deflection,
        "motoring": 0.05,
        "driven": 0.05,
        "coefficient": 0.0,
    }
    values = {}
    for each in structure.coordinates:
        name = each.name.rpartition(".")[2]
        if name.startswith("points["):
            values[each.name] = math.copysign(level, each.upper + each.lower)
        elif name.startswith("stiffness["):
            ratio = _SPRING_RATIOS[int(name[len("stiffness[") : -1])]
            values[each.name] = level / GMS_ELEMENTS / (ratio * deflection)
        else:
            values[each.name] = known[name]
    return values
