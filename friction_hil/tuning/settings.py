"""Settings of a tuning, and the dialog with its user."""

import os
from collections.abc import Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from friction_hil.config import Configuration
from friction_hil.errors import UsageError, choices


@dataclass(frozen=True, slots=True)
class TuneSettings:
    """Axes to tune, models to try, and the folder for the results."""

    folder: Path  # for recordings, model files and reports; new or empty
    names: tuple[str, ...] = ()  # axes to tune; empty: all
    families: tuple[str, ...] = ()  # of friction models to fit; empty: all
    is_fault_reset_wanted: bool = False  # this and the next two: as of `friction_hil.daemon.session.SessionSettings`
    is_paced_by_sync: bool = False
    is_status_shown: bool = False
    is_shaken: bool = False  # each axis is shaken too, to find resonances and what is behind the motor
    is_simulated: bool = False  # the drives are: their friction is not written to the file that the configuration names


class ShowStep(Protocol):
    """Shows the current step of a long computation."""

    def __call__(self, text: str, number: int = 0, count: int | None = None, /) -> None:
        """Show that step ``number`` of ``count`` begins; 0 without a number, None if their number is not known."""
        ...


class Dialog(Protocol):
    """Messages to the user, and questions. While axes move, nothing is asked."""

    def report(self, line: str) -> None:
        """Show a detail of the progress or of what was found."""
        ...

    def tell(self, line: str) -> None:
        """Show a line that everybody has to see."""
        ...

    def confirm(self, motion: str) -> None:
        """Ask whether the axes may move now as described; raise ``click.Abort`` if not."""
        ...

    def working(self, text: str) -> AbstractContextManager[ShowStep]:
        """Show that a long computation goes on; the function that is given shows its current step."""
        ...


def chosen_axes(configuration: Configuration, wanted: Sequence[str]) -> tuple[str, ...]:
    """Return the axes to tune: those wanted, or all; a `UsageError`: there is no such axis."""
    for name in wanted:
        if name not in configuration.axes:
            raise UsageError(f"no axis is called {name!r}; {choices(name, configuration.axes)}")
    return tuple(dict.fromkeys(wanted)) or tuple(configuration.axes)


def claim(folder: Path) -> None:
    """Create the folder of the results; a `UsageError`: it is not empty, or not writable."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        is_empty = not any(folder.iterdir())
    except OSError as error:
        raise UsageError(f"{folder} cannot be made: {error.strerror}; name another folder with --output") from None
    if not os.access(folder, os.W_OK):
        raise UsageError(f"{folder} cannot be written: permission denied; name another folder with --output")
    if not is_empty:
        raise UsageError(f"{folder} is not empty, and nothing in it is replaced; name another folder with --output")
