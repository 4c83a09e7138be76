"""Modifiers, which change the friction of any model: direction, load, temperature, position, speed and reversals.

Load and temperature act on the level of the model (`curves.modified`). Direction selects one of two sets of the
model's own parameters. The others add a torque of their own: ripple over the position, nonlinear viscous friction and
``speed`` over the velocity, ``reversal`` over the distance since the last reversal.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

from friction_hil.errors import choices
from friction_hil.friction.curves import direction
from friction_hil.friction.elementary import cos, sin, whole
from friction_hil.friction.family import Family, Packed
from friction_hil.friction.parameters import InvalidParameterError, NumberList, Parameter, check_all
from friction_hil.numerics.dual import primal
from friction_hil.numerics.jit import Array, inner

MAX_HARMONICS = 16
MAX_POINTS = 16  # of a curve
# REVERSAL and SPEED are indices of the curves, 0 for none. A curve: number of points, their abscissae, then the torques
# of positive and those of negative motion.
_MOTORING, _DRIVEN, _REFERENCE, _COEFFICIENT, _QUADRATIC, _CUBIC, _COUNT, REVERSAL, SPEED, _HARMONICS = range(10)
_SIGN, _DISTANCE, _HELD = range(3)  # of the state that `reversal_torque` uses
REVERSAL_STATES = 3
_LEAST_SCALE = 0.05  # lower bound of the temperature factor, because the linear law does not hold down to zero


@inner
def level_extra(m: Array, load_torque: float, sign: float) -> float:
    """Compute the part of the level caused by load, N m, for a motor that drives the load or is driven by it."""
    factor = m[_MOTORING] if load_torque * sign >= 0.0 else m[_DRIVEN]
    return factor * abs(load_torque)


@inner
def level_scale(m: Array, temperature: float) -> float:
    """Compute the factor of the level at a temperature; 1 at the reference temperature and for NaN."""
    if math.isnan(temperature):
        return 1.0 + 0.0 * m[_COEFFICIENT]
    scale = 1.0 + m[_COEFFICIENT] * (temperature - m[_REFERENCE])
    return scale if scale > _LEAST_SCALE else _LEAST_SCALE + 0.0 * scale


@inner
def fast_torque(m: Array, velocity: float) -> float:
    """Compute the nonlinear viscous torque Fv2 v abs(v) + Fv3 v^3, N m."""
    return m[_QUADRATIC] * (velocity * abs(velocity)) + m[_CUBIC] * (velocity * velocity * velocity)


@inner
def ripple_torque(m: Array, position: float) -> float:
    """Compute the torque harmonics of position, N m: cogging, gear mesh, pitch of a ball screw."""
    torque = 0.0 * m[_QUADRATIC]
    for i in range(whole(m[_COUNT])):
        angle = m[_HARMONICS + 3 * i] * position
        torque = torque + m[_HARMONICS + 3 * i + 1] * cos(angle) + m[_HARMONICS + 3 * i + 2] * sin(angle)
    return torque


@inner
def _on_curve(c: Array, sign: float, x: float) -> float:
    """Interpolate a curve linearly at ``x`` >= 0, N m: 0 at 0, constant beyond the last point; sign -1, 0 or 1."""
    count = whole(c[0])
    values = 1 + count if sign > 0.0 else 1 + 2 * count
    torque, before, begin = 0.0 * c[0], 0.0 * c[0], 0.0
    for i in range(count):
        end = primal(c[1 + i])
        torque = torque + (c[values + i] - before) * (min(max(x - begin, 0.0), end - begin) / (end - begin))
        before, begin = c[values + i], end
    return sign * torque


@inner
def _since_reversal(c: Array, sign: float, distance: float, held: float) -> float:
    return _on_curve(c, sign, distance) + held * max(1.0 - distance / primal(c[1]), 0.0)


@inner
def reversal_torque(c: Array, s: Array, velocity: float, dt: float) -> float:
    """Advance the distance since the last reversal, and compute the torque of the curve ``c`` there, N m.

    The torque at a reversal fades out over the distance of the first point, where that of the new direction builds up
    linearly: the torque is continuous over the path, and never beyond the largest one of the points. ``s`` holds
    direction of motion, distance since the reversal and torque at the reversal, and is changed in place; ``velocity``
    is held over the time ``dt``.
    """
    sign = direction(velocity, 0.0)
    distance, held = primal(s[_DISTANCE]), s[_HELD]
    if sign == 0.0:
        return _since_reversal(c, primal(s[_SIGN]), distance, held)
    if sign != primal(s[_SIGN]):
        held = _since_reversal(c, primal(s[_SIGN]), distance, held)
        s[_HELD] = held
        s[_SIGN] = sign
        distance = 0.0
    distance = min(distance + abs(velocity) * dt, primal(c[whole(c[0])]))
    s[_DISTANCE] = distance
    return _since_reversal(c, sign, distance, held)


@inner
def settled_torque(c: Array, sign: float) -> float:
    """Compute the torque of the curve ``c`` long after a reversal, N m."""
    return _on_curve(c, sign, primal(c[whole(c[0])]))


@inner
def speed_torque(c: Array, velocity: float) -> float:
    """Compute the torque of the curve ``c`` over the speed, N m."""
    return _on_curve(c, direction(velocity, 0.0), abs(velocity))


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


def _torques(abscissa: NumberList) -> tuple[Parameter, ...]:
    """Return the parameters of a curve."""
    positive = NumberList(
        "positive", "", "N m", "torque at each point in positive motion", lower=None, least=1, most=MAX_POINTS
    )
    negative = replace(
        positive,
        name="negative",
        meaning="the same in negative motion, where it acts in the opposite direction",
        default="positive",
    )
    return abscissa, positive, negative


_DISTANCES = NumberList(
    "distance",
    "",
    "rad",
    "distances since the last reversal, rising; 0 at 0, constant beyond the last one",
    is_lower_allowed=False,
    least=1,
    most=MAX_POINTS,
)
_VELOCITIES = replace(
    _DISTANCES,
    name="velocity",
    unit="rad/s",
    meaning="speeds, rising; 0 at 0, constant beyond the last one",
)
CURVES = (
    Modifier("reversal", "additional torque over the distance since the last reversal", _torques(_DISTANCES)),
    Modifier("speed", "additional torque over the speed", _torques(_VELOCITIES)),
)
NAMES = ("direction", "viscous", "load", "temperature", "ripple", "reversal", "speed")
_CURVES = {each.name: each for each in CURVES}
_LEAST_GAP = 1e-6  # between two points of a curve, relative: single precision tells them apart


def check_modifiers(family: Family, given: Mapping[str, Any], modifiers: Mapping[str, Any]) -> dict[str, Any]:
    """Check the modifiers of a model and fill in their defaults.

    ``given``: the model's own parameters, as given by the user. ``modifiers``: by name, as in a model file. Raises
    `InvalidParameterError`: a modifier is invalid; ``parameter`` is the field path, e.g. ``direction.positive.coulomb``
    or ``ripple[0].order``.
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
        elif name in _CURVES:
            checked[name] = _check_curve(_CURVES[name], content)
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


