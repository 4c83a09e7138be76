"""Friction models: the registry.

>>> import friction_hil as fh
>>> model = fh.models.create("coulomb", coulomb=0.1, viscous=0.01)
>>> model.steady_state([-1.0, 0.0, 2.0])
array([-0.11,  0.  ,  0.12])
"""

from pathlib import Path

from friction_hil.errors import UsageError, choices
from friction_hil.models.family import Family
from friction_hil.models.kernel import FAMILIES
from friction_hil.models.model import FrictionModel, Runner
from friction_hil.models.parameters import InvalidParameterError, check_all, describe_brief

__all__ = [
    "Family",
    "FrictionModel",
    "InvalidParameterError",
    "Runner",
    "create",
    "describe",
    "describe_brief",
    "load",
    "names",
]


def names() -> list[str]:
    """Names of all models, sorted."""
    return sorted(FAMILIES)


def describe(name: str) -> Family:
    """Formula, source, states and parameter table of a model.

    Raises
    ------
    UsageError
        No model has that name; the message lists those that exist.
    """
    try:
        return FAMILIES[name]
    except KeyError:
        raise UsageError(f"no friction model is called {name!r}; {choices(name, FAMILIES)}") from None


def create(name: str, /, **parameters: float) -> FrictionModel:
    """Make a model from the values of its parameters, SI.

    Raises
    ------
    UsageError
        No model has that name.
    InvalidParameterError
        A parameter is unknown, missing, not finite or outside its bounds.
    """
    family = describe(name)
    values = check_all(name, family.parameters, parameters)
    return FrictionModel(family, {p.name: value for p, value in zip(family.parameters, values, strict=True)})


def load(path: str | Path) -> FrictionModel:
    """Read the friction model of a model file (YAML).

    Raises
    ------
    ConfigurationError
        The file cannot be read or has mistakes; the message has each with its line.
    """
    from friction_hil.config import load_model_file

    return load_model_file(path).friction_model
