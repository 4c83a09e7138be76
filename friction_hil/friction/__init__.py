"""Friction models: equations, parameters and compiled kernels, without files or YAML.

>>> from friction_hil import friction
>>> model = friction.create("coulomb", coulomb=0.1, viscous=0.01)
>>> model.steady_state([-1.0, 0.0, 2.0])
array([-0.11,  0.  ,  0.12])
"""

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from friction_hil.errors import UsageError, choices
from friction_hil.friction.dispatch import FAMILIES
from friction_hil.friction.family import Family
from friction_hil.friction.model import Axis, FrictionModel, Runner
from friction_hil.friction.network_model import NETWORK_ALONE, Network, NetworkStructure
from friction_hil.friction.parameters import InvalidParameterError, describe_brief
from friction_hil.numerics.jit import Array

__all__ = [
    "NETWORK_ALONE",
    "Axis",
    "Family",
    "FrictionModel",
    "InvalidParameterError",
    "Network",
    "NetworkStructure",
    "Runner",
    "create",
    "describe",
    "describe_brief",
    "names",
    "simulate_many",
]


def names() -> list[str]:
    """Return the names of all models, sorted."""
    return sorted(FAMILIES)


def describe(name: str) -> Family:
    """Return formula, source, states and parameter table of a model.

    Raises
    ------
    UsageError
        No model has this name; the message lists the names that exist.
    """
    if name == NETWORK_ALONE.name:
        return NETWORK_ALONE
    try:
        return FAMILIES[name]
    except (KeyError, TypeError):
        raise UsageError(f"no friction model is called {name!r}; {choices(str(name), FAMILIES)}") from None


def create(
    name: str, /, *, modifiers: Mapping[str, Any] | None = None, axis: Axis = "rotary", **parameters: Any
) -> FrictionModel:
    """Create a model from its parameters, in SI units.

    Parameters
    ----------
    name : str
        One of `names`.
    modifiers : mapping, optional
        Modifiers by name, as in a model file: ``direction``, ``viscous``, ``load``, ``temperature``, ``ripple``.
    axis : {"rotary", "linear"}
        Unit of the order of a ripple: periods per revolution (rotary) or per metre (linear).
    **parameters
        See `describe`.

    Raises
    ------
    UsageError
        No model has this name.
    InvalidParameterError
        A parameter is unknown, missing, not finite or outside its bounds.
    """
    if name == NETWORK_ALONE.name:
        raise UsageError(
            "a network is read from the model file that 'friction-hil train' writes: use friction_hil.models.load"
        )
    return FrictionModel(describe(name), parameters, modifiers, axis)


def simulate_many(
    models: Sequence[FrictionModel], velocity: ArrayLike, dt: ArrayLike, *, workers: int = 1, **inputs: Any
) -> Array:
    """Simulate one velocity record with many models, or many parameter sets of one, on ``workers`` threads.

    Parameters
    ----------
    models : sequence of m FrictionModel
    velocity, dt, **inputs
        See `FrictionModel.simulate`.
    workers : int
        Number of threads. The compiled code releases Python's lock, so that they run in parallel.

    Returns
    -------
    (m, n) array
        Friction torque, N m.
    """
    torque = np.empty((len(models), np.size(velocity)))

    rows = iter(range(len(models)))  # shared by the workers, because models differ in cost

    def simulate(_: int = 0) -> None:
        for row in rows:
            models[row].simulate(velocity, dt, out=torque[row], **inputs)

    if workers == 1:
        simulate()
        return torque
    with ThreadPoolExecutor(workers) as pool:
        list(pool.map(simulate, range(workers)))
    return torque
