"""Training of the networks that a user asks for, and the one that is kept with its errors and model file."""

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from friction_hil.errors import UsageError, choices
from friction_hil.friction import FrictionModel, Network, NetworkStructure
from friction_hil.friction.network_model import INPUTS
from friction_hil.numerics.jit import Array
from friction_hil.training import export, physical
from friction_hil.training.layout import Samples
from friction_hil.training.task import TrainingTask
from friction_hil.training.train import Options, Progress, TrainingResult, train

_HIDDEN = {"gated": (10,), "narx": (10,), "static": (8,), "residual": (4,)}
_STATES = (1, 5)  # of a gated network; several suit friction like that of Maxwell-slip elements
# of several states: each iteration takes three times as long, and fewer are needed
_SEVERAL_STATES = Options(starts=5, survivors=2, trial_iterations=15, iterations=50)
_GOOD_ENOUGH = 0.02  # NRMSE on validation below which a gated network needs no more states
_ORDERS = (1, 2, 3)  # of a narx: numbers of past torques and past velocities


@dataclass(frozen=True, slots=True)
class NetworkSpec:
    """Network to train, as a user specifies it.

    Attributes
    ----------
    structure : {"gated", "narx", "static", "residual"}
    hidden : tuple of int
        Units of one or two hidden layers; empty for the default.
    inputs : tuple of str
        Inputs besides the velocity, among `INPUTS`.
    seed : int
        Seed of the random starts.
    """

    structure: Literal["gated", "narx", "static", "residual"] = "gated"
    hidden: tuple[int, ...] = ()
    inputs: tuple[str, ...] = ()
    seed: int = 0

    def __post_init__(self) -> None:
        for name in self.inputs:
            if name not in INPUTS:
                raise UsageError(f"a network has no input {name!r} besides the velocity; {choices(name, INPUTS)}")

    def structures(self) -> list[NetworkStructure]:
        """Return the structures to try; the best by free run on validation is kept."""
        hidden = self.hidden or _HIDDEN[self.structure]
        has_position, has_load, has_temperature = (name in self.inputs for name in INPUTS)
        others = (has_position, has_load, has_temperature)
        if self.structure == "narx":
            return [NetworkStructure("narx", hidden, order, order, *others) for order in _ORDERS]
        if self.structure == "gated":
            return [NetworkStructure("gated", hidden, states, 0, *others) for states in _STATES]
        return [NetworkStructure("static", hidden, 0, 0, *others)]


@dataclass(frozen=True, slots=True, eq=False)
class TrainedModel:
    """Trained network with the data it was trained on."""

    task: TrainingTask
    trained: TrainingResult
    network: Network

    @property
    def model(self) -> FrictionModel:
        """Friction model to run: the network, alone or beside the model of a residual."""
        return export.model_of(self.network, self.task.base)

    def free_run(self, samples: Samples) -> Array:
        """Return the torque of the network alone in free run, (n,), fed its own output; records start from rest."""
        alone = export.model_of(dataclasses.replace(self.network, is_residual=False))
        return physical.simulate(alone, samples)

    def error(self, samples: Samples) -> float:
        """Return the NRMSE in free run: RMS error over the standard deviation of the torque."""
        return nrmse(self.free_run(samples), samples)

    def physical_errors(self) -> dict[str, dict[str, float]]:
        """Return the NRMSE by signal and model: of the network, and of physical models fitted to the same samples.

        Signals are those not used for training. The result is empty for a residual, which leaves little to compare.
        """
        task = self.task
        if task.is_residual:
            return {}
        models = physical.fitted(task.samples, task.known.axis)
        signals = task.unseen or {"held out": task.validation}
        return {
            name: {"network": self.error(samples)}
            | {family: nrmse(physical.simulate(model, samples), samples) for family, model in models.items()}
            for name, samples in signals.items()
        }

    @property
    def relative_errors(self) -> dict[str, float]:
        """norm(error) / norm(measured torque) on the validation samples, for the network and the physical model."""
        if not self.task.total.size:
            return {}
        weight = np.sqrt(self.task.validation.weight)
        norm = float(np.linalg.norm(weight * self.task.total))
        left = self.task.validation.torque - self.free_run(self.task.validation)
        return {
            str(self.network): float(np.linalg.norm(weight * left)) / norm,
            self.task.physical: float(np.linalg.norm(weight * self.task.base_error)) / norm,
        }

    def model_file(self) -> dict[str, Any]:
        """Return the content of the model file as plain values."""
        task = self.task
        return export.as_model_file(
            self.trained, self.network, task.known, is_residual=task.is_residual, sources=task.sources
        )

    def as_json(self, seconds: float) -> dict[str, Any]:
        """Return the object that ``train --json`` prints."""
        return {
            **export.as_json(self.trained, seconds),
            "relative_errors": self.relative_errors,
            "unseen": {name: self.error(samples) for name, samples in self.task.unseen.items()},
        }


def nrmse(torque: Array, samples: Samples) -> float:
    """Return the weighted RMS error of a torque over the weighted standard deviation of the samples' torque."""
    weight = samples.weight / np.sum(samples.weight)
    spread = math.sqrt(float(weight @ (samples.torque - weight @ samples.torque) ** 2))
    return math.sqrt(float(weight @ (torque - samples.torque) ** 2)) / spread


def train_task(
    task: TrainingTask, spec: NetworkSpec, goes_on: Callable[[Progress], bool] = lambda progress: True
) -> TrainedModel:
    """Train every structure of a specification; keep the best by free run on the validation samples."""
    best: TrainingResult | None = None
    for structure in spec.structures():
        options = _SEVERAL_STATES if structure.kind == "gated" and structure.states > 1 else Options()
        trained = train(structure, task.samples, task.validation, seed=spec.seed, options=options, goes_on=goes_on)
        if best is None or trained.validation.free_run < best.validation.free_run:
            best = trained
        if trained.is_stopped or (structure.kind == "gated" and best.validation.free_run < _GOOD_ENOUGH):
            break
    assert best is not None
    found = TrainedModel(task, best, export.network_of(best, task.base))
    return _with_residual_flags(found) if task.is_residual else found


def _with_residual_flags(found: TrainedModel) -> TrainedModel:
    """Replace the flag on a large error: a residual may be mostly noise, but must improve on the model alone."""
    flags = [flag for flag in found.trained.flags if not flag.startswith("free-run error on validation is")]
    own, physical = found.relative_errors.values()
    if own >= physical:
        flags.append("the network does not improve on the model beside it")
    return dataclasses.replace(found, trained=dataclasses.replace(found.trained, flags=tuple(flags)))
