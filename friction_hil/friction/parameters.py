"""Model parameters: name, symbol, unit, bounds and meaning, and the check of given values."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from friction_hil.errors import ParameterError, choices

# Bounds of all parameters, the smaller one of those that must be above zero, because the equations divide by them: no
# product or ratio of parameters overflows.
SMALLEST, LARGEST = 1e-50, 1e50


class InvalidParameterError(ParameterError):
    """A parameter is invalid; ``parameter`` is its name, or None if several parameters are involved."""

    def __init__(self, message: str, parameter: str | None = None) -> None:
        super().__init__(message)
        self.parameter = parameter


@dataclass(frozen=True, slots=True)
class Parameter:
    """A scalar parameter of a friction model.

    ``unit`` is that of a rotary axis; on a linear axis N m becomes N and rad becomes m. ``lower`` and ``upper``
    are the bounds; None means unbounded. ``default`` is a number, the name of another parameter whose value is
    used, or None if a value must be given.
    """

    name: str
    symbol: str
    unit: str
    meaning: str
    lower: float | None = 0.0
    is_lower_allowed: bool = True
    upper: float | None = None
    is_upper_allowed: bool = True
    is_infinity_allowed: bool = False
    default: float | str | None = None

    @property
    def bounds(self) -> str:
        """Bounds as text, e.g. ``> 0``."""
        parts = []
        if self.lower is not None:
            parts.append(f"{'>=' if self.is_lower_allowed else '>'} {self.lower:g}")
        if self.upper is not None:
            parts.append(f"{'<=' if self.is_upper_allowed else '<'} {self.upper:g}")
        if self.is_infinity_allowed:
            parts.append(".inf allowed")
        return ", ".join(parts) or "any number"

    def check(self, model: str, value: object) -> float:
        """Return ``value`` as a float; an `InvalidParameterError`: it is not a number, not finite, or out of bounds."""
        return self._check(model, self.name, value)

    def _check(self, model: str, name: str, value: object) -> float:
        wanted = f"{self.meaning}, in {self.unit}, {self.bounds}"
        number = _as_number(value)
        if number is None:
            raise InvalidParameterError(f"{model}: {name} is {value!r}, not a number ({wanted})", self.name)
        is_finite = math.isfinite(number) or (self.is_infinity_allowed and number == math.inf)
        if not (is_finite and self._is_inside(number)):
            raise InvalidParameterError(f"{model}: {name} = {number:g} is not allowed ({wanted})", self.name)
        if math.isfinite(number) and abs(number) > LARGEST:
            message = f"{model}: {name} = {number:g} is not allowed: it is beyond {LARGEST:g} ({wanted})"
            raise InvalidParameterError(message, self.name)
        if self.lower == 0.0 and not self.is_lower_allowed and number < SMALLEST:
            message = f"{model}: {name} = {number:g} is not allowed: it is below {SMALLEST:g} ({wanted})"
            raise InvalidParameterError(message, self.name)
        return number

    def _is_inside(self, number: float) -> bool:
        if self.lower is not None and (number < self.lower or (number == self.lower and not self.is_lower_allowed)):
            return False
        return self.upper is None or number < self.upper or (number == self.upper and self.is_upper_allowed)


@dataclass(frozen=True, slots=True)
class NumberList(Parameter):
    """A list of ``least`` to ``most`` numbers, each within the bounds."""

    least: int = 1
    most: int = 1

    @property
    def bounds(self) -> str:
        """Bounds as text."""
        return f"a list of {self.least} to {self.most} numbers, each {super(NumberList, self).bounds}"

    def check(self, model: str, value: object) -> Any:
        """Return ``value`` as a list of floats; see `Parameter.check`."""
        elements = _as_list(value)
        if elements is None or not self.least <= len(elements) <= self.most:
            what = f"has {len(elements)} elements" if elements is not None else f"is {value!r}"
            raise InvalidParameterError(
                f"{model}: {self.name} {what} ({self.meaning}, in {self.unit}, {self.bounds})", self.name
            )
        names = self.element_names(len(elements))
        return [self._check(model, name, element) for name, element in zip(names, elements, strict=True)]

    def element_names(self, count: int) -> list[str]:
        """Return the names of the elements, e.g. ``weight[1]``."""
        return [f"{self.name}[{i}]" for i in range(count)]


@dataclass(frozen=True, slots=True)
class PointList(Parameter):
    """A list of up to ``most`` points, each a pair of finite numbers."""

    most: int = 1

    @property
    def bounds(self) -> str:
        """Bounds as text."""
        return f"a list of 1 to {self.most} pairs of numbers"

    def check(self, model: str, value: object) -> Any:
        """Return ``value`` as a list of pairs of floats; see `Parameter.check`."""
        wanted = f"{self.meaning}, in {self.unit}, {self.bounds}"
        elements = _as_list(value)
        if elements is None or not 1 <= len(elements) <= self.most:
            what = f"has {len(elements)} elements" if elements is not None else f"is {value!r}"
            raise InvalidParameterError(f"{model}: {self.name} {what} ({wanted})", self.name)
        points = []
        for i, element in enumerate(elements):
            pair = [_as_number(each) for each in _as_list(element) or ()]
            if len(pair) != 2 or any(each is None or not abs(each) <= LARGEST for each in pair):
                raise InvalidParameterError(
                    f"{model}: {self.name}[{i}] is {element!r}, not a pair of numbers up to {LARGEST:g} ({wanted})",
                    self.name,
                )
            points.append(pair)
        return points


@dataclass(frozen=True, slots=True)
class Choice(Parameter):
    """One of several ``words``."""

    words: tuple[str, ...] = ()

    @property
    def bounds(self) -> str:
        """Allowed words as text."""
        return " or ".join(self.words)

    def check(self, model: str, value: object) -> Any:
        """Return ``value``; see `Parameter.check`."""
        if value not in self.words:
            raise InvalidParameterError(
                f"{model}: {self.name} is {value!r} ({self.meaning}); {choices(str(value), self.words)}", self.name
            )
        return value


def _as_number(value: object) -> float | None:
    """Return ``value`` as a float, or None if it is not a single number that a float can represent."""
    if isinstance(value, (bool, str, bytes)) or not hasattr(value, "__float__"):
        return None
    try:
        return float(value)
    except (TypeError, ValueError, OverflowError):
        return None


def _as_list(value: object) -> list[object] | None:
    """Return ``value`` as a list, or None if it is not a sequence."""
    if isinstance(value, (str, bytes, Mapping)) or not hasattr(value, "__len__") or not hasattr(value, "__iter__"):
        return None
    return list(value)


def check_all(model: str, known: Sequence[Parameter], given: Mapping[str, object]) -> dict[str, Any]:
    """Check the ``given`` parameters of a model and fill in the defaults, in the order of ``known``.

    Raises `InvalidParameterError`: a parameter is unknown, missing or out of bounds.
    """
    by_name = {parameter.name: parameter for parameter in known}
    for name in given:
        if name not in by_name:
            raise InvalidParameterError(f"{model} has no parameter {name!r}; {choices(str(name), by_name)}", str(name))
    values: dict[str, Any] = {}
    for parameter in known:
        value = given.get(parameter.name)
        if value is None and parameter.default in values:
            # the parameter named by the default comes earlier in the table
            values[parameter.name] = values[str(parameter.default)]
            continue
        if value is None:
            value = parameter.default
        if value is None:
            raise InvalidParameterError(
                f"{model} needs {parameter.name} ({parameter.meaning}, in {parameter.unit}, "
                f"{parameter.bounds}); its parameters are {', '.join(describe_brief(p) for p in known)}",
                parameter.name,
            )
        values[parameter.name] = parameter.check(model, value)
    return values


def describe_brief(parameter: Parameter) -> str:
    """Return the name with its default, if there is one, e.g. ``static (=coulomb)``."""
    if parameter.default is None:
        return parameter.name
    default = parameter.default if isinstance(parameter.default, str) else f"{parameter.default:g}"
    return f"{parameter.name} (={default})"


def positive(parameter: Parameter) -> Parameter:
    """Return a copy of the parameter that must be above zero."""
    return replace(parameter, is_lower_allowed=False)


def defaulting(parameter: Parameter, default: float | str) -> Parameter:
    """Return a copy with a default: a number, or the name of a parameter that comes earlier in the table."""
    return replace(parameter, default=default)


COULOMB = Parameter("coulomb", "Fc", "N m", "Coulomb level: friction while sliding slowly")
STATIC = Parameter("static", "Fs", "N m", "break-away level; below coulomb it describes an axis without Stribeck hump")
VISCOUS = Parameter("viscous", "Fv", "N m s/rad", "viscous coefficient", default=0.0)
STRIBECK_VELOCITY = Parameter(
    "stribeck_velocity",
    "vs",
    "rad/s",
    "velocity over which the level falls from break-away to Coulomb",
    is_lower_allowed=False,
)
STRIBECK_EXPONENT = Parameter(
    "stribeck_exponent",
    "delta",
    "1",
    "shape of the Stribeck curve: 2 Gaussian, 1 Tustin",
    is_lower_allowed=False,
    default=2.0,
)