def _check_curve(modifier: Modifier, content: object) -> dict[str, Any]:
    name, abscissa = modifier.name, modifier.parameters[0].name
    checked = _check_fields(modifier, content, name)
    points = checked[abscissa]
    for i, (before, after) in enumerate(pairwise(points)):
        if not after >= before * (1.0 + _LEAST_GAP):
            raise InvalidParameterError(
                f"modifier {name}: {abscissa}[{i + 1}] = {after:.9g} is not above {abscissa}[{i}] = {before:.9g}; "
                "each is above the one before, by a millionth of it at least",
                f"{name}.{abscissa}",
            )
    for side in SIDES:
        if len(checked[side]) != len(points):
            raise InvalidParameterError(
                f"modifier {name}: {side} has {len(checked[side])} elements, but {abscissa} {len(points)}; "
                "there is one torque for each",
                f"{name}.{side}" if side in dict(content) else name,  # type: ignore[call-overload]
            )
        checked[side] = list(checked[side])
    return checked


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

    ``angle_per_position``: per unit of order times position, rad: 1 on a rotary axis, 2 pi on a linear one.
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
    values += [float(len(harmonics)), 0.0, 0.0]
    names += [None] * 3
    for i, harmonic in enumerate(harmonics):
        values += [harmonic["order"] * angle_per_position, harmonic["cosine"], harmonic["sine"]]
        names += [None, f"ripple[{i}].cosine", f"ripple[{i}].sine"]
    for at, modifier in zip((REVERSAL, SPEED), CURVES, strict=True):
        content = modifiers.get(modifier.name)
        if content is None:
            continue
        values[at] = float(len(values))
        points = content[modifier.parameters[0].name]
        values += [float(len(points)), *points]
        names += [None] * (1 + len(points))
        for side in SIDES:
            values += content[side]
            names += [f"{modifier.name}.{side}[{i}]" for i in range(len(points))]
    return Packed(values, names)
