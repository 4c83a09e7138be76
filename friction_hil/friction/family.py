"""Description of a family of friction models."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from friction_hil.friction.parameters import Parameter


@dataclass(frozen=True, slots=True)
class Packed:
    """Parameters as the kernel wants them.

    Attributes
    ----------
    values : sequence of float
        In the kernel's order.
    names : sequence of str or None
        Name of the parameter that stands in each place, e.g. ``weight[1]``; None where it is no number to be
        fitted, such as a count.
    factors : sequence of float, optional
        What each parameter was multiplied by; 1 where not given.
    """

    values: Sequence[float]
    names: Sequence[str | None]
    factors: Sequence[float] | None = None


def pack_scalars(parameters: Mapping[str, Any]) -> Packed:
    """Pack parameters that are all single numbers, in their own order."""
    return Packed([float(value) for value in parameters.values()], list(parameters))


def largest_level(parameters: Mapping[str, Any]) -> float:
    """Larger one of Coulomb and break-away level, N m."""
    return max(float(parameters.get(name, 0.0)) for name in ("coulomb", "static"))


@dataclass(frozen=True, slots=True)
class Family:
    """What is known of a model before its parameters have values.

    Attributes
    ----------
    name, summary, formula, source, note : str
        The lines of ``formula`` are separated by ``;  ``.
    parameters : tuple of Parameter
    states : tuple of str
        Names with units; none of a static map.
    example : dict
        Parameters of a small rotary servo, to start from and to draw.
    check : callable
        Takes all parameters and raises InvalidParameterError where they do not go together.
    pack : callable
        Turns parameters into what the kernel takes.
    level : callable
        Takes all parameters and returns the largest torque of slow motion, N m.
    """

    name: str
    summary: str
    formula: str
    source: str
    parameters: tuple[Parameter, ...]
    states: tuple[str, ...]
    example: Mapping[str, Any]
    note: str = ""
    check: Callable[[Mapping[str, Any]], None] = field(default=lambda _: None, repr=False)
    pack: Callable[[Mapping[str, Any]], Packed] = field(default=pack_scalars, repr=False)
    level: Callable[[Mapping[str, Any]], float] = field(default=largest_level, repr=False)

    @property
    def is_static(self) -> bool:
        """Whether the torque jumps at zero velocity and the model has no state."""
        return not self.states
