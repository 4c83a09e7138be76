"""Model files of the fits of a tuning."""

import os
import sys
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
from friction_hil.tuning.torque_ratio import with_torque_ratio


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
