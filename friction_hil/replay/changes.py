"""Changes of a running daemon in its recording: which settings each row was computed with."""

import itertools
import json
from collections.abc import Mapping
from typing import Any

import numpy as np

from friction_hil.compensator import INPUTS, Compensator
from friction_hil.config import AxisConfig, Configuration, from_dict, self_contained
from friction_hil.daemon.assembly import make_compensator
from friction_hil.drive import AxisFacts
from friction_hil.errors import ConfigurationError, RecordingError
from friction_hil.friction.kernel import STATE_ROOM
from friction_hil.numerics.jit import Array
from friction_hil.recordings import Recording, columns
from friction_hil.recordings.recording import CHANGE


class RecordedChanges:
    """Changes of the compensator of one axis.

    The column ``change`` has the number of the last change in force in each row; the event of that number has the
    settings of every axis after it, with the model where that is another one.

    ``configuration`` is that at the start of the run.
    """

    def __init__(self, recording: Recording, configuration: Configuration, facts: AxisFacts) -> None:
        self._recording, self._configuration, self._facts = recording, configuration, facts
        self._numbers = np.zeros(len(recording))
        if columns.CHANGE in recording.columns:  # earlier versions had no changes
            self._numbers = np.nan_to_num(recording.columns[columns.CHANGE], nan=0.0)
        self._entries = _entries(recording)
        self._records: dict[int, Any] = {}

    def replay(self, compensator: Compensator, first: int, end: int) -> dict[str, Array]:
        """Compute the rows from ``first`` up to ``end`` with the settings of each; as `Compensator.replay_all`.

        ``compensator`` is in the state before the row ``first``. Raises `RecordingError`: what it was changed to is not
        in the recording.
        """
        numbers = self._numbers[first:end]
        starts = [0, *(np.flatnonzero(np.diff(numbers)) + 1).tolist(), len(numbers)]
        compensator.use(self._record(int(numbers[0])))  # the state of a row is that after a change in its cycle
        parts = []
        for begin, stop in itertools.pairwise(starts):
            if begin:
                self._adopt(compensator, int(numbers[begin]))
            parts.append(compensator.replay_all(inputs_of(self._recording, first + begin, first + stop)))
        return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}

    def _adopt(self, compensator: Compensator, number: int) -> None:
        axis = self._entry(number)
        if not axis["is_adopted"]:
            return
        friction = None
        if "friction" in axis:
            friction = np.zeros(STATE_ROOM)
            friction[: len(axis["friction"])] = axis["friction"]
        compensator.adopt(self._record(number), friction)

    def _record(self, number: int) -> Any:
        """Return the settings of the compensator after a change; 0: at the start."""
        if number not in self._records:
            axis = _settings(self._recording, self._configuration, self._entries, number)
            made = make_compensator(axis, axis.model, self._facts, self._configuration.period_s)
            self._records[number] = made.record
        return self._records[number]

    def _entry(self, number: int) -> dict[str, Any]:
        return _entry(self._recording, self._entries, number)


def settings_after(recording: Recording, configuration: Configuration, number: int) -> AxisConfig:
    """Return the settings of a recorded axis after a change.

    ``configuration``: at the start of the run. ``number``: as in the column ``change``; 0: before the first one. Raises
    `RecordingError`: the change is not in the recording.
    """
    return _settings(recording, configuration, _entries(recording), number)


def _settings(
    recording: Recording, configuration: Configuration, entries: Mapping[int, Mapping[str, Any]], number: int
) -> AxisConfig:
    name = recording.axis
    if number == 0:
        return configuration.axes[name]
    entry = _entry(recording, entries, number)
    values = self_contained(configuration)
    values["axes"][name]["compensation"] = entry["compensation"]
    if entry["model_of"]:
        values["axes"][name]["model"] = _entry(recording, entries, entry["model_of"])["model"]
    try:
        return from_dict(values, f"{recording.path} (change {number})", reads_files=False).axes[name]
    except ConfigurationError as error:
        raise RecordingError(str(error)) from None


def _entry(recording: Recording, entries: Mapping[int, Mapping[str, Any]], number: int) -> dict[str, Any]:
    try:
        entry: dict[str, Any] = entries[number][recording.axis]
    except KeyError:
        raise RecordingError(
            f"{recording.path}: change {number} of the settings, with which rows of axis {recording.axis!r} were "
            "computed, is not in the recording"
        ) from None
    return entry


def inputs_of(recording: Recording, first: int, end: int) -> list[Array]:
    """Return the inputs of the compensator in the rows from ``first`` up to ``end``."""
    return [np.ascontiguousarray(recording.columns[name][first:end]) for name in INPUTS]


def _entries(recording: Recording) -> dict[int, dict[str, Any]]:
    """Return the settings of the axes after each change, by its number."""
    found = {}
    for event in recording.events:
        if event.name != CHANGE:
            continue
        try:
            entry = json.loads(event.text)
            found[int(entry["number"])] = entry["axes"]
        except (ValueError, TypeError, KeyError):  # that of a recording without a journal has only a number
            continue
    return found
