"""One training as users ask for it: data, structures to try, the network that is kept, and what it is compared with."""

import dataclasses
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from friction_hil.errors import UsageError, choices
from friction_hil.friction import FrictionModel, Network, NetworkStructure
from friction_hil.friction.network_model import INPUTS
from friction_hil.numerics.jit import Array
from friction_hil.training import data, export, physical
from friction_hil.training.excitation import excitation
from friction_hil.training.layout import Samples
from friction_hil.training.train import Options, Progress, Trained, train

if TYPE_CHECKING:
    from friction_hil.identification.data import RegressionSegment
    from friction_hil.models.model_file import ModelFile
    from friction_hil.recordings import Recording

_HIDDEN = {"gated": (10,), "narx": (10,), "static": (8,), "residual": (4,)}
_STATES = (1, 5)  # of a gated network: more where one is not good enough, as of friction in Maxwell-slip elements
# of several states: each iteration takes three times as long, and fewer are needed
_SEVERAL_STATES = Options(starts=5, survivors=2, trial_iterations=15, iterations=50)
_GOOD_ENOUGH = 0.02  # NRMSE on validation with which a gated network needs no more states
_ORDERS = (1, 2, 3)  # of a narx, tried where none is given: past torques and past velocities
_STATIC_LOWPASS_SHARE = 0.04  # of the sampling rate
_UNSEEN_SEED = 1_000_003  # added to the seed of the training for signals that it has not seen


@dataclass(frozen=True, slots=True)
class Wanted:
    """What to train.

    Attributes
    ----------
    structure : {"gated", "narx", "static", "residual"}
    hidden : tuple of int
        Units of one or two layers; a usual number when empty.
    inputs : tuple of str
        Among `INPUTS`, besides the velocity.
    seed : int
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
        """Structures to try, one after the other; the best by free run on validation is kept."""
        hidden = self.hidden or _HIDDEN[self.structure]
        has_position, has_load, has_temperature = (name in self.inputs for name in INPUTS)
        others = (has_position, has_load, has_temperature)
        if self.structure == "narx":
            return [NetworkStructure("narx", hidden, order, order, *others) for order in _ORDERS]
        if self.structure == "gated":
            return [NetworkStructure("gated", hidden, states, 0, *others) for states in _STATES]
        return [NetworkStructure("static", hidden, 0, 0, *others)]


@dataclass(frozen=True, slots=True, eq=False)
class Task:
    """Data of one training.

    Attributes
    ----------
    samples, validation : Samples
        Of friction, less that of the model beside the network.
    known : ModelFile
        Axis and mechanics, and of a residual the friction of the model beside it.
    is_residual : bool
    sources : dict
        Where the data came from, for the provenance.
    notes : tuple of str
    unseen : dict of str to Samples
        Signals by name that serve neither training nor validation; for the report.
    total : array
        Measured torque of the validation samples, of which relative errors are shares; empty where nothing was
        measured.
    base_error : array
        What the model beside the network, or the best physical one, leaves of it.
    physical : str
        Name of that model.
    """

    samples: Samples
    validation: Samples
    known: "ModelFile"
    is_residual: bool
    sources: dict[str, Any]
    notes: tuple[str, ...] = ()
    unseen: dict[str, Samples] = field(default_factory=dict)
    total: Array = field(default_factory=lambda: np.zeros(0))
    base_error: Array = field(default_factory=lambda: np.zeros(0))
    physical: str = ""

    @property
    def base(self) -> FrictionModel | None:
        """The model beside the network."""
        return self.known.friction_model if self.is_residual else None


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """A trained network with its task."""

    task: Task
    trained: Trained
    network: Network

    @property
    def model(self) -> FrictionModel:
        """The friction model that runs: the network, alone or beside its model."""
        return export.model_of(self.network, self.task.base)

    def free_run(self, samples: Samples) -> Array:
        """Torque of the network alone along samples, (n,), fed its own output; records start anew."""
        alone = export.model_of(dataclasses.replace(self.network, is_residual=False))
        return physical.simulate(alone, samples)

    def error(self, samples: Samples) -> float:
        """NRMSE in free run: RMS error over the standard deviation of the torque."""
        return nrmse(self.free_run(samples), samples)

    def physical_errors(self) -> dict[str, dict[str, float]]:
        """NRMSE by signal and model: of the network, and of models of the library fitted to the same samples.

        The signals are those that nothing was trained on; empty beside a model, which leaves little for another one.
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
        """norm(error) / norm(measured torque) on the validation samples, of the network and of the physical model."""
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
        """What the model file holds, as plain values."""
        task = self.task
        return export.as_model_file(
            self.trained, self.network, task.known, is_residual=task.is_residual, sources=task.sources
        )

    def as_json(self, seconds: float) -> dict[str, Any]:
        """The object that ``train --json`` prints."""
        return {
            **export.as_json(self.trained, seconds),
            "relative_errors": self.relative_errors,
            "unseen": {name: self.error(samples) for name, samples in self.task.unseen.items()},
        }


def nrmse(torque: Array, samples: Samples) -> float:
    """RMS error of a torque over the standard deviation of that of the samples, both by their weights."""
    weight = samples.weight / np.sum(samples.weight)
    spread = math.sqrt(float(weight @ (samples.torque - weight @ samples.torque) ** 2))
    return math.sqrt(float(weight @ (torque - samples.torque) ** 2)) / spread


