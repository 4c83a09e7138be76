"""Errors that the user can correct.

Each error has the exit status of the command that meets it: 2 for wrong use or a wrong configuration, 1 for other
failures, such as a drive that does not answer or a truncated file.
"""

import difflib
import traceback
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

MOST_PRINTED = 20  # mistakes of a file
_MOST_CHOICES = 100  # that a message lists


class FrictionHilError(Exception):
    """Base class of all errors raised deliberately. The message is a complete sentence for the user.

    Parameters
    ----------
    detail : str
        Description of the mistake or failure, with its location.
    fix : str
        Remedy, if it is given separately; the message contains both.
    code : str
        Code under which a page explains the message, e.g. ``FH-250``; the message ends with it.
    """

    exit_status = 1

    def __init__(self, detail: str = "", fix: str = "", code: str = "") -> None:
        message = f"{detail}; {fix}" if fix else detail
        super().__init__(f"{message} [{code}]" if code else message)
        self.detail = detail
        self.fix = fix
        self.code = code


class UsageError(FrictionHilError):
    """Wrong use: an invalid flag, name or argument. Example: an unknown model name."""

    exit_status = 2


class ParameterError(UsageError, ValueError):
    """A model parameter is missing, unknown, not finite or out of bounds."""


@dataclass(frozen=True, slots=True)
class Problem:
    """One mistake in a file, with its location and what is expected instead."""

    path: str
    line: int | None
    field: str
    message: str

    def __str__(self) -> str:
        where = self.path if self.line is None else f"{self.path}:{self.line}"
        return f"{where}: {self.field}: {self.message}" if self.field else f"{where}: {self.message}"


class ConfigurationError(UsageError):
    """A configuration or model file has mistakes; ``problems`` lists all of them, the message the first ones."""

    def __init__(self, problems: Iterable[Problem]) -> None:
        self.problems = tuple(problems)
        super().__init__("\n".join([*map(str, self.problems[:MOST_PRINTED]), *more_problems(self.problems)]))


def more_problems(problems: Sequence[Problem]) -> list[str]:
    """Return the line that stands for the mistakes beyond the first ones, if there are more."""
    more = len(problems) - MOST_PRINTED
    return [f"{problems[0].path}: and {more} more mistake{'s' * (more > 1)}"] if more > 0 else []


class OptionError(UsageError):
    """A key of an axis does not suit its drive or its bus.

    Parameters
    ----------
    axis : str
        Name of the axis.
    key : str
        Key in the configuration; nested keys are separated by dots.
    text : str
        Description of the mistake and of what is expected.
    """

    def __init__(self, axis: str, key: str, text: str) -> None:
        super().__init__(f"{axis}: {key}: {text}")
        self.axis, self.key, self.text = axis, key, text


class RecordingError(FrictionHilError):
    """A recording cannot be read, or lacks a required column."""


class BusError(FrictionHilError):
    """The bus cannot be opened, or cannot send. Example: no such interface, no permission."""


class DriveError(FrictionHilError):
    """A drive does not answer, differs from the configuration, lacks an object, or reports a fault."""


def internal_error(error: Exception) -> str:
    """Name an error of the program itself, with the place where it arose: it costs a part of the work, not all."""
    own = [each for each in traceback.extract_tb(error.__traceback__) if f"{__package__}" in Path(each.filename).parts]
    text = f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
    if not own:
        return f"an internal error ({text})"
    parts = Path(own[-1].filename).parts
    begin = len(parts) - 1 - parts[::-1].index(f"{__package__}")
    return f"an internal error ({text}, at {'/'.join(parts[begin:])}:{own[-1].lineno})"


def choices(wrong: str, available: Iterable[str]) -> str:
    """Suggest a similar name and list all, as the end of a sentence.

    With a similar name it reads ``did you mean 'lugre'? There are: coulomb, dahl, lugre``, else
    ``there are: coulomb, dahl, lugre``.
    """
    names = sorted(available)
    close = difflib.get_close_matches(wrong, names, n=1, cutoff=0.6)
    there_are = f"did you mean {close[0]!r}? There are" if close else "there are"
    more = f" and {len(names) - _MOST_CHOICES} more" if len(names) > _MOST_CHOICES else ""
    return f"{there_are}: {', '.join(names[:_MOST_CHOICES]) if names else 'none'}{more}"
