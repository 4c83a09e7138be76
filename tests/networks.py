"""Networks with random weights, for tests that need a network without training one."""

from typing import Any

import numpy as np

import friction_hil as fh
from friction_hil.models import NETWORK_ALONE, FrictionModel, Network, NetworkStructure

STRUCTURES = {
    "gated": NetworkStructure("gated", (6,), 1),
    "gated_2": NetworkStructure("gated", (6, 4), 2),
    "narx": NetworkStructure("narx", (5,), 2, lags=2),
    "static": NetworkStructure("static", (5,), 0),
    "every_input": NetworkStructure("gated", (5,), 1, 0, True, True, True, (1.0, 7.0)),
}


def random_network(name: str = "gated", seed: int = 0, size: float = 0.3, **changes: Any) -> Network:
    """Return a network with normally distributed weights; the rates of a gated one are about 500 per rad."""
    structure = STRUCTURES[name]
    weights = size * np.random.default_rng(seed).standard_normal(structure.weights)
    given: dict[str, Any] = {
        "structure": structure,
        "period_s": 1e-3,
        "torque_scale": 0.1,
        "bound": 1.8,
        "speed_limit": 2.0,
        "speeds": (0.01, 0.1, 0.003),
        "stroke": 1e-3 if structure.kind == "gated" else 0.0,
        "rates": (100.0, 2500.0) if structure.kind == "gated" else (),
        "ranges": {"position": (-1.0, 1.0), "load_torque": (-0.2, 0.2), "temperature": (20.0, 60.0)},
        "level": 0.12,
        "weights": weights,
    }
    return Network(**given | changes)


def alone(network: Network) -> FrictionModel:
    """Return the friction model of a network alone."""
    return FrictionModel(NETWORK_ALONE, {}, trained=network)


def beside(network: Network, name: str = "lugre", modifiers: Any = None) -> FrictionModel:
    """Return a model of the library with a network beside it."""
    family = fh.models.describe(name)
    return FrictionModel(family, family.example, modifiers, trained=network)


def model_file(network: Network, **friction: Any) -> dict[str, Any]:
    """Return the content of the model file of this network."""
    content = {"model": "network", "network": network.as_dict(), **friction}
    return {"version": 1, "axis": "rotary", "friction": content, "mechanics": {"inertia": 2e-4}}
