"""Reading of a YAML file into a checked section, with all mistakes reported at once."""

import re
from collections.abc import Collection
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from friction_hil.checked_yaml import text
from friction_hil.checked_yaml.messages import mistakes_of, validate
from friction_hil.checked_yaml.section import keys
from friction_hil.checked_yaml.text import Document, FieldPath
from friction_hil.errors import ConfigurationError, Problem

Model = TypeVar("Model", bound=BaseModel)


def read_section(path: str | Path, model: type[Model]) -> Model:
    """Read a YAML file with the keys of ``model``, e.g. the description of a drive.

    Raises `ConfigurationError`: the file cannot be read or has mistakes; ``problems`` lists them with their lines.
    """
    document = read_kind(path, keys(model))
    return validated(model, document.value, Origins(document), list(document.problems))


def read_kind(path: str | Path, names: Collection[str]) -> Document:
    """Read a YAML file that has at least one of the keys ``names``.

    A message about any other file has nothing of its content: a configuration that somebody else wrote may name a file
    that is nobody's business.

    Raises `ConfigurationError`: the file cannot be read, is not YAML, or has none of these keys.
    """
    expected = f"is not the file that belongs here: it has none of the keys {', '.join(names)}"
    other = ConfigurationError([Problem(str(path), None, "", expected)])
    try:
        document = text.read(path)
    except ConfigurationError as error:
        shows_content = any(problem.line is not None for problem in error.problems)
        if shows_content and not re.search(_line_of(names), Path(path).read_bytes(), re.MULTILINE):
            raise other from None
        raise
    if not isinstance(document.value, dict) or not set(names) & set(document.value):
        raise other
    return document


def _line_of(names: Collection[str]) -> bytes:
    """Return the pattern of a line that begins with one of the keys."""
    return rf"^\s*[\"']?(?:{'|'.join(map(re.escape, names))})[\"']?\s*:".encode()


class Origins:
    """Map from values to file, line and key, for a file that includes other files."""

    def __init__(self, main: Document) -> None:
        self._documents: dict[FieldPath, Document] = {(): main}
        # values whose file could not be read; further mistakes in them are not reported
        self.broken: list[FieldPath] = []

    def add(self, steps: FieldPath, document: Document) -> None:
        """Register that the value at the field path ``steps`` is in a file of its own."""
        self._documents[steps] = document

    def locate(self, steps: FieldPath, message: str) -> Problem:
        """Return a problem with the file and line of the value at the field path ``steps``."""
        start = max((known for known in self._documents if steps[: len(known)] == known), key=len)
        document, inner = self._documents[start], steps[len(start) :]
        return Problem(document.path, document.line(inner), field_name(inner), message)


def field_name(steps: FieldPath) -> str:
    """Format a field path, e.g. ``axes.x.shadows[0].name``."""
    text = "".join(f"[{step}]" if isinstance(step, int) else f".{step}" for step in steps)
    return text.removeprefix(".")


def validated(model: type[Model], value: Any, origins: Origins, problems: list[Problem]) -> Model:
    """Check plain values against ``model``; a `ConfigurationError`: there are mistakes.

    ``problems``: mistakes found earlier; new ones are appended.
    """
    known_lines = {(problem.path, problem.line) for problem in problems}
    result: Model | None = None
    try:
        result = validate(model, value)
    except ValidationError as error:
        for steps, message in mistakes_of(error, model, value):
            if any(steps[: len(broken)] == broken for broken in origins.broken):
                continue
            problem = origins.locate(steps, message)
            if problem.line is None or (problem.path, problem.line) not in known_lines:
                problems.append(problem)
    if problems or result is None:
        unique = dict.fromkeys(problems)
        raise ConfigurationError(sorted(unique, key=lambda problem: (problem.path, problem.line or 0)))
    return result
