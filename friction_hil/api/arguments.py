"""Arguments of the public functions: what several of them have in common, checked as the command line checks it."""

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any

from friction_hil.errors import UsageError, choices
from friction_hil.models.files import model_from_argument
from friction_hil.models.model_file import ModelFile
from friction_hil.recordings import Recording
from friction_hil.recordings.given import Given, read_given
from friction_hil.recordings.mapping import split_factors
from friction_hil.tuning.settings import ShowStep

Progress = Callable[[str, float | None], object]
"""Called with the stage and the done share of its steps, 0 to 1; None if their number is not known."""


def read(
    given: Given,
    *,
    axis: str | None,
    column: Mapping[str, str] | None,
    scale: Mapping[str, float] | None,
    rate: float | None,
    where: str | None,
    **options: Any,  # of `read_given`
) -> list[Recording]:
    """Read recordings, if any, by the options that all commands have; raises as `read_given` does."""
    columns, factors = split_factors(column or {})
    factors |= scale or {}
    return read_given(given, axis, columns=columns, scale=factors, where=where, rate_hz=rate, **options)


def require_recording(given: Given) -> None:
    """Raise UsageError if there is none."""
    if is_empty(given):
        raise UsageError("there is no recording: give a path, a Recording, arrays or a data frame, or several")


def is_empty(given: Given) -> bool:
    """True if no recordings are given."""
    return given is None or (isinstance(given, Sequence) and not len(given))


def shown_by(progress: Progress | None) -> ShowStep:
    """Return the function that tells a callback of the steps."""

    def show(text: str, number: int = 0, count: int | None = None, /) -> None:
        if progress is not None:
            progress(text, (number - 1) / count if number and count else None)

    return show


def families(models: str | Sequence[str]) -> tuple[str, ...]:
    """Return the families in ``all``, in ``coulomb,lugre`` or in a sequence of names; empty for all of them."""
    if not isinstance(models, str):
        return tuple(models)
    return () if models == "all" else tuple(map(str.strip, models.split(",")))


def model_of(model: Any) -> ModelFile:
    """Return the model file of ``--model``'s argument, of a model file or of a result that has one."""
    if isinstance(model, ModelFile):
        return model
    own = getattr(model, "model", None)
    return own if isinstance(own, ModelFile) else model_from_argument(str(model))


def check_choice(name: str, value: object, known: Collection[str]) -> None:
    """Raise UsageError if an argument has a value that it cannot have."""
    if value not in known:
        raise UsageError(f"{name}={value!r} is not known; {choices(str(value), known)}")


def check_numbers(at_least: float = -math.inf, **numbers: float | None) -> None:
    """Raise UsageError for a number that is not finite or too small; None is none."""
    for name, value in numbers.items():
        if value is not None and not at_least <= value < math.inf:
            text = "a finite number" if at_least == -math.inf else f"a number from {at_least:g}"
            raise UsageError(f"{name}={value!r}: {text} is needed")
