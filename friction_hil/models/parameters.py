"""What a model parameter is: name, symbol, unit, bounds, meaning; and the check of given values."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from friction_hil.errors import ParameterError, choices


class InvalidParameterError(ParameterError):
    """A parameter does not fit; ``parameter`` is its name, or None where it concerns no single one."""

    def __init__(self, message: str, parameter: str | None = None) -> None:
        super().__init__(message)
        self.parameter = parameter


@dataclass(frozen=True, slots=True)
class Parameter:
    """A parameter of a friction model.

    ``unit`` is that of a rotary axis; on a linear axis N m becomes N and rad becomes m. ``default`` is a
    number, the name of the parameter whose value is taken, or None where a value must be given.
    """

    name: str
    symbol: str
    unit: str
    meaning: str
    lower: float = 0.0
    is_lower_allowed: bool = True
    is_infinity_allowed: bool = False
    default: float | str | None = None

    @property
    def bounds(self) -> str:
        """The bounds in words, e.g. ``> 0``."""
        text = f"{'>=' if self.is_lower_allowed else '>'} {self.lower:g}"
        return f"{text}, .inf allowed" if self.is_infinity_allowed else text

    def check(self, model: str, value: object) -> float:
        """Return ``value`` as a float.

        Raises
        ------
        InvalidParameterError
            It is no number, not finite, or outside the bounds.
        """
        wanted = f"{self.meaning}, in {self.unit}, {self.bounds}"
        number = _as_number(value)
        if number is None:
            raise InvalidParameterError(f"{model}: {self.name} is {value!r}, not a number ({wanted})", self.name)
        is_finite = math.isfinite(number) or (self.is_infinity_allowed and number == math.inf)
        is_inside = number > self.lower or (self.is_lower_allowed and number == self.lower)
        if not (is_finite and is_inside):
            raise InvalidParameterError(f"{model}: {self.name} = {number:g} is not allowed ({wanted})", self.name)
        return number


def _as_number(value: object) -> float | None:
    """``value`` as a float; None for what is no single number, or one that no float can hold."""
    if isinstance(value, (bool, str, bytes)) or not hasattr(value, "__float__"):
        return None
    try:
        return float(value)
    except (TypeError, ValueError, OverflowError):
        return None


def check_all(model: str, known: Sequence[Parameter], given: Mapping[str, object]) -> tuple[float, ...]:
    """Check the ``given`` values of a model's parameters and fill in defaults, in the order of ``known``.

    Raises
    ------
    InvalidParameterError
        A parameter is unknown, missing or outside its bounds.
    """
    by_name = {parameter.name: parameter for parameter in known}
    for name in given:
        if name not in by_name:
            raise InvalidParameterError(f"{model} has no parameter {name!r}; {choices(name, by_name)}", name)
    values: dict[str, float] = {}
    for parameter in known:
        value = given.get(parameter.name)
        if value is None and isinstance(parameter.default, str):
            # the parameter that the default names stands before this one in the table
            values[parameter.name] = values[parameter.default]
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
    return tuple(values.values())


def describe_brief(parameter: Parameter) -> str:
    """``static (=coulomb)``: the name, and the default where there is one."""
    if parameter.default is None:
        return parameter.name
    default = parameter.default if isinstance(parameter.default, str) else f"{parameter.default:g}"
    return f"{parameter.name} (={default})"


COULOMB = Parameter("coulomb", "Fc", "N m", "Coulomb level: friction while sliding slowly")
STATIC = Parameter("static", "Fs", "N m", "break-away level; below coulomb it describes an axis without Stribeck hump")
VISCOUS = Parameter("viscous", "Fv", "N m s/rad", "viscous coefficient", default=0.0)
STRIBECK_VELOCITY = Parameter(
    "stribeck_velocity",
    "vs",
    "rad/s",
    "velocity at which break-away has mostly given way to Coulomb friction",
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
