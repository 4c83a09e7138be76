"""Results of an identification as a model file and as the JSON object of ``identify --json``."""

import math
from typing import Any

import numpy as np

from friction_hil import __version__
from friction_hil.identification import thresholds
from friction_hil.identification.fits import Fit
from friction_hil.identification.identify import Identification
from friction_hil.identification.mechanics import Mechanics
from friction_hil.identification.prediction_errors import PredictionError
from friction_hil.identification.quantities import Quantity
from friction_hil.identification.regression import BACK_EMF
from friction_hil.models.model_file import ModelFile
from friction_hil.numerics.readable import named_constants

_DIGITS = 10  # significant digits in a model file: far more than any standard error justifies, and still readable


def model_file(identification: Identification, fit: Fit | None = None, *, signal: str = "torque") -> ModelFile:
    """Return the model file of a fit, the chosen one by default, with its provenance.

    ``signal``: what the column torque was made of; stated in the file if the gain of that signal was identified. A
    `ConfigurationError`: the values are inconsistent, which those of a fit are not.
    """
    return ModelFile.model_validate(as_model_file(identification, fit, signal=signal))


def as_model_file(identification: Identification, fit: Fit | None = None, *, signal: str = "torque") -> dict[str, Any]:
    """Return `model_file` as plain values, for YAML."""
    fit = identification.best if fit is None else fit
    parameters, modifiers = fit.friction
    mechanics = fit.mechanics
    friction: dict[str, Any] = {"model": fit.structure.family, "parameters": _plain(parameters)}
    if modifiers:
        friction["modifiers"] = _plain(modifiers)
    content = {
        "version": 1,
        "axis": identification.settings.axis,
        "friction": friction,
        "mechanics": _mechanics(mechanics),
    }
    if fit.drive:
        content["torque_signal"] = {"column": signal, **_plain(_drive(fit, identification))}
    return {**content, "fit": _provenance(identification, fit)}


def _mechanics(mechanics: dict[str, float]) -> dict[str, Any]:
    gravity = {name: mechanics[f"gravity.{name}"] for name in ("constant", "sine", "cosine")}
    return dict(_plain({"inertia": mechanics["inertia"], "offset": mechanics["offset"], "gravity": gravity}))


def _provenance(identification: Identification, fit: Fit) -> dict[str, Any]:
    settings, records = identification.settings, identification.records
    curves = fit.curves
    content: dict[str, Any] = {
        "software": f"friction_hil {__version__}",
        "recordings": _recordings(identification.records),
        "rows": len(curves.measured),
        "lowpass_hz": records[0].lowpass_hz,
        "decimation": records[0].decimation,
        "refined": fit.is_refined,
        "loss": "huber" if settings.is_robust else "squares",
        "held": dict(settings.held),
        "chosen": identification.reason,
        "train": _error(fit.train),
        "cross_validation": _error(fit.cross_validation),
        "standard_errors": {name: error for name, error in standard_errors(fit).items() if error is not None},
        "correlations": [list(pair) for pair in fit.inference.pairs()],
        "range": {
            "velocity": [float(np.min(curves.velocity)), float(np.max(curves.velocity))],
            "position": [float(np.min(curves.position)), float(np.max(curves.position))],
            "acceleration": [float(np.min(curves.acceleration)), float(np.max(curves.acceleration))],
        },
        "flags": list(fit.flags),
    }
    if fit.across_speeds is not None:
        content["across_speeds"] = _error(fit.across_speeds)
    if fit.validation is not None:
        content["validation"] = {**_error(fit.validation), "recordings": _recordings(identification.validation)}
    return dict(_plain(content))


def _recordings(records: Any) -> list[dict[str, Any]]:
    rows: dict[str, int] = {}
    for record in records:
        rows[record.path] = record.rows
    return [{"path": path, "rows": count} for path, count in rows.items()]


