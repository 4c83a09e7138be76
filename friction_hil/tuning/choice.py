"""The model of an axis that is kept after the trials."""

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from friction_hil.config import AxisConfig, Configuration
from friction_hil.identification import Fit, Identification
from friction_hil.recordings import Recording
from friction_hil.tuning.gains import Clipping, GainTrial, find_clipping
from friction_hil.tuning.model_files import write_model
from friction_hil.tuning.trial import Trial, judge
from friction_hil.tuning.trial_motions import MOTIONS

SCALED = ", scaled"  # of a model in the commanded torque


@dataclass(frozen=True, slots=True, eq=False)
class TriedModel:
    """A model that was tried on the machine, as a model file and with the fit that it comes from."""

    identification: Identification
    fit: Fit
    model: dict[str, Any]
    trial: Trial
    is_scaled: bool = False  # to the commanded torque, by a ratio that the trial showed
    clipping: Clipping | None = None  # by the torque limit, in the trial

    @property
    def label(self) -> str:
        """Name for tables and messages."""
        return f"{self.fit.label}{SCALED if self.is_scaled else ''}"

    @property
    def content(self) -> dict[str, Any]:
        """The model file with what the trial has shown, as plain values."""
        return {**self.model, "fit": {**self.model["fit"], "trial": self.trial.figures}}


@dataclass(frozen=True, slots=True)
class Turn:
    """A run of the trial: one candidate of each axis, and its model file."""

    fits: Mapping[str, tuple[Identification, Fit]]
    files: Mapping[str, dict[str, Any]]
    run: Configuration
    duration_s: float
    scaled: Collection[str] = ()  # axes whose models are scaled by a ratio that the trial showed

    def judged(self, name: str, without: Recording, compensated: Recording) -> TriedModel:
        """Compare the recordings of an axis without and with compensation."""
        fade_s = max(self.run.axes[each].compensation.fade_s for each in self.fits)
        axis, period_s = self.run.axes[name], self.run.period_s
        trial = judge(without, compensated, axis, period_s, fade_s)
        clipping = find_clipping(compensated, axis, period_s)
        return TriedModel(*self.fits[name], self.files[name], trial, name in self.scaled, clipping)


@dataclass(frozen=True, slots=True, eq=False)
class AxisTuning:
    """Result of tuning one axis."""

    candidates: tuple[TriedModel, ...]  # models that were tried
    file: Path  # model file of the best of them
    is_in_place: bool  # the file is the one that the configuration names
    gains: tuple[GainTrial, ...] = ()  # that were tried with the best model, the configured one first

    @property
    def recommended(self) -> GainTrial:
        """Gain with which the best model follows best and oscillates nowhere."""
        return min(self.gains, key=lambda each: each.trial.rank) if self.gains else GainTrial(None, self.best.trial)

    @property
    def best(self) -> TriedModel:
        """Best of the models; see `best_of`."""
        return best_of(self.candidates)


def best_of(candidates: tuple[TriedModel, ...]) -> TriedModel:
    """Return the model with the smallest following error; one that did harm loses to one that did not.

    First come models that helped (`Trial.has_helped`), among them those by which the axis never oscillated, among
    these those that made no motion worse. Then the smallest error of all motions decides (`Trial.error`).
    """
    return min(candidates, key=lambda each: each.trial.rank)


def motion_names(axes: Iterable[AxisTuning]) -> tuple[str, ...]:
    """Return the names of all motions that the axes made in their trials, in the order of the trials."""
    made = {motion.name for axis in axes for each in axis.candidates for motion in each.trial.motions}
    return tuple(name for name in MOTIONS if name in made)


def keep_best(
    axis: AxisConfig,
    candidates: tuple[TriedModel, ...],
    file: Path,
    gains: tuple[GainTrial, ...] = (),
    *,
    is_simulated: bool = False,
) -> AxisTuning:
    """Write the best model to ``file``, and to the file that the configuration names if it helped.

    An existing file that the configuration names is left as it is. So is a missing one if the drives are simulated: the
    real axis has another friction. Raises `FrictionHilError`: a file cannot be written.
    """
    best = best_of(candidates)
    model = best.content
    write_model(file, model)
    wanted = axis.model.source_path
    is_in_place = wanted is not None and not wanted.exists() and best.trial.has_helped and not is_simulated
    if wanted is not None and is_in_place:
        file = wanted
        write_model(file, model)
    return AxisTuning(candidates, file, is_in_place, gains)
