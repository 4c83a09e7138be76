"""Model structures: the fitted parameters of each family of friction models, their coordinates, bounds and starts.

A *model structure* is a family with modifiers. Its parameters are of three kinds: linear ones, whose column of the
regression is constant (viscous friction, ripple; they are projected out), nonlinear ones, which are searched for, and
constants.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np

from friction_hil import friction as models
from friction_hil.errors import RecordingError, UsageError, choices
from friction_hil.friction import FrictionModel
from friction_hil.friction.model import Axis
from friction_hil.friction.modifiers import SIDES
from friction_hil.identification import thresholds as th
from friction_hil.identification.least_squares import FitError

GMS_ELEMENTS = 4
TABLE_POINTS = 6
EXTENDS = {"elasto_plastic": "lugre"}  # families and the special case that each extends
EQUAL_IN_FEEDFORWARD = {"karnopp": "stribeck"}  # they differ while sticking, which no recording of a drive shows


@dataclass(frozen=True, slots=True)
class InitialScales:
    """Scales of friction estimated before any model is fitted, SI of the axis. All are finite and above zero.

    Raises `RecordingError`: a scale is zero, below zero or not finite: the searches begin there, and their bounds are
    multiples of it.
    """

    level: float  # friction at low speed
    static_level: float  # limit of that friction towards standstill
    speed: float  # top speed
    travel: float  # range of positions
    deflections: tuple[float, ...]  # in presliding (level over stiffness), best first
    stribeck_velocities: tuple[float, ...]  # best first
    speeds: tuple[float, ...]  # of the points of a table
    least_sliding_speed: float  # below which the axis slides, past presliding, for a small part of the time only
    largest: float  # largest friction that was measured

    def __post_init__(self) -> None:
        for each in fields(self):
            if not np.all((np.asarray(getattr(self, each.name)) > 0.0) & np.isfinite(getattr(self, each.name))):
                raise RecordingError(
                    f"the recording gives no scale to begin a search from: {each.name.replace('_', ' ')} is "
                    f"{getattr(self, each.name)}, but must be finite and above zero"
                )


@dataclass(frozen=True, slots=True)
class Coordinate:
    """One coordinate of the nonlinear search.

    Raises `FitError`: the bounds are not finite or not ordered, or one of a logarithm is not above zero.
    """

    # parameters with this value, by their names in `FrictionModel.free`; the first one names the coordinate
    names: tuple[str, ...]
    lower: float  # bounds of the parameter itself
    upper: float
    is_log: bool  # the logarithm of the parameter is searched for

    def __post_init__(self) -> None:
        is_ordered = -math.inf < self.lower <= self.upper < math.inf
        if not is_ordered or (self.is_log and self.lower <= 0.0):
            kind = "finite, ordered and above zero" if self.is_log else "finite and ordered"
            raise FitError(f"the bounds of {self.name} are {self.lower:g} to {self.upper:g}, but must be {kind}")

    @property
    def name(self) -> str:
        """Name of the parameter."""
        return self.names[0]

    def inner(self, value: float) -> float:
        """Return the coordinate of a parameter's value, clipped to the bounds."""
        value = min(max(value, self.lower), self.upper)
        return math.log(value) if self.is_log else value

    def outer(self, coordinate: float) -> float:
        """Return the parameter's value at a coordinate."""
        return math.exp(coordinate) if self.is_log else coordinate

    @property
    def bounds(self) -> tuple[float, float]:
        """Bounds of the coordinate."""
        return self.inner(self.lower), self.inner(self.upper)


@dataclass(frozen=True, slots=True)
class ModelStructure:
    """A family of friction models with modifiers, and its parameters to identify."""

    family: str  # name in the registry
    coordinates: tuple[Coordinate, ...]  # nonlinear parameters
    linear: Mapping[str, str]  # keys of `data.linear_column` by parameter name
    constants: Mapping[str, Any] = field(default_factory=dict)  # held parameters by name
    modifiers: tuple[str, ...] = ()
    axis: Axis = "rotary"
    without: tuple[str, ...] = ()  # parameters held at zero because the data do not excite them
    # the static levels are equal to the Coulomb level, because the data do not show the difference
    is_flat: bool = False

    @property
    def label(self) -> str:
        """Name for tables and messages: ``lugre``, ``lugre + direction``."""
        held = ["static = coulomb"] if self.is_flat else []
        held += [f"{', '.join(self.without)} = 0"] if self.without else []
        own = f"{self.family} ({'; '.join(held)})" if held else self.family
        return " + ".join([own, *self.modifiers])

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all parameters to identify."""
        return (*(each.name for each in self.coordinates), *self.linear)

    def values(self, coordinates: Any) -> dict[str, float]:
        """Return the nonlinear parameters at given coordinates, tied ones included."""
        found: dict[str, float] = {}
        for each, coordinate in zip(self.coordinates, coordinates, strict=True):
            found.update(dict.fromkeys(each.names, each.outer(float(coordinate))))
        return found

    def is_admissible(self, values: Mapping[str, float]) -> bool:
        """Return False if the search must not go there: a Bouc-Wen loop that releases energy grows without bound.

        Source: F. Ikhouane, J. Rodellar, Systems with Hysteresis, 2007, chapter 2.
        """
        if "gamma" not in values:
            return True
        betas = [value for name, value in values.items() if name.rpartition(".")[2] == "beta"]
        return all(abs(values["gamma"]) <= beta for beta in betas)

    def model(self, values: Mapping[str, float]) -> FrictionModel:
        """Create the model with these values and the constants; unnamed parameters take their defaults.

        Raises `InvalidParameterError`: the values are inconsistent.
        """
        parameters, modifiers = nested({**self.constants, **values})
        return models.create(self.family, modifiers=modifiers, axis=self.axis, **parameters)

    def hold(self, name: str, value: float) -> "ModelStructure":
        """Return the structure with one of its parameters held."""
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

    def drop(self, names: Sequence[str]) -> "ModelStructure":
        """Return the structure with some parameters held at 0; their modifiers, if any, are removed."""
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
    """Parameters of a family: levels (different for each direction), others, and the name of the viscous one."""

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
    """Return the names of the families that a recording can tell apart."""
    return tuple(_RECIPES)


def build(family: str, scales: InitialScales, axis: Axis, period_s: float, *, is_directed: bool) -> ModelStructure:
    """Return the structure of a family, with one set of parameters or one for each direction.

    Raises `UsageError`: the family is unknown or cannot be fitted.
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
    return ModelStructure(family, tuple(coordinates), linear, constants, ("direction",) if is_directed else (), axis)


