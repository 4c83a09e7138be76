"""What is exported: a model file, perhaps with a compensator, and where it comes from."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeGuard

from friction_hil import __version__
from friction_hil.compensator import Compensator
from friction_hil.models.model_file import ModelFile
from friction_hil.printable import on_one_line


@dataclass(frozen=True, slots=True)
class Subject:
    """A model with its provenance."""

    name: str  # in the target's language, an identifier in small letters
    model_file: ModelFile
    origin: str = ""  # file or text that it was read from, for the comment; empty if it is not known
    compensator: Compensator | None = None  # that is exported beside the model


def provenance(subject: Subject) -> list[str]:
    """Return the lines of the comment: software, model, recordings, errors, standard errors, range of validity."""
    return [on_one_line(line) for line in _provenance(subject)]


def _provenance(subject: Subject) -> Iterator[str]:
    file = subject.model_file
    yield f"Made by friction_hil {__version__}{f' from {subject.origin}' if subject.origin else ''}."
    yield f"Model: {file.friction.model}; units: {'rad, N m' if file.axis == 'rotary' else 'm, N'}, s."
    parameters = file.friction_model.parameters
    for name, value in parameters.items():
        yield f"  {name}: {_value(value)}{_error(file.fit, name)}"
    for name, content in file.friction_model.modifiers.items():
        yield f"  {name}: {_value(content)}"
    yield from _fit(file.fit)


def _fit(fit: Mapping[str, Any] | None) -> Iterator[str]:
    if not fit:
        yield "The model file does not say what recording, errors and range it comes from."
        return
    if "software" in fit:
        yield f"Identified by {fit['software']}."
    for recording in _listed(fit.get("recordings")):
        path = recording.get("path", recording) if isinstance(recording, Mapping) else recording
        yield f"Recording: {path}"
    for key, text in (("train", "Error of the fit"), ("cross_validation", "of cross-validation"),
                      ("validation", "of other recordings")):  # fmt: skip
        error = fit.get(key)
        if isinstance(error, Mapping) and _is_number(error.get("rmse")):
            relative = error.get("relative_error")
            percent = f", {100.0 * relative:.3g} %" if _is_number(relative) else ""
            yield f"{text}: {error['rmse']:.4g} RMS{percent}"
    ranges = fit.get("range")
    if isinstance(ranges, Mapping):
        for name, ends in ranges.items():
            yield f"Valid for {name}: {_value(ends)}"
    for flag in _listed(fit.get("flags")):
        yield f"Flag: {flag}"


def _error(fit: Mapping[str, Any] | None, name: str) -> str:
    errors = (fit or {}).get("standard_errors")
    error = errors.get(name) if isinstance(errors, Mapping) else None
    return f" +- {error:.2g}" if _is_number(error) else ""


def _listed(value: object) -> Sequence[Any]:
    """Return what stands in a list; a model file that somebody wrote by hand may have one value in its place."""
    if value is None:
        return []
    return value if isinstance(value, list | tuple) else [value]


def _is_number(value: object) -> TypeGuard[float]:
    return isinstance(value, float | int) and not isinstance(value, bool) and math.isfinite(value)


def _value(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.10g}"
    if isinstance(value, Mapping):
        return ", ".join(f"{name} {_value(each)}" for name, each in value.items())
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(_value, value)) + "]"
    return str(value)
