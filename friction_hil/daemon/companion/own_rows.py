"""Rows of a loop of the user's own, which writes no more than it must: the companion makes the daemon's rows of them.

A row of the ring holds, for each axis in turn, ``ring_columns``: the compensator's inputs, then what came out. States
would be most of a row: they are behind the rows, one for each axis before every ``rows_between_states``-th row.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from friction_hil.daemon.companion.job import Job
from friction_hil.daemon.ring import RingReader
from friction_hil.daemon.safety import LoopState
from friction_hil.drive import DriveState
from friction_hil.recordings import columns
from friction_hil.recordings.recording import Array

_FIXED = {"motor_offset": 0.0, "state": LoopState.RUNNING, "drive_state": DriveState.OPERATION_ENABLED}
_AFTER_INPUTS = "compensation"  # the first column that is no input


def daemon_rows(rows: Array, names: Sequence[str], period_s: float) -> Array:
    """Return rows (m, n, columns) of the loop as the daemon's columns, (m, n, `columns.NAMES`); NaN what it lacks."""
    m, n = rows.shape[:2]
    table = np.full((m, n, len(columns.NAMES)), np.nan)
    named = dict(zip(names, np.moveaxis(rows, 2, 0), strict=True))
    named[columns.TIME], named["command"] = named[columns.CYCLE] * period_s, named["compensation"]
    end = list(names).index(_AFTER_INPUTS)
    inputs = rows[:, :, :end].reshape(m * n, end).tolist()
    named["checksum"] = np.reshape([columns.input_checksum(*each) for each in inputs], (m, n))
    for name, values in {**named, **_FIXED}.items():
        table[:, :, columns.NAMES.index(name)] = values
    return table


class OwnRingReader(RingReader):
    """Reading end of such a ring. After a loss, rows are taken from the next state on: a replay could not pass it."""

    def __init__(self, descriptor: int, job: Job) -> None:
        super().__init__(descriptor)
        self._job = job
        self._states = self.tail.reshape(-1, len(job.axes), job.state_width)
        self._last = self.rows_done  # number of the last row that was taken
        self._taken = np.empty(0, np.int64)  # numbers of those of the last `drain`, from 0

    def _accepts(self, numbers: NDArray[np.int64]) -> NDArray[np.bool_]:
        places, before = np.arange(len(numbers)), np.concatenate([[self._last], numbers[:-1]])
        broken = np.maximum.accumulate(np.where(numbers != before + 1, places, -1))
        begun = np.maximum.accumulate(np.where((numbers - 1) % self._job.rows_between_states == 0, places, -1))
        accepted: NDArray[np.bool_] = begun >= broken
        self._taken = numbers[accepted] - 1
        if len(self._taken):
            self._last = int(self._taken[-1]) + 1
        return accepted

    def in_full(self, rows: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Return the rows of the last `drain` as the daemon's, and which of them have states, (m,)."""
        job, m = self._job, len(rows)
        values = daemon_rows(rows.reshape(m, len(job.axes), len(job.ring_columns)), job.ring_columns, job.period_s)
        states = np.full((m, len(job.axes), job.state_width), np.nan)
        has_state = self._taken % job.rows_between_states == 0
        states[has_state] = self._states[self._taken[has_state] // job.rows_between_states % len(self._states)]
        table = np.concatenate([values, states], axis=2)
        return table.reshape(m, job.state_width * len(job.axes) + values.shape[1] * values.shape[2]), has_state
