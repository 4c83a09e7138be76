"""Changes of a run as events of its files: with the settings and models that a replay of their rows needs."""

import json
from collections.abc import Iterable
from typing import Any

import numpy as np

from friction_hil.daemon.control import journal
from friction_hil.daemon.control.on_trial import PROVEN
from friction_hil.recordings import columns
from friction_hil.recordings.recording import CHANGE, Array

Event = tuple[float, str, str]


class Changes:
    """Changes of the run, from the journal of the control socket, for one file after the other."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor  # memory of the journal; -1 for none

    def entries(self) -> dict[int, dict[str, Any]]:
        """Return the changes that the journal has, by number."""
        return _entries(self._descriptor)

    def of_file(self, names: list[str]) -> "FileChanges":
        """Return the changes of a file with columns of these names that begins now."""
        return FileChanges(self._descriptor, names.index(columns.CHANGE) if columns.CHANGE in names else None)


class FileChanges:
    """Changes that the rows of one file need: each file stands alone, and holds no others."""

    def __init__(self, descriptor: int, column: int | None) -> None:
        # memory of the journal, -1 for none; column with the number of the change in force
        self._descriptor, self._column = descriptor, column
        self._written = {0}  # numbers; 0: the configuration of the run

    def ahead_of(self, rows: Array, events: Iterable[Event]) -> list[Event]:
        """Return what has to be written ahead of rows: changes from before the file, and those whose event was lost.

        ``rows``: (n, width). ``events``: still to be written; changes among them follow in their turn.
        """
        if self._column is None or self._descriptor < 0:
            return []
        numbers = {int(number) for number in np.unique(rows[:, self._column]) if np.isfinite(number)}
        if numbers <= self._written:
            return []
        entries = self._entries()
        wanted = numbers | {
            model for number in numbers & entries.keys() for model in journal.models_of(entries[number])
        }
        wanted = {number for number in wanted - self._written if number in entries}
        wanted -= {int(text) for _, name, text in events if name == CHANGE}
        self._written |= wanted
        return [(0.0, CHANGE, json.dumps(entries[number])) for number in sorted(wanted)]

    def whole(self, event: Event) -> Event:
        """Return an event as it is recorded: for a change, the ring has room for its number only."""
        cycle, name, text = event
        if name == CHANGE:
            for number, entry in self._entries().items():
                if str(number) == text:
                    self._written.add(number)
                    return cycle, name, json.dumps(entry)
        return event

    def _entries(self) -> dict[int, dict[str, Any]]:
        return _entries(self._descriptor)


def _entries(descriptor: int) -> dict[int, dict[str, Any]]:
    """Return the entries of the journal, without what they say for now: when it is erased depends on the clock."""
    known = [] if descriptor < 0 else journal.entries(descriptor)
    return {entry["number"]: {key: value for key, value in entry.items() if key != PROVEN} for entry in known}
