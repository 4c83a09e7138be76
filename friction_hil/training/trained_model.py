"""Training of the networks that a user asks for, and the one that is kept with its errors and model file."""

import dataclasses
import itertools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from friction_hil.errors import UsageError, choices
from friction_hil.friction import FrictionModel, Network, NetworkStructure
from friction_hil.friction.network_model import INPUTS
from friction_hil.numerics.jit import Array
from friction_hil.numerics.readable import POSITION_UNITS, named_constants
from friction_hil.training import export, physical
from friction_hil.training import thresholds as th
from friction_hil.training.held_out import Gain, gain
from friction_hil.training.layout import Samples
from friction_hil.training.task import TrainingTask
from friction_hil.training.train import Options, Progress, TrainingResult, train

_HIDDEN = {"gated": (10,), "narx": (10,), "static": (8,), "residual": (4,)}
# of several states: each iteration takes three times as long, and fewer are needed
_SEVERAL_STATES = Options(starts=5, survivors=2, trial_iterations=15, iterations=50)


@dataclass(frozen=True, slots=True)
class NetworkSpec:
    """Network to train, as a user specifies it."""

    structure: Literal["gated", "narx", "static", "residual"] = "gated"
    hidden: tuple[int, ...] = ()  # units of one or two hidden layers; empty for the default
    inputs: tuple[str, ...] = ()  # besides the velocity, among `INPUTS`
    seed: int = 0  # of the random starts

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
            return [NetworkStructure("narx", hidden, order, order, *others) for order in th.ORDERS]
        if self.structure == "gated":
            return [NetworkStructure("gated", hidden, states, 0, *others) for states in th.STATES]
        return [NetworkStructure("static", hidden, 0, 0, *others)]


