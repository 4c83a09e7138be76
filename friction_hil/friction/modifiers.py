"""Modifiers, which change the friction of any model: direction, load, temperature, position and fast motion.

Load and temperature act on the level of the model (`curves.modified`). Direction selects one of two sets of the
model's own parameters. Ripple and nonlinear viscous friction add a torque of their own.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from friction_hil.errors import choices
from friction_hil.friction.elementary import cos, sin, whole
from friction_hil.friction.family import Family, Packed
from friction_hil.friction.parameters import InvalidParameterError, Parameter, check_all
from friction_hil.numerics.jit import Array, compiled

MAX_HARMONICS = 16
_MOTORING, _DRIVEN, _REFERENCE, _COEFFICIENT, _QUADRATIC, _CUBIC, _COUNT, _HARMONICS = range(8)
_LEAST_SCALE = 0.05  # lower bound of the temperature factor, because the linear law does not hold down to zero


@compiled
def level_extra(m: Array, load_torque: float, sign: float) -> float:
    """Compute the part of the level caused by load, N m, for a motor that drives the load or is driven by it."""
    factor = m[_MOTORING] if load_torque * sign >= 0.0 else m[_DRIVEN]
    return factor * abs(load_torque)


@compiled
def level_scale(m: Array, temperature: float) -> float:
    """Compute the factor of the level at a temperature; 1 at the reference temperature and for NaN."""
    if math.isnan(temperature):
        return 1.0 + 0.0 * m[_COEFFICIENT]
    scale = 1.0 + m[_COEFFICIENT] * (temperature - m[_REFERENCE])
    return scale if scale > _LEAST_SCALE else _LEAST_SCALE + 0.0 * scale


@compiled
def fast_torque(m: Array, velocity: float) -> float:
    """Compute the nonlinear viscous torque Fv2 v abs(v) + Fv3 v^3, N m."""
    return m[_QUADRATIC] * (velocity * abs(velocity)) + m[_CUBIC] * (velocity * velocity * velocity)


@compiled
def ripple_torque(m: Array, position: float) -> float:
    """Compute the torque harmonics of position, N m: cogging, gear mesh, pitch of a ball screw."""
    torque = 0.0 * m[_QUADRATIC]
    for i in range(whole(m[_COUNT])):
        angle = m[_HARMONICS + 3 * i] * position
        torque = torque + m[_HARMONICS + 3 * i + 1] * cos(angle) + m[_HARMONICS + 3 * i + 2] * sin(angle)
    return torque


@dataclass(frozen=True, slots=True)
class Modifier:
    """Name, meaning and parameters of a modifier."""

    name: str
    summary: str
    parameters: tuple[Parameter, ...]


LOAD = Modifier(
    "load",
    "level grows with abs(load torque)",
    (
        Parameter("motoring", "", "1", "extra level per abs(load torque) while the motor drives the load", default=0.0),
        Parameter("driven", "", "1", "extra level per abs(load torque) while the load drives the motor", default=0.0),
    ),
)
TEMPERATURE = Modifier(
    "temperature",
    "levels change with temperature",
    (
        Parameter("reference", "T0", "deg C", "temperature at which the parameters hold", lower=None),
        Parameter("coefficient", "", "1/K", "relative change of the levels per kelvin", lower=None),
    ),
)
VISCOUS = Modifier(
    "viscous",
    "nonlinear viscous torque at high velocity",
    (
        Parameter("quadratic", "Fv2", "N m s^2/rad^2", "factor of v |v|", lower=None, default=0.0),
        Parameter("cubic", "Fv3", "N m s^3/rad^3", "factor of v^3", lower=None, default=0.0),
    ),
)
HARMONIC = Modifier(
    "ripple",
    "torque harmonics of position",
    (
        Parameter("order", "", "1", "periods per revolution; on a linear axis per metre", is_lower_allowed=False),
        Parameter("cosine", "", "N m", "factor of the cosine", lower=None, default=0.0),
        Parameter("sine", "", "N m", "factor of the sine", lower=None, default=0.0),
    ),
)
SIDES = ("positive", "negative")
NAMES = ("direction", "viscous", "load", "temperature", "ripple")


def check_modifiers(family: Family, given: Mapping[str, Any], modifiers: Mapping[str, Any]) -> dict[str, Any]:
    """Check the modifiers of a model and fill in their defaults.

    Parameters
    ----------
    family : Family
    given : mapping
        The model's own parameters, as given by the user.
    modifiers : mapping
        Modifiers by name, as in a model file.

    Raises
    ------
    InvalidParameterError
        A modifier is invalid; ``parameter`` is the field path, e.g. ``direction.positive.coulomb`` or
        ``ripple[0].order``.
    """
    if not isinstance(modifiers, Mapping):
        raise InvalidParameterError(f"modifiers are {modifiers!r}, not a mapping of {', '.join(NAMES)}")
    checked: dict[str, Any] = {}
    for name, content in modifiers.items():
        if name not in NAMES:
            raise InvalidParameterError(f"there is no modifier {name!r}; {choices(str(name), NAMES)}", str(name))
        if content is None:
            continue
        if name == "ripple":
            checked[name] = _check_ripple(content)
        elif name == "direction":
            checked[name] = _check_direction(family, given, content)
        else:
            modifier = {each.name: each for each in (LOAD, TEMPERATURE, VISCOUS)}[name]
            checked[name] = _check_fields(modifier, content, name)
    return checked


def _check_fields(modifier: Modifier, content: object, path: str) -> dict[str, Any]:
    if not isinstance(content, Mapping):
        known = ", ".join(parameter.name for parameter in modifier.parameters)
        raise InvalidParameterError(f"modifier {path} is {content!r}, not a mapping of {known}", path)
    try:
        return check_all(f"modifier {path}", modifier.parameters, content)
    except InvalidParameterError as error:
        raise InvalidParameterError(str(error), f"{path}.{error.parameter}") from None


def _check_ripple(content: object) -> list[dict[str, Any]]:
    if not isinstance(content, Sequence) or isinstance(content, (str, bytes)):
        raise InvalidParameterError(f"modifier ripple is {content!r}, not a list of {{order, cosine, sine}}", "ripple")
    if len(content) > MAX_HARMONICS:
        raise InvalidParameterError(
            f"modifier ripple has {len(content)} harmonics; at most {MAX_HARMONICS} are allowed", "ripple"
        )
    return [_check_fields(HARMONIC, harmonic, f"ripple[{i}]") for i, harmonic in enumerate(content)]


def _check_direction(family: Family, given: Mapping[str, Any], content: object) -> dict[str, Any]:
    if not isinstance(content, Mapping):
        raise InvalidParameterError(
            f"modifier direction is {content!r}, not a mapping of {' and '.join(SIDES)}", "direction"
        )
    sides: dict[str, Any] = {}
    for side, changes in content.items():
        path = f"direction.{side}"
        if side not in SIDES:
            raise InvalidParameterError(f"modifier direction has no side {side!r}; {choices(str(side), SIDES)}", path)
        if not isinstance(changes, Mapping):
            raise InvalidParameterError(
                f"modifier {path} is {changes!r}, not a mapping of parameters of {family.name}", path
            )
        try:
            full = check_all(family.name, family.parameters, {**given, **changes})
            family.check(full)
        except InvalidParameterError as error:
            wrong = f"{path}.{error.parameter}" if error.parameter in changes else path
            raise InvalidParameterError(f"modifier {path}: {error}", wrong) from None
        for name in changes:
            if family.states and isinstance(full[name], list) and len(full[name]) != len(given[name]):
                raise InvalidParameterError(
                    f"modifier {path}: {name} has {len(full[name])} elements, but {len(given[name])} in the other "
                    "direction; each element has one state, so the numbers must be equal",
                    f"{path}.{name}",
                )
        sides[side] = {name: full[name] for name in changes}
    return sides


def pack_modifiers(modifiers: Mapping[str, Any], angle_per_position: float) -> Packed:
    """Convert checked modifiers to the layout of the kernel.

    Parameters
    ----------
    modifiers : mapping
    angle_per_position : float
        Angle per unit of order times position, rad: 1 on a rotary axis, 2 pi on a linear one.
    """
    values: list[float] = []
    names: list[str | None] = []
    for modifier in (LOAD, TEMPERATURE, VISCOUS):
        content = modifiers.get(modifier.name)
        for parameter in modifier.parameters:
            values.append(0.0 if content is None else content[parameter.name])
            is_free = content is not None and parameter.name != "reference"
            names.append(f"{modifier.name}.{parameter.name}" if is_free else None)
    harmonics = modifiers.get("ripple", ())
    values.append(float(len(harmonics)))
    names.append(None)
    for i, harmonic in enumerate(harmonics):
        values += [harmonic["order"] * angle_per_position, harmonic["cosine"], harmonic["sine"]]
        names += [None, f"ripple[{i}].cosine", f"ripple[{i}].sine"]
    return Packed(values, names)