def task_of_model(
    known: "ModelFile", *, period_s: float, samples: int, top_speed: float | None = None, seed: int = 0
) -> Task:
    """Learn a model of the library along designed motions; see `data.of_model`."""
    model = known.friction_model
    first = data.of_model(model, period_s=period_s, samples=samples, top_speed=top_speed, seed=seed)
    reach = float(np.max(np.abs(first.velocity)))

    def unseen(number: int) -> Samples:
        return data.of_model(
            model, period_s=period_s, samples=samples // 2, top_speed=reach, seed=seed + number * _UNSEEN_SEED
        )

    return Task(
        first,
        unseen(1),
        known,
        is_residual=False,
        sources={"from_model": repr(model), "rows": len(first)},
        unseen={"multi-sines, ramps and pulses": unseen(2), "half as fast": _slower(model, period_s, reach, seed)},
    )


def _slower(model: FrictionModel, period_s: float, reach: float, seed: int) -> Samples:
    velocity = 0.5 * excitation(reach, period_s, 10_000, seed=seed + 3 * _UNSEEN_SEED)
    position = np.cumsum(velocity) * period_s
    return Samples(period_s, velocity, model.simulate(velocity, period_s, position=position), position=position)


def task_of_recordings(
    recordings: "Sequence[Recording]",
    validation: "Sequence[Recording]",
    known: "ModelFile | None",
    *,
    is_linear: bool = False,
    is_static: bool = False,
    is_residual: bool = False,
    lowpass_hz: float | None = None,
) -> Task:
    """Learn the friction in recordings.

    Parameters
    ----------
    recordings, validation : sequence of Recording
        To train on and to judge by; without the latter, blocks of the former are held out.
    known : ModelFile or None
        Mechanics of the axis, and the friction beside a residual; identified from the recordings where None.
    is_linear : bool
        Of the axis where nothing is known.
    is_static, is_residual : bool
        Whether the network has no state; whether it stands beside the known friction.
    lowpass_hz : float, optional
        For everything; without it, for a static network, what `identify` compares by: a map needs no more, and the
        noise of an acceleration is above it. Else, where the velocity would come from an encoder's counts, it does so
        in bands and the torque stays as it was measured (`identification.fine.at_full_rate`): a low-pass would take
        the reversals away, in which a state shows. Without counts, that of `identification.data.prepare`.
    """
    from friction_hil.identification import fine
    from friction_hil.identification.data import prepare

    notes: list[str] = []
    if lowpass_hz is None and is_static:
        lowpass_hz = _STATIC_LOWPASS_SHARE * prepare(recordings[0])[0].rate_hz
    name = "the model of --base"
    if known is None:
        known, name = _identified(recordings, is_linear, lowpass_hz)
        notes.append(f"inertia, offset and gravity as identified with {name}")
    records = [record for each in recordings for record in prepare(each, lowpass_hz=lowpass_hz)]
    others = [record for each in validation for record in prepare(each, lowpass_hz=lowpass_hz)]
    notes += dict.fromkeys(problem for record in (*records, *others) for problem in record.problems)
    if lowpass_hz is None and all(map(_is_counted, (*records, *others))):
        records, others = [list(map(fine.at_full_rate, each)) for each in (records, others)]
        notes.append("velocity from the counts of the encoder, each band as far as it stands out from their noise")
    base = known.friction_model
    own = data.of_records(records, known.mechanics, base if is_residual else None)
    if others:
        samples, judged = own, data.of_records(others, known.mechanics, base if is_residual else None)
    else:
        samples, judged = data.held_out(own)
        notes.append("without --validate, each fourth of twenty blocks is held out to judge by")
    compared = others or records
    return Task(
        samples,
        judged,
        known,
        is_residual=is_residual,
        sources={"recordings": [{"path": each.path, "rows": len(each)} for each in recordings]},
        notes=tuple(notes),
        total=data.total_torque(compared),
        base_error=data.of_records(compared, known.mechanics, base).torque,
        physical=name,
    )


def _is_counted(record: "RegressionSegment") -> bool:
    """Whether counts of the encoder are the best that is known of the velocity."""
    from friction_hil.identification import fine
    from friction_hil.recordings.quality import resolution

    if record.resolution is None or not fine.is_fine(record):
        return False
    step = resolution(record.velocity) if record.lowpass_hz is None else None
    return record.lowpass_hz is not None or (step is not None and step > 0.5 * record.resolution * record.rate_hz)


def _identified(
    recordings: "Sequence[Recording]", is_linear: bool, lowpass_hz: float | None
) -> "tuple[ModelFile, str]":
    from friction_hil.identification import IdentificationSettings, identify
    from friction_hil.identification.export import model_file

    settings = IdentificationSettings(
        families=("lugre",), axis="linear" if is_linear else "rotary", lowpass_hz=lowpass_hz
    )
    found = identify(recordings, settings)
    return model_file(found), found.best.label


def train_task(task: Task, wanted: Wanted, goes_on: Callable[[Progress], bool] = lambda progress: True) -> Candidate:
    """Train every structure that is wanted and keep the best by free run on the validation samples."""
    best: Trained | None = None
    for structure in wanted.structures():
        options = _SEVERAL_STATES if structure.kind == "gated" and structure.states > 1 else Options()
        trained = train(structure, task.samples, task.validation, seed=wanted.seed, options=options, goes_on=goes_on)
        if best is None or trained.validation.free_run < best.validation.free_run:
            best = trained
        if trained.is_stopped or (structure.kind == "gated" and best.validation.free_run < _GOOD_ENOUGH):
            break
    assert best is not None
    found = Candidate(task, best, export.network_of(best, task.base))
    return _judged(found) if task.is_residual else found


def _judged(found: Candidate) -> Candidate:
    """Replace what is said of a residual: what it has to learn may be mostly noise; it must beat the model alone."""
    flags = [flag for flag in found.trained.flags if not flag.startswith("free-run error on validation is")]
    own, physical = found.relative_errors.values()
    if own >= physical:
        flags.append("the network is no better than the model beside it, alone")
    return dataclasses.replace(found, trained=dataclasses.replace(found.trained, flags=tuple(flags)))