@dataclass(frozen=True, slots=True, eq=False)
class TrainedModel:
    """Trained network with the data it was trained on, and physical models fitted to the same data."""

    task: TrainingTask
    trained: TrainingResult
    network: Network
    compared: Mapping[str, FrictionModel] = field(default_factory=dict)

    @property
    def model(self) -> FrictionModel:
        """Friction model to run: the network, alone or beside the model of a residual."""
        return export.model_of(self.network, self.task.base)

    def free_run(self, samples: Samples) -> Array:
        """Return the torque of the network alone in free run, (n,), fed its own output; records start from rest."""
        return physical.simulate(export.model_of(self.network), samples)

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
        models = self.compared or physical.fitted(task.samples, task.known.axis)
        signals = task.unseen or {"held out": task.validation}
        return {
            name: {"network": self.error(samples)}
            | {family: nrmse(physical.simulate(model, samples), samples) for family, model in models.items()}
            for name, samples in signals.items()
        }

    @property
    def relative_errors(self) -> dict[str, float]:
        """norm(error) / norm(measured torque) on the validation samples, for the network and the physical models.

        The torques are prepared as `identify` and `replay` prepare them.
        """
        if self.task.judged is None:
            return {}
        norm = self._norm(self.task.total)
        return {name: self._norm(left) / norm for name, left in self._left(self.task.judged).items()}

    def _norm(self, torque: Array) -> float:
        """Return the norm of a torque (n,) on the judged samples, decimated."""
        samples = self.task.judged
        assert samples is not None
        begins = np.flatnonzero(samples.starts)[1:]
        parts = zip(self.task.prepared, np.split(torque, begins), np.split(samples.weight, begins), strict=True)
        # low-passed already, where the records are
        squares = [
            float(np.sum(each.kept_rows(weight) * each.reduce_smooth(part) ** 2)) for each, part, weight in parts
        ]
        return math.sqrt(math.fsum(squares))

    @property
    def gains(self) -> dict[str, Gain]:
        """Decrease of the mean square error on held-out blocks against each physical model; empty without recordings.

        The network was stopped where its own error on these blocks was smallest, which flatters it a little; physical
        models were not.
        """
        if not self.task.total.size:
            return {}
        blocks = _blocks(self.task.validation)
        network, *others = (
            (name, [float(np.mean(left[block] ** 2)) for block in blocks])
            for name, left in self._left(self.task.validation).items()
        )
        return {name: gain(network[1], errors) for name, errors in others}

    @property
    def not_for(self) -> tuple[str, ...]:
        """Motion for which the network is not to be used, by its speed, each as words after "motion".

        That is what the recordings do not show, and bands of speed in which a physical model predicts held-out blocks
        clearly better. A network beside a model fades out where the recordings show nothing: the model remains there.
        """
        task, unit = self.task, f"{POSITION_UNITS[self.task.known.axis]}/s"
        if task.is_residual:
            return ()
        found = [f"faster than {self.network.speed_limit:.3g} {unit}: there is none in the training"]
        if task.least_speed > 0.0:
            found.append(f"slower than {task.least_speed:.3g} {unit}: the recordings do not show its friction")
        return (*found, *self._worse_bands(unit))

    def _worse_bands(self, unit: str) -> list[str]:
        """Return the bands of speed in which the best physical model is better than the network."""
        if not self.compared:
            return []
        samples = self.task.validation
        speed, weight = np.abs(samples.velocity), samples.weight
        network, *others = self._left(samples).items()
        name, best = min(others, key=lambda each: float(weight @ each[1] ** 2))
        edges = np.quantile(speed[weight > 0.0], np.linspace(0.0, 1.0, th.BANDS + 1))
        found = []
        for low, high in itertools.pairwise(edges.tolist()):
            rows = (weight > 0.0) & (speed >= low) & (speed <= high)
            parts = [block for block in _blocks(samples) if rows[block].any()]
            errors, before = (
                [float(np.mean(left[block][rows[block]] ** 2)) for block in parts] for left in (best, network[1])
            )
            better = gain(errors, before)
            if better.is_clear:
                found.append(f"from {low:.3g} to {high:.3g} {unit}: the mean square error of {name} is {better.words}")
        return found

    def _left(self, samples: Samples) -> dict[str, Array]:
        """Return the error of the torque on samples of the validation, (n,), of the network and the physical models."""
        left = {str(self.network): samples.torque - self.free_run(samples)}
        if self.task.is_residual:
            return left | {self.task.physical: samples.torque}  # what the model beside the network leaves
        return left | {
            name: samples.torque - physical.simulate(model, samples) for name, model in self.compared.items()
        }

    def model_file(self) -> dict[str, Any]:
        """Return the content of the model file as plain values."""
        task = self.task
        return export.as_model_file(
            self.trained,
            self.network,
            task.known,
            is_residual=task.is_residual,
            sources={**task.sources, "not_for": list(self.not_for)},
        )

    def as_json(self, seconds: float) -> dict[str, Any]:
        """Return the object that ``train --json`` prints."""
        return {
            **export.as_json(self.trained, seconds),
            "not_for": self.not_for,
            "thresholds": named_constants(th),
            "relative_errors": self.relative_errors,
            "gain": {name: [value.mean, value.error] for name, value in self.gains.items()},
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
        if trained.is_stopped or (structure.kind == "gated" and best.validation.free_run < th.GOOD_ENOUGH):
            break
    assert best is not None
    is_compared = task.total.size > 0 and not task.is_residual
    compared = physical.fitted(task.samples, task.known.axis, is_directed=True) if is_compared else {}
    network = export.network_of(best.parameters, task.base)
    if task.is_residual:
        network = dataclasses.replace(network, least_speed=min(task.least_speed, 0.5 * network.speed_limit))
    found = TrainedModel(task, best, network, compared)
    return _with_flags(found) if task.total.size else found


def _with_flags(found: TrainedModel) -> TrainedModel:
    """Add a flag for each physical model that the network is not better than.

    A large error alone is no flaw of a network that is better than all of them, nor of a residual: it may be noise.
    """
    not_better = [
        f"it is not better than {name}: the mean square error on held-out blocks is {value.words}"
        for name, value in found.gains.items()
        if not value.is_clear
    ]
    is_noise = found.task.is_residual or not not_better
    flags = [
        flag for flag in found.trained.flags if not (is_noise and flag.startswith("free-run error on validation is"))
    ]
    flags += not_better
    return dataclasses.replace(found, trained=dataclasses.replace(found.trained, flags=tuple(flags)))


def _blocks(samples: Samples) -> list[slice]:
    """Return the stretches of samples that count, each at most a sixth of them: paired errors need several."""
    counts = np.concatenate([[0], samples.weight > 0.0, [0]]).astype(int)
    edges = np.flatnonzero(np.diff(counts)).reshape(-1, 2)
    longest = max(int(np.sum(counts)) // th.COMPARED_BLOCKS, 1)
    found = []
    for begin, end in edges.tolist():
        parts = max(round((end - begin) / longest), 1)
        cuts = np.linspace(begin, end, parts + 1).round().astype(int).tolist()
        found += [slice(a, b) for a, b in itertools.pairwise(cuts)]
    return found
