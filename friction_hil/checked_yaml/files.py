"""From a YAML file to a checked section, with all mistakes at once."""

from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from friction_hil.checked_yaml import text
from friction_hil.checked_yaml.messages import mistakes_of, validate
from friction_hil.checked_yaml.text import Document, Steps
from friction_hil.errors import ConfigurationError, Problem

Model = TypeVar("Model", bound=BaseModel)


def read_section(path: str | Path, model: type[Model]) -> Model:
    """Read a YAML file that has the keys of ``model``; drivers keep descriptions of drives in such files.

    Raises
    ------
    ConfigurationError
        It cannot be read or has mistakes; ``problems`` has each with its line.
    """
    document = text.read(path)
    return validated(model, document.value, Origins(document), list(document.problems))


class Origins:
    """Find the file, line and key that a value comes from, where a file includes others.

    Attributes
    ----------
    broken : list of Steps
        Values whose file could not be read: no more is reported of them.
    """

    def __init__(self, main: Document) -> None:
        self._documents: dict[Steps, Document] = {(): main}
        self.broken: list[Steps] = []

    def add(self, steps: Steps, document: Document) -> None:
        """Note that the value at ``steps`` stands in a file of its own."""
        self._documents[steps] = document

    def locate(self, steps: Steps, message: str) -> Problem:
        """Return the mistake with the file and line of the value at ``steps``."""
        start = max((known for known in self._documents if steps[: len(known)] == known), key=len)
        document, inner = self._documents[start], steps[len(start) :]
        return Problem(document.path, document.line(inner), field_name(inner), message)


def field_name(steps: Steps) -> str:
    """Write the way to a value, e.g. ``axes.x.shadows[0].name``."""
    text = "".join(f"[{step}]" if isinstance(step, int) else f".{step}" for step in steps)
    return text.removeprefix(".")


def validated(model: type[Model], value: Any, origins: Origins, problems: list[Problem]) -> Model:
    """Check plain values against ``model``.

    Parameters
    ----------
    problems : list of Problem
        Mistakes that are known already; those that are found are appended.

    Raises
    ------
    ConfigurationError
        There are mistakes, known or found.
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
