"""The model of an axis that is kept after the trials, and its file."""

import os
import sys
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from friction_hil.checked_yaml.text import dump
from friction_hil.config import AxisConfig
from friction_hil.errors import FrictionHilError, OptionError
from friction_hil.identification import Fit, Identification
from friction_hil.identification.export import add_mechanics, as_model_file
from friction_hil.identification.mechanics import Mechanics
from friction_hil.identification.thresholds import VAGUE
from friction_hil.models.model_file import ModelFile
from friction_hil.tuning.gains import Clipping, GainTrial
from friction_hil.tuning.torque_ratio import with_torque_ratio
from friction_hil.tuning.trial import Trial
from friction_hil.tuning.trial_motions import MOTIONS
from friction_hil.tuning.two_steps import label

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
        return f"{label(self.identification, self.fit)}{SCALED if self.is_scaled else ''}"


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


def model_content(
    found: Identification, fit: Fit, axis: AxisConfig, mechanics: Mechanics | None = None
) -> dict[str, Any]:
    """Return the model file of a fit as plain values, with what was found behind the motor.

    Delays and the ratio of reported to commanded torque, which no recording without compensation shows, are the axis's
    former ones. So is an inertia that the recording does not determine: the daemon feeds it forward in mode cst.
    """
    model = as_model_file(found, fit)
    before = axis.model.mechanics
    model["mechanics"] |= {"delay_s": before.delay_s, "torque_lag_s": before.torque_lag_s}
    if problem := inertia_problem(fit):
        former = before.inertia if before.inertia > sys.float_info.min else 0.0  # the stand-in for a missing file
        model["mechanics"]["inertia"] = former * before.torque_ratio  # in the reported torque, as the others
        kept = f"the former one, {former:g}, is kept" if former else "0 is written, so that nothing is fed forward"
        model["fit"]["flags"].append(f"{problem}: {kept}")
    if mechanics is not None:
        add_mechanics(model, mechanics)
    return model if before.torque_ratio == 1.0 else with_torque_ratio(model, before.torque_ratio)


def inertia_problem(fit: Fit) -> str:
    """Return why the inertia of a fit is not to be used; empty if the recording determines it."""
    inertia = fit.mechanics["inertia"]
    error = fit.inference.standard_errors.get("inertia")
    if error is None and inertia > 0.0:  # held by the user
        return ""
    if error is not None and error <= VAGUE * inertia:
        return ""
    stated = "" if error is None else f", its standard error {error:.3g}"
    return f"the recording does not determine the inertia ({inertia:.3g}{stated})"


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
    model = {**best.model, "fit": {**best.model["fit"], "trial": best.trial.figures}}
    write_model(file, model)
    wanted = axis.model.source_path
    is_in_place = wanted is not None and not wanted.exists() and best.trial.has_helped and not is_simulated
    if wanted is not None and is_in_place:
        file = wanted
        write_model(file, model)
    return AxisTuning(candidates, file, is_in_place, gains)


def write_model(path: Path, model: dict[str, Any]) -> None:
    """Write a model file after checking that it can be read again; a `FrictionHilError`: it cannot be written."""
    ModelFile.model_validate(model)
    try:
        path.write_text(dump(model), encoding="utf-8")
    except OSError as error:
        raise FrictionHilError(f"{path} cannot be written: {error.strerror}") from None


def refuse_unwritable_model(name: str, axis: AxisConfig) -> None:
    """Refuse a model file that cannot be created where the configuration names it, before any axis moves for it.

    Raises `OptionError`: the folder is missing or not writable.
    """
    wanted = axis.model.source_path
    if wanted is None or wanted.exists():
        return
    if not wanted.parent.is_dir():
        raise OptionError(name, "model", f"there is no folder {wanted.parent} to make it in")
    if not os.access(wanted.parent, os.W_OK):
        raise OptionError(name, "model", f"cannot be made: {wanted.parent} is not writable")