def directed(structure: ModelStructure) -> ModelStructure:
    """Return a structure of one set of levels with levels and viscous friction of their own for each direction.

    Levels that are held stay common to both directions.
    """
    recipe = _RECIPES[EQUAL_IN_FEEDFORWARD.get(structure.family, structure.family)]
    coordinates: list[Coordinate] = []
    for each in structure.coordinates:
        if each.name in recipe.levels:
            coordinates += [
                replace(each, names=tuple(f"direction.{side}.{name}" for name in each.names)) for side in SIDES
            ]
        else:
            coordinates.append(each)
    linear: dict[str, str] = {}
    for name, key in structure.linear.items():
        if name == recipe.viscous:
            linear |= {f"direction.{side}.{name}": f"{key}.{side}" for side in SIDES}
        else:
            linear[name] = key
    return replace(
        structure,
        coordinates=tuple(coordinates),
        linear=linear,
        modifiers=("direction", *structure.modifiers),
    )


def _all() -> tuple[str, ...]:
    return (*_RECIPES, *EQUAL_IN_FEEDFORWARD)


def _table(scales: InitialScales, axis: Axis, constants: dict[str, Any], is_directed: bool) -> ModelStructure:
    speeds = [*scales.speeds, *(-speed for speed in scales.speeds)] if is_directed else list(scales.speeds)
    high = _highest_level(scales)
    coordinates = tuple(
        Coordinate((f"points[{i}]",), *((0.0, high) if speed > 0.0 else (-high, 0.0)), False)
        for i, speed in enumerate(speeds)
    )
    modifiers = ("direction",) if is_directed else ()
    return ModelStructure("table", coordinates, {}, {**constants, "speeds": speeds}, modifiers, axis)


def _highest_level(scales: InitialScales) -> float:
    """Return the largest friction torque that is searched for: hardly more than the largest one that was measured."""
    return max(th.MOST_LEVEL * scales.largest, 2.0 * scales.level)


def _range(name: str, scales: InitialScales, period_s: float) -> tuple[float, float, bool]:
    """Return the lower and upper bound of a parameter, and True if its logarithm is searched for."""
    level, speed = scales.level, scales.speed
    shortest, longest = 1e-7 * scales.travel, 10.0 * scales.travel  # deflections
    deflection = min(scales.deflections)
    most = _highest_level(scales)
    simple = {
        "coulomb": (1e-6 * level, most, False),
        "static": (1e-6 * level, most, False),
        "static_released": (1e-6 * level, most, False),
        "static_rested": (1e-6 * level, most, False),
        "factor": (0.0, 1e6 * level, False),
        "stribeck_velocity": (th.NARROWEST * min(scales.least_sliding_speed, speed), 3.0 * speed, True),
        "sigma0": (level / longest, level / shortest, True),
        "sigma1": (1e-4 * level / speed, 1e4 * level / speed, True),
        "stiffness": (level / longest, level / shortest, True),
        "breakaway_ratio": (0.02, 0.98, False),
        "attraction": (1e-2 * level, 1e3 * level * speed / (1e-3 * scales.travel), True),
        "lag_s": (1e-2 * period_s, 0.1, True),
        "rise_s": (1e-3, 1e3, True),
        "beta": (1e-3 / longest, th.STEEPEST / deflection, True),
        "gamma": (-th.STEEPEST / deflection, th.STEEPEST / deflection, False),
        "exponent": (0.1, 4.0, True),
    }
    return simple[name.partition("[")[0]]


def starts(structure: ModelStructure, scales: InitialScales, seed: int, further: int) -> Iterator[dict[str, float]]:
    """Yield start values: those that the scales of the data suggest, then ``further`` random ones about them."""
    pairs = [(x, v) for v in scales.stribeck_velocities for x in scales.deflections]
    for deflection, velocity in pairs:
        yield _start(structure, scales, deflection, velocity)
    random = np.random.default_rng(seed)
    for _ in range(further):
        deflection, velocity = (scale * float(np.exp(random.normal())) for scale in pairs[0])
        values = _start(structure, scales, deflection, velocity)
        for name in values:  # the scales say little of the hump's height and of the damping: draw them widely
            if "static" in name:
                values[name] = scales.level * float(np.exp(0.5 * abs(random.normal())))
            elif name == "sigma1":
                values[name] *= float(np.exp(2.0 * abs(random.normal())))
        yield values


def _start(structure: ModelStructure, scales: InitialScales, deflection: float, velocity: float) -> dict[str, float]:
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
            ratio = th.SPRING_RATIOS[int(name[len("stiffness[") : -1])]
            values[each.name] = level / GMS_ELEMENTS / (ratio * deflection)
        else:
            values[each.name] = known[name]
    return values
