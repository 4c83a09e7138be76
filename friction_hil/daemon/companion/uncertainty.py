"""The column ``compensation_uncertainty`` of the rows that are written: from the tables of the models in force."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from friction_hil.daemon.companion.changes import recorded_entries
from friction_hil.daemon.companion.job import Job
from friction_hil.recordings import columns
from friction_hil.recordings.recording import Array

_KEPT = 8  # changes: those that rows of the ring may have
_NEEDED = (columns.CHANGE, columns.UNCERTAINTY, "velocity_estimate")


class UncertaintyColumn:
    """Fill the column in rows of the ring, in which the loop leaves it empty."""

    def __init__(self, job: Job, journal: int) -> None:
        self._job, self._journal = job, journal
        self._width = len(job.columns) + job.state_width
        self._change, self._uncertainty, self._velocity = (
            job.columns.index(name) if name in job.columns else -1 for name in _NEEDED
        )
        self._in_force: dict[int, dict[str, _Settings | None]] = {}

    def fill(self, rows: Array) -> None:
        """Write the column of all axes into ``rows`` (n, width); NaN where the errors of the model are not known."""
        if min(self._change, self._uncertainty, self._velocity) < 0 or not len(rows):
            return
        for k, name in enumerate(self._job.axes):
            part = rows[:, k * self._width : (k + 1) * self._width]
            changes = part[:, self._change]
            for number in np.unique(changes[np.isfinite(changes)]).tolist():
                settings = self._settings(int(number))[name]
                if settings is not None:
                    chosen = changes == number
                    part[chosen, self._uncertainty] = self._values(part[chosen], settings)

    def _values(self, rows: Array, settings: "_Settings") -> Array:
        velocity = rows[:, self._velocity]
        is_forward = velocity >= 0.0
        sides = [np.interp(np.abs(velocity), settings.speed, each) for each in (settings.forward, settings.backward)]
        gain = np.where(is_forward, settings.gain, settings.gain_negative)
        for place in self._job.factors:
            gain = gain * rows[:, len(self._job.columns) + place]
        return np.abs(gain) * np.where(is_forward, *sides)

    def _settings(self, number: int) -> "dict[str, _Settings | None]":
        """Return the settings of each axis after a change; 0: those of the start."""
        if number not in self._in_force:
            while len(self._in_force) >= _KEPT:
                del self._in_force[next(iter(self._in_force))]
            self._in_force[number] = self._read(number)
        return self._in_force[number]

    def _read(self, number: int) -> "dict[str, _Settings | None]":
        entries = {} if number == 0 else recorded_entries(self._journal)
        given = entries.get(number, {}).get("axes") or self._job.metadata.get("configuration", {}).get("axes", {})
        found: dict[str, _Settings | None] = {}
        for name in self._job.axes:
            axis = given.get(name, {})
            origin = axis.get("model_of", 0)
            if number and number not in entries:
                table = None  # forgotten by the journal: nothing is known
            elif origin:
                table = entries.get(origin, {}).get("axes", {}).get(name, {}).get("uncertainty")
            else:
                table = self._job.uncertainty.get(name)
            found[name] = None if table is None else _Settings(table, axis["compensation"])
        return found


class _Settings:
    """What the uncertainty of an axis follows from."""

    __slots__ = ("backward", "forward", "gain", "gain_negative", "speed")

    def __init__(self, table: Mapping[str, Any], compensation: Mapping[str, Any]) -> None:
        self.speed, self.forward, self.backward = (
            np.asarray(table[each], np.float64) for each in ("speed", "forward", "backward")
        )
        self.gain = float(compensation["gain"])
        negative = compensation["gain_negative"]
        self.gain_negative = self.gain if negative is None else float(negative)
