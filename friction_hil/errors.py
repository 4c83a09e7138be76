"""Everything that can go wrong and is the user's to mend.

Each error carries the exit status of the command that meets it: 2 where the use or the configuration is
wrong, 1 where the world is (a drive that does not answer, a file that is cut off).
"""

import difflib
from collections.abc import Iterable
from dataclasses import dataclass


class FrictionHilError(Exception):
    """Base of all errors raised on purpose. The message is a complete sentence for the user.

    Parameters
    ----------
    detail : str
        What is wrong, and where.
    fix : str
        What would mend it, where that is said apart; the message has both.
    """

    exit_status = 1

    def __init__(self, detail: str = "", fix: str = "") -> None:
        super().__init__(f"{detail}; {fix}" if fix else detail)
        self.detail = detail
        self.fix = fix


class UsageError(FrictionHilError):
    """Wrong use: a flag, a name or an argument that does not fit. Example: an unknown model name."""

    exit_status = 2


class ParameterError(UsageError, ValueError):
    """A model parameter is missing, unknown, not finite or out of its bounds."""


@dataclass(frozen=True, slots=True)
class Problem:
    """One mistake in a file: where it stands and what would be right."""

    path: str
    line: int | None
    field: str
    message: str

    def __str__(self) -> str:
        where = self.path if self.line is None else f"{self.path}:{self.line}"
        return f"{where}: {self.field}: {self.message}" if self.field else f"{where}: {self.message}"


class ConfigurationError(UsageError):
    """A configuration or model file has mistakes; ``problems`` has all of them."""

    def __init__(self, problems: Iterable[Problem]) -> None:
        self.problems = tuple(problems)
        super().__init__("\n".join(map(str, self.problems)))


class OptionError(UsageError):
    """One key of one axis does not fit its drive or its bus.

    Parameters
    ----------
    axis : str
    key : str
        As in the configuration, with a dot before a key within it.
    text : str
        What would be right.
    """

    def __init__(self, axis: str, key: str, text: str) -> None:
        super().__init__(f"{axis}: {key}: {text}")
        self.axis, self.key, self.text = axis, key, text


class RecordingError(FrictionHilError):
    """A recording cannot be read, or lacks a column that is needed."""


class BusError(FrictionHilError):
    """The bus does not open or cannot send. Example: no such interface, no permission."""


class DriveError(FrictionHilError):
    """A drive does not answer, is not what the configuration says, lacks an object, or reports a fault."""


def choices(wrong: str, available: Iterable[str]) -> str:
    """Say what was close and what there is: ``did you mean 'lugre'? There are: coulomb, dahl, lugre``."""
    names = sorted(available)
    close = difflib.get_close_matches(wrong, names, n=1, cutoff=0.6)
    hint = f"did you mean {close[0]!r}? " if close else ""
    return f"{hint}There are: {', '.join(names) if names else 'none'}"
