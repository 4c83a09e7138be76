"""Changes of a run as events of its files: with the settings and models that a replay of their rows needs."""

import json
from collections import deque
from collections.abc import Iterable
from typing import Any

import numpy as np

from friction_hil.daemon.control import journal
from friction_hil.recordings import columns
from friction_hil.recordings.mcap_writer import McapWriter
from friction_hil.recordings.recording import CHANGE, Array

Event = tuple[float, str, str]


class FileChanges:
    """Changes that the rows of one file need: each file stands alone, and holds no others.

    ``journal``: descriptor of that of the run, -1 for none. ``names``: columns of a file that begins now.
    """

    def __init__(self, journal: int, names: list[str]) -> None:
        self._journal = journal
        self._column = names.index(columns.CHANGE) if columns.CHANGE in names else None
        self._written = {0}  # numbers; 0: the configuration of the run

    def ahead_of(self, rows: Array, events: Iterable[Event]) -> list[Event]:
        """Return what has to be written ahead of rows: changes from before the file, and those whose event was lost.

        ``rows``: (n, width). ``events``: still to be written; changes among them follow in their turn.
        """
        if self._column is None or self._journal < 0:
            return []
        numbers = {int(number) for number in np.unique(rows[:, self._column]) if np.isfinite(number)}
        if numbers <= self._written:
            return []
        entries = recorded_entries(self._journal)
        wanted = numbers | {
            model for number in numbers & entries.keys() for model in journal.models_of(entries[number])
        }
        wanted = {number for number in wanted - self._written if number in entries}
        wanted -= {int(text) for _, name, text in events if name == CHANGE}
        self._written |= wanted
        return [(0.0, CHANGE, json.dumps(entries[number])) for number in sorted(wanted)]

    def write(self, writer: McapWriter, events: deque[Event], until: float) -> None:
        """Write the events up to a cycle, in their order, and remove them."""
        while events and events[0][0] <= until:
            cycle, name, text = events.popleft()
            if name == CHANGE:  # the ring has room for its number only
                for number, entry in recorded_entries(self._journal).items():
                    if str(number) == text:
                        self._written.add(number)
                        text = json.dumps(entry)
                        break
            writer.write_event(cycle, name, text)


def recorded_entries(descriptor: int) -> dict[int, dict[str, Any]]:
    """Return the entries of the journal by number, without what they say for now: its erasure depends on the clock."""
    known = [] if descriptor < 0 else journal.entries(descriptor)
    return {entry["number"]: {key: value for key, value in entry.items() if key != journal.PROVEN} for entry in known}
