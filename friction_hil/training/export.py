"""Results of a training as a model file and as the JSON object of ``train --json``."""

import dataclasses
from typing import Any

import numpy as np

from friction_hil import __version__
from friction_hil.friction import NETWORK_ALONE, FrictionModel, Network
from friction_hil.models.model_file import ModelFile
from friction_hil.numerics.jit import Array
from friction_hil.training.train import TrainingResult

_SLOW_SPEEDS = 32  # speeds at which the friction level is evaluated


def network_of(parameters: Array, base: FrictionModel | None = None) -> Network:
    """Return the network of a parameter array, with the friction level in slow motion of it and the model beside it."""
    network = Network.of_values(parameters, 1.0, is_residual=base is not None)
    if base is not None and network.structure.kind == "static":
        return dataclasses.replace(network, level=base.level + network.bound * network.torque_scale)
    model = model_of(network, base)
    slow = np.geomspace(0.1 * network.speeds[2], network.speeds[1], _SLOW_SPEEDS)
    torque = model.steady_state(np.concatenate([slow, -slow]), load_torque=0.0)
    return dataclasses.replace(network, level=max(float(np.max(np.abs(torque))), 1e-3 * network.torque_scale))


def model_of(network: Network, base: FrictionModel | None = None) -> FrictionModel:
    """Return the friction model of a network, alone or beside a model."""
    if base is None:
        return FrictionModel(NETWORK_ALONE, {}, trained=network)
    return FrictionModel(base.family, base.given, base.modifiers, base.axis, network)


def as_model_file(
    trained: TrainingResult, network: Network, known: ModelFile, *, is_residual: bool, sources: dict[str, Any]
) -> dict[str, Any]:
    """Return the model file as plain values, for YAML.

    ``known``: axis, mechanics, and for a residual the friction model beside the network. ``sources``: origin of the
    training data, for the provenance.
    """
    fit = {
        "train": dataclasses.asdict(trained.train),
        "validation": dataclasses.asdict(trained.validation),
        "iterations": trained.iterations,
        "seed": trained.seed,
        "flags": list(trained.flags),
    }
    return network_model_file(network, known, is_residual=is_residual, fit={**sources, **fit})


def network_model_file(network: Network, known: ModelFile, *, is_residual: bool, fit: dict[str, Any]) -> dict[str, Any]:
    """Return the model file of a network as plain values; ``fit`` is the provenance, see `as_model_file`."""
    content = {name: _plain(value) for name, value in network.as_dict().items()}
    if is_residual:
        friction = known.friction
        content["base"] = {"model": friction.model, "parameters": friction.parameters}
        content["base"] |= {"modifiers": friction.modifiers} if friction.modifiers else {}
    return {
        "version": 1,
        "axis": known.axis,
        "friction": {"model": "network", "network": content},
        "mechanics": known.mechanics.model_dump(),
        "fit": {
            "software": f"friction_hil {__version__}",
            **fit,
            "weights": int(network.weights.size),
            "range": {"velocity": [-network.speed_limit, network.speed_limit]},
        },
    }


def _plain(value: Any) -> Any:
    """Round numbers to ten digits, which is far more than a training determines."""
    if isinstance(value, list):
        return [_plain(each) for each in value]
    return float(f"{value:.10g}") if isinstance(value, float) else value


def as_json(trained: TrainingResult, seconds: float) -> dict[str, Any]:
    """Return the object that ``train --json`` prints."""
    return {
        "structure": trained.structure.kind,
        "hidden": list(trained.structure.hidden),
        "weights": trained.structure.weights,
        "train": dataclasses.asdict(trained.train),
        "validation": dataclasses.asdict(trained.validation),
        "iterations": trained.iterations,
        "seconds": seconds,
        "seed": trained.seed,
        "flags": list(trained.flags),
    }
