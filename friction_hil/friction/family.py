"""Description of a friction model before its parameters have values."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from friction_hil.friction.parameters import Parameter


@dataclass(frozen=True, slots=True)
class Packed:
    """Parameters in the layout of the kernel."""

    values: Sequence[float]  # in the kernel's order
    # name of the parameter of each value, e.g. ``weight[1]``; None: cannot be fitted, such as a count
    names: Sequence[str | None]
    factors: Sequence[float] | None = None  # by which each parameter was multiplied; None: 1


def pack_scalars(parameters: Mapping[str, Any]) -> Packed:
    """Pack parameters that are all single numbers, in the order of the mapping."""
    return Packed([float(value) for value in parameters.values()], list(parameters))


def largest_level(parameters: Mapping[str, Any]) -> float:
    """Return the larger of the Coulomb and the break-away level, N m."""
    return max(float(parameters.get(name, 0.0)) for name in ("coulomb", "static"))


def stiffness_at_rest(parameters: Mapping[str, Any]) -> float:
    """Return the stiffness of the bristles, or of all elements together."""
    return float(np.sum(parameters.get("sigma0", parameters.get("stiffness"))))


@dataclass(frozen=True, slots=True)
class Family:
    """Name, formula, source and parameter table of a friction model.

    Attributes
    ----------
    name, summary, formula, source, note : str
        The lines of `formula` are separated by a semicolon and two blanks.
    parameters : tuple of Parameter
    states : tuple of str
        Names of the states with units; empty for a static map.
    example : dict
        Parameters of a small rotary servo, as a starting point and for drawing.
    check : callable
        Takes all parameters and raises InvalidParameterError if they contradict each other.
    pack : callable
        Converts the parameters to the layout of the kernel.
    level : callable
        Takes all parameters and returns the largest torque of slow motion, N m.
    stiffness : callable
        Takes all parameters and returns the slope of torque over position at the start of motion, N m/rad; a static
        map is not asked.
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
    stiffness: Callable[[Mapping[str, Any]], float] = field(default=stiffness_at_rest, repr=False)

    @property
    def is_static(self) -> bool:
        """True if the model has no state; its torque then jumps at zero velocity."""
        return not self.states