def standard_errors(fit: Fit) -> dict[str, float | None]:
    """Return the standard error of each fitted parameter; None if it is at a bound or not determined."""
    errors = fit.inference.standard_errors
    return {name: errors[name] if name in errors and math.isfinite(errors[name]) else None for name in fit.values}


def _drive(fit: Fit, identification: Identification) -> dict[str, float]:
    """Return ``gain``, N m per unit of the signal, and ``back_emf``, N m s/rad, if the gain was identified."""
    if not fit.drive:
        return {}
    held = {name: value for name, value in identification.settings.held.items() if name == BACK_EMF}
    return {name.removeprefix("drive."): value for name, value in {**fit.drive, **held}.items()}


def _error(error: PredictionError) -> dict[str, float]:
    return {"rmse": error.rmse, "relative_error": error.relative_error}


def _plain(value: Any) -> Any:
    """Convert values to dicts, lists and floats rounded to `_DIGITS`, as YAML and the model file take them."""
    if isinstance(value, dict):
        return {str(key): _plain(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(each) for each in value]
    if isinstance(value, float | np.floating):
        number = float(value)
        return float(f"{number:.{_DIGITS}g}") if math.isfinite(number) else number
    return value


def add_mechanics(content: dict[str, Any], found: Mechanics) -> None:
    """Add what was found behind the motor to the plain values of a model file; nothing if nothing was found."""
    if found.load is not None:
        load = {name: max(value, 0.0) for name, value in found.load.items()}
        content["mechanics"] |= _plain({"inertia": found.inertia, "load": load})
    if found.backlash > 0.0:
        content["mechanics"]["backlash"] = _plain(found.backlash)
    content["fit"]["flags"] += list(found.flags)
    known = {each.key: _quantity(each) for each in found.quantities if each.value is not None}
    content["fit"]["mechanics"] = _plain(known)


def mechanics_as_json(found: Mechanics) -> dict[str, Any]:
    """Return the object ``mechanics`` of ``identify --json`` and ``tune --json``."""
    response = found.response
    return {
        "quantities": {each.key: _quantity(each) for each in found.quantities},
        "flags": list(found.flags),
        "notes": list(found.notes),
        "frequency_response": None
        if response is None
        else {
            "frequency_hz": response.frequency_hz.tolist(),
            "gain": np.abs(response.response).tolist(),
            "phase_rad": np.unwrap(np.angle(response.response)).tolist(),
            "coherence": response.coherence.tolist(),
            "is_used": response.is_used.tolist(),
            "has_instrument": response.has_instrument,
        },
    }


def _quantity(each: Quantity) -> dict[str, Any]:
    return {
        "label": each.label,
        "value": each.value,
        "standard_error": each.error if each.error is not None and math.isfinite(each.error) else None,
        "unit": each.unit,
        "source": each.source or None,
        "missing": each.missing or None,
    }


def as_json(identification: Identification) -> dict[str, Any]:
    """Return the object that ``identify --json`` prints."""
    return {
        "best": identification.best.label,
        "reason": identification.reason,
        "recordings": _recordings(identification.records),
        "problems": list(dict.fromkeys(problem for record in identification.records for problem in record.problems)),
        "notes": list(identification.notes),
        "fits": [_fit(each, identification) for each in identification.fits],
        "thresholds": named_constants(thresholds),
    }


def _fit(fit: Fit, identification: Identification) -> dict[str, Any]:
    parameters, modifiers = fit.friction
    return {
        "model": fit.structure.family,
        "label": fit.label,
        "refined": fit.is_refined,
        "parameters": parameters,
        "modifiers": modifiers,
        "standard_errors": standard_errors(fit),
        "correlations": {"names": fit.inference.names, "matrix": fit.inference.correlations},
        "mechanics": _mechanics(fit.mechanics),
        "drive": _drive(fit, identification) or None,
        "train": _error(fit.train),
        "cross_validation": _error(fit.cross_validation),
        "across_speeds": None if fit.across_speeds is None else _error(fit.across_speeds),
        "validation": None if fit.validation is None else _error(fit.validation),
        "flags": list(fit.flags),
    }
