"""The last minute of rows, in memory that outlives a worker: what a file of a fault begins with.

All companions of a run share the memory (`friction_hil.daemon.companion.memory`), so that the next one finds in it what
the dead one had kept. Its size is fixed. States of the compensators, which take several times
the place of the columns, are kept once a second and after each gap in ``cycle``, where a replay needs them.
"""

import math
import mmap

import numpy as np
from numpy.typing import NDArray

from friction_hil.daemon.companion.job import Job
from friction_hil.daemon.companion.memory import HEADER_BYTES, KEPT, STATES, rows_kept
from friction_hil.recordings.columns import CYCLE, TIME
from friction_hil.recordings.recording import Array

_COUNT, _STATE_COUNT, _LAST_CYCLE, _FAULT_ROW, _FAULT_END_S = range(5)  # words of the header


class History:
    """Rows of the last minute, in ``memory``, which is all zero at first."""

    def __init__(self, job: Job, memory: mmap.mmap | bytearray) -> None:
        self._axes, self._columns, self._state_width = len(job.axes), len(job.columns), job.state_width
        self._time, self._cycle = job.columns.index(TIME), job.columns.index(CYCLE)
        self._capacity = rows_kept(job)
        self._is_successor = True  # of a worker whose rows may come once more, until one comes that it had not kept
        self._second = max(1, round(1.0 / job.period_s))  # rows
        # rows of a minute, or fewer where they would take too much memory
        self.before = max(1, round(self._capacity / KEPT))
        self._header = np.frombuffer(memory, np.float64, _FAULT_END_S + 1)
        width, at = self._axes * self._columns, HEADER_BYTES
        self._rows = np.frombuffer(memory, np.float64, self._capacity * width, at).reshape(self._capacity, width)
        at += self._rows.nbytes
        width = 1 + self._axes * self._state_width  # number of the row, then its states
        self._states = np.frombuffer(memory, np.float64, STATES * width, at).reshape(STATES, width)

    @property
    def count(self) -> int:
        """Number of rows that were appended so far."""
        return int(self._header[_COUNT])

    @property
    def oldest(self) -> int:
        """Number of the oldest row that is kept."""
        return max(0, self.count - self._capacity)

    @property
    def last_s(self) -> float:
        """``time_s`` of the last row, s."""
        return float(self._rows[(self.count - 1) % self._capacity, self._time])

    @property
    def last_cycle(self) -> float:
        """Number of the last row's cycle."""
        return float(self._header[_LAST_CYCLE])

    @property
    def fault(self) -> tuple[int, float] | None:
        """First row and end, s, of a file that is being written; kept here for the next worker."""
        if not self._header[_FAULT_END_S]:
            return None
        return int(self._header[_FAULT_ROW]), float(self._header[_FAULT_END_S])

    @fault.setter
    def fault(self, value: tuple[int, float] | None) -> None:
        self._header[_FAULT_ROW], self._header[_FAULT_END_S] = (0, 0.0) if value is None else value

    def minute_before(self) -> int:
        """Return the first row of the last minute, or one shortly before it that has a state: a replay starts there.

        With more gaps than there is room for states, it is the first row that has one.
        """
        first = max(self.oldest, self.count - self.before)
        numbers = self._states[: min(int(self._header[_STATE_COUNT]), STATES), 0]
        numbers = numbers[numbers >= self.oldest]
        return int(max(numbers[numbers <= first], default=min(numbers, default=first)))

    def append(self, rows: Array) -> None:
        """Append rows (n, axes * (columns + states)); those that a dead worker had appended already are left out."""
        count, cycles = self.count, rows[:, self._cycle]
        if self._is_successor and count:
            rows = rows[cycles > self._header[_LAST_CYCLE]]
            cycles = rows[:, self._cycle]
        rows, cycles = rows[-self._capacity :], cycles[-self._capacity :]
        if not len(rows):
            return
        self._is_successor = False
        numbers = np.arange(count, count + len(rows))
        by_axis = rows.reshape(len(rows), self._axes, self._columns + self._state_width)
        self._rows[numbers % self._capacity] = by_axis[:, :, : self._columns].reshape(len(rows), self._rows.shape[1])
        is_first = np.diff(cycles, prepend=self._header[_LAST_CYCLE] if count else -math.inf) != 1.0
        (wanted,) = np.nonzero(is_first | (numbers % self._second == 0))
        wanted = wanted[-STATES:]
        slots = (int(self._header[_STATE_COUNT]) + np.arange(len(wanted))) % STATES
        self._states[slots, 0] = numbers[wanted]
        states = by_axis[wanted, :, self._columns :]
        self._states[slots, 1:] = states.reshape(len(wanted), self._axes * self._state_width)
        self._header[_STATE_COUNT] += len(wanted)
        self._header[_LAST_CYCLE] = cycles[-1]
        self._header[_COUNT] = count + len(rows)

    def read(self, first: int, end: int) -> tuple[Array, NDArray[np.bool_]]:
        """Return rows ``first`` to ``end`` as they were appended, and which of them have states; others have NaN."""
        numbers = np.arange(max(first, self.oldest), min(end, self.count))
        rows = np.full((len(numbers), self._axes, self._columns + self._state_width), math.nan)
        columns = self._rows[numbers % self._capacity]
        rows[:, :, : self._columns] = columns.reshape(len(numbers), self._axes, self._columns)
        kept = self._states[: min(int(self._header[_STATE_COUNT]), STATES)]
        kept = kept[np.isin(kept[:, 0], numbers)]
        at = kept[:, 0].astype(int) - (numbers[0] if len(numbers) else 0)
        rows[at, :, self._columns :] = kept[:, 1:].reshape(len(kept), self._axes, self._state_width)
        has_state = np.zeros(len(numbers), bool)
        has_state[at] = self._state_width > 0
        return rows.reshape(len(numbers), self._axes * rows.shape[2]), has_state
