"""The equations of friction: every model with its parameters, pure and compiled.

>>> from friction_hil import friction
>>> model = friction.create("coulomb", coulomb=0.1, viscous=0.01)
>>> model.steady_state([-1.0, 0.0, 2.0])
array([-0.11,  0.  ,  0.12])
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from friction_hil.errors import UsageError, choices
from friction_hil.friction.dispatch import FAMILIES
from friction_hil.friction.family import Family
from friction_hil.friction.model import Axis, FrictionModel, Runner
from friction_hil.friction.network_model import NETWORK_ALONE, Network, Structure
from friction_hil.friction.parameters import InvalidParameterError, describe_brief
from friction_hil.numerics.jit import Array

__all__ = [
    "NETWORK_ALONE",
    "Axis",
    "Family",
    "FrictionModel",
    "InvalidParameterError",
    "Network",
    "Runner",
    "Structure",
    "create",
    "describe",
    "describe_brief",
    "names",
    "simulate_many",
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
    if name == NETWORK_ALONE.name:
        return NETWORK_ALONE
    try:
        return FAMILIES[name]
    except (KeyError, TypeError):
        raise UsageError(f"no friction model is called {name!r}; {choices(str(name), FAMILIES)}") from None


def create(
    name: str, /, *, modifiers: Mapping[str, Any] | None = None, axis: Axis = "rotary", **parameters: Any
) -> FrictionModel:
    """Make a model from the values of its parameters, SI.

    Parameters
    ----------
    name : str
        One of `names`.
    modifiers : mapping, optional
        What changes the model's friction, as in a model file: ``direction``, ``viscous``, ``load``,
        ``temperature``, ``ripple``.
    axis : {"rotary", "linear"}
        Decides what the order of a ripple counts: periods per revolution, or per metre.
    **parameters
        See `describe`.

    Raises
    ------
    UsageError
        No model has that name.
    InvalidParameterError
        A parameter is unknown, missing, not finite or outside its bounds.
    """
    if name == NETWORK_ALONE.name:
        raise UsageError(
            "a network comes from a model file, which 'friction-hil train' writes: friction_hil.models.load"
        )
    return FrictionModel(describe(name), parameters, modifiers, axis)


def simulate_many(
    models: Sequence[FrictionModel], velocity: ArrayLike, dt: ArrayLike, *, workers: int = 1, **inputs: Any
) -> Array:
    """Friction torque of one velocity record by many models or candidates of one, on ``workers`` cores.

    Parameters
    ----------
    models : sequence of m FrictionModel
    velocity, dt, **inputs
        See `FrictionModel.simulate`.
    workers : int
        Threads; the compiled code lets them run side by side.

    Returns
    -------
    (m, n) array
        N m.
    """
    from concurrent.futures import ThreadPoolExecutor

    torque = np.empty((len(models), np.size(velocity)))

    rows = iter(range(len(models)))  # each worker takes the next when it is done: models differ in cost

    def simulate(_: int = 0) -> None:
        for row in rows:
            models[row].simulate(velocity, dt, out=torque[row], **inputs)

    if workers == 1:
        simulate()
        return torque
    with ThreadPoolExecutor(workers) as pool:
        list(pool.map(simulate, range(workers)))
    return torque
