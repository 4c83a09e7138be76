"""Choice between a physical model and the same with a network beside it, by data that neither was fitted to.

A static network learns what the physical model leaves. Its inputs are added one by one while the error on held-out
data falls. It is kept only if it lowers the error by more than a standard error, in every kind of held-out data and
also in slow motion; otherwise the physical model is the result.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from friction_hil.errors import RecordingError, UsageError
from friction_hil.friction import FrictionModel, Network
from friction_hil.friction.network_model import INPUTS
from friction_hil.identification import Identification, IdentificationSettings, identify
from friction_hil.identification.data import Data, prepare
from friction_hil.identification.export import model_file
from friction_hil.identification.prediction_errors import PredictionError
from friction_hil.identification.settings import FitStep
from friction_hil.models.model_file import ModelFile
from friction_hil.numerics.jit import Array
from friction_hil.numerics.readable import named_constants
from friction_hil.recordings import Recording
from friction_hil.training import export, held_out
from friction_hil.training import thresholds as th
from friction_hil.training.contenders import Contender, choose
from friction_hil.training.held_out import Given, Physical, Refitted
from friction_hil.training.judge import Judge, output
from friction_hil.training.layout import Samples


@dataclass(frozen=True, slots=True, eq=False)
class Selection:
    """Result of `select`."""

    base: ModelFile  # physical model with the mechanics of the axis
    network: Network | None  # beside it; None if none predicts held-out data better
    physical: Contender  # the physical model alone
    chosen: Contender  # the result
    # networks beside it in the order in which they were tried, then further physical models
    contenders: tuple[Contender, ...]
    reason: str  # one sentence
    train: PredictionError  # error of the result on all data
    notes: tuple[str, ...]
    sources: dict[str, Any]  # origin of the data, for the provenance
    seed: int
    # what the physical model leaves, at the rows of the regression; for the report
    samples: Samples = field(repr=False)
    measured: Array = field(repr=False)  # (k,), torque of the same rows

    @property
    def model(self) -> FrictionModel:
        """Friction model to run."""
        base = self.base.friction_model
        return base if self.network is None else export.model_of(self.network, base)

    def learned(self, samples: Samples) -> Array:
        """Return the torque of the network alone, (n,); zeros if there is none."""
        return np.zeros(len(samples)) if self.network is None else output(self.network.values, samples)

    @property
    def structure(self) -> str:
        """``residual``, or ``physical`` if there is no network."""
        return "physical" if self.network is None else "residual"

    @property
    def judged(self) -> tuple[Contender, ...]:
        """All contenders, the physical model first."""
        return (self.physical, *self.contenders)

    def model_file(self) -> dict[str, Any]:
        """Return the content of the model file as plain values."""
        if self.network is None:
            content = self.base.model_dump(exclude_none=True)
            return content | {"fit": {**content.get("fit", {}), "chosen": self.reason}}
        held = {kind: error.relative_error for kind, error in self.chosen.errors.items()}
        fit = {**self.sources, "chosen": self.reason, "held_out": held, "seed": self.seed, "notes": list(self.notes)}
        return export.network_model_file(self.network, self.base, is_residual=True, fit=fit)

    def as_json(self, seconds: float) -> dict[str, Any]:
        """Return the object that ``train --json`` prints."""
        spread = float(np.std(self.measured)) or 1.0
        errors = {"train": self.train, "validation": self.chosen.first}
        return {
            "structure": self.structure,
            "model": self.chosen.label,
            "reason": self.reason,
            "thresholds": named_constants(th),
            "inputs": None if self.chosen.inputs is None else ["velocity", *self.chosen.inputs],
            "weights": 0 if self.network is None else int(self.network.weights.size),
            **{name: dict.fromkeys(("one_step", "free_run"), each.rmse / spread) for name, each in errors.items()},
            "candidates": [self._candidate(each) for each in self.judged],
            "iterations": 0,
            "seconds": seconds,
            "seed": self.seed,
            "flags": list(self.notes),
        }

    def _candidate(self, each: Contender) -> dict[str, Any]:
        return {
            "model": each.label,
            "inputs": each.inputs,
            "held_out": {kind: error.relative_error for kind, error in each.errors.items()},
            "gain": {kind: [value.mean, value.error] for kind, value in each.gains(self.physical).items()},
        }


def select(
    recordings: Sequence[Recording],
    validation: Sequence[Recording] = (),  # to judge by; if there is none, parts of ``recordings`` are held out in turn
    known: ModelFile | None = None,  # the physical model; None: identified from the recordings
    *,
    settings: IdentificationSettings | None = None,  # axis and low-pass, and how the physical model is identified
    # of the network besides the velocity; None: those are tried that vary in the recordings
    inputs: Sequence[str] | None = None,
    seed: int = 0,  # the same one gives the same bits
    progress: Callable[[str], None] = lambda _: None,  # called with a few words before each step
    goes_on: Callable[[], bool] = lambda: True,  # called before a further input is tried; False ends the trials
) -> Selection:
    """Choose between a physical model alone and with a network beside it.

    Raises `RecordingError`: a recording lacks a column or is too short, the axis does not move, or a required input was
    not recorded; `UsageError`: ``known`` is a network.
    """
    settings = settings or IdentificationSettings()
    if known is not None and known.friction.network is not None:
        raise UsageError("the model of --base is a network already: give a model of the library, or no --base")
    data, check, physical, base, label, others, notes = _physical(recordings, validation, known, settings, progress)
    judge = Judge(data, check, physical, seed)
    alone = judge.contender(label, None)
    tried: list[Contender] = []
    required = None if inputs is None else tuple(inputs)
    there = [name for name in INPUTS if judge.varies(name)]
    for name in required or ():
        if name not in there:
            raise RecordingError(f"the recordings have no {name} that varies, which --inputs requires")

    def attempt(given: tuple[str, ...]) -> Contender:
        progress(f"network of {' and '.join(('velocity', *given))}")
        tried.append(judge.contender(f"{label} + network of {', '.join(('velocity', *given))}", given))
        return tried[-1]

    if required is not None:
        attempt(required)
    else:
        now = attempt(())
        for _ in range(th.MOST_INPUTS):
            assert now.inputs is not None
            further = [attempt((*now.inputs, name)) for name in there if name not in now.inputs and goes_on()]
            best = min(further, key=lambda each: each.first.rmse, default=None)
            if best is None or not next(iter(best.gains(now).values())).is_clear:
                break
            now = best
    chosen, reason = choose(alone, tried, others)
    trained = None if chosen.inputs is None else judge.network(chosen.inputs)
    found = None if trained is None else export.network_of(trained, base.friction_model)
    return Selection(
        base=base,
        network=found,
        physical=alone,
        chosen=chosen,
        contenders=(*tried, *others),
        reason=reason,
        train=judge.error_on_all(trained),
        notes=tuple(notes),
        sources={"recordings": [{"path": each.path, "rows": len(each)} for each in recordings]},
        seed=seed,
        samples=judge.samples,
        measured=data.torque,
    )


def residual_model_file(
    recordings: Sequence[Recording],
    known: ModelFile,
    *,
    settings: IdentificationSettings | None = None,
    seed: int = 0,
    goes_on: Callable[[], bool] = lambda: True,
) -> dict[str, Any] | None:
    """Return the model file of a known model with a network beside it; None if none predicts held-out data better.

    It takes a few seconds; ``goes_on`` may end it earlier. See `select`.
    """
    chosen = select(recordings, known=known, settings=settings, seed=seed, goes_on=goes_on)
    return None if chosen.network is None else chosen.model_file()


def _physical(
    recordings: Sequence[Recording],
    validation: Sequence[Recording],
    known: ModelFile | None,
    settings: IdentificationSettings,
    progress: Callable[[str], None],
) -> tuple[Data, Data | None, Physical, ModelFile, str, list[Contender], list[str]]:
    """Return the data, the physical model in three forms, and further physical models for comparison."""
    if known is not None:
        train, other = (
            [part for each in several for part in prepare(each, lowpass_hz=settings.lowpass_hz)]
            for several in (recordings, validation)
        )
        notes = [] if validation else ["the model of --base was not held out: it may have been fitted to these data"]
        return Data(train), Data(other) if other else None, Given(known), known, "the model of --base", [], notes

    def report(step: FitStep) -> None:
        progress(f"{step.stage}: {step.label}")

    found = identify(recordings, settings, validation=validation, progress=report)
    data, check = Data(found.records), Data(found.validation) if found.validation else None
    best, base = found.best, model_file(found)
    is_held = not best.is_refined and "load" not in best.structure.modifiers
    physical: Physical = Refitted(best, None) if is_held else Given(base)
    notes = [] if is_held else [f"{best.label} was not held out: its own figures are those of data that it has seen"]
    return data, check, physical, base, best.label, _others(found), [*found.notes, *notes]


def _others(found: Identification) -> list[Contender]:
    """Return the best fits besides the chosen one, and Coulomb friction of each direction."""
    listed: list[Contender] = []
    for each in found.fits[1:]:
        is_plainest = each.structure.family == "coulomb" and tuple(each.structure.modifiers) == ("direction",)
        if each.is_refined or not (is_plainest or len(listed) < th.LISTED):
            continue
        errors = {held_out.OTHERS: each.validation} if each.validation else {held_out.SPEEDS: each.across_speeds}
        errors |= {} if each.validation else {held_out.BLOCKS: each.cross_validation}
        listed.append(Contender(each.label, None, {kind: error for kind, error in errors.items() if error is not None}))
    return listed
