"""What is exported: a model file, perhaps with a compensator, and where it comes from."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from friction_hil import __version__
from friction_hil.compensator import Compensator
from friction_hil.models.model_file import ModelFile
from friction_hil.printable import printable


@dataclass(frozen=True, slots=True)
class Subject:
    """A model with its provenance.

    Attributes
    ----------
    name : str
        Name in the target's language, an identifier in small letters.
    model_file : ModelFile
    origin : str
        File or text that it was read from, for the comment; empty if it is not known.
    compensator : Compensator or None
        Compensator that is exported beside the model.
    """

    name: str
    model_file: ModelFile
    origin: str = ""
    compensator: Compensator | None = None


def provenance(subject: Subject) -> list[str]:
    """Return the lines of the comment: software, model, recordings, errors, standard errors, range of validity."""
    return [printable(line) for line in _provenance(subject)]


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
    for recording in fit.get("recordings") or []:
        path = recording.get("path", recording) if isinstance(recording, Mapping) else recording
        yield f"Recording: {path}"
    for key, text in (("train", "Error of the fit"), ("cross_validation", "of cross-validation"),
                      ("validation", "of other recordings")):  # fmt: skip
        error = fit.get(key)
        if isinstance(error, Mapping) and "rmse" in error:
            relative = f", {100.0 * error['relative_error']:.3g} %" if "relative_error" in error else ""
            yield f"{text}: {error['rmse']:.4g} RMS{relative}"
    ranges = fit.get("range")
    if isinstance(ranges, Mapping):
        for name, ends in ranges.items():
            yield f"Valid for {name}: {_value(ends)}"
    for flag in fit.get("flags") or []:
        yield f"Flag: {flag}"


def _error(fit: Mapping[str, Any] | None, name: str) -> str:
    error = ((fit or {}).get("standard_errors") or {}).get(name)
    return f" +- {error:.2g}" if isinstance(error, float | int) else ""


def _value(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.10g}"
    if isinstance(value, Mapping):
        return ", ".join(f"{name} {_value(each)}" for name, each in value.items())
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(_value, value)) + "]"
    return str(value)
