"""Status line: state of the loop and of each axis, a few times a second."""

import os
import sys
import time
from collections import deque

import numpy as np

from friction_hil.daemon.companion.job import Job
from friction_hil.daemon.safety import LoopState
from friction_hil.printable import printable
from friction_hil.recordings.columns import CYCLE, TIME, unit
from friction_hil.recordings.recording import Array

_INTERVAL_S = 0.2
_UNKNOWN_WIDTH = 1000
_WINDOW_S = 1.0  # of recorded time, over which errors and lateness are computed


class StatusLine:
    """Print the newest rows on one line of standard error, overwritten each time."""

    def __init__(self, job: Job) -> None:
        self._job = job
        self._columns = {name: i for i, name in enumerate(job.columns)}
        self._axis_width = len(job.columns) + job.state_width
        self._window: deque[Array] = deque()
        self._first_cycle = np.nan
        self._rows = 0
        self._shown_at = -np.inf
        self._is_visible = True

    def show(self, rows: Array, lost: int) -> None:
        """Take rows (n, width) of the ring, and print when the interval is over."""
        if len(rows):
            self._take(rows)
        if time.monotonic() - self._shown_at >= _INTERVAL_S:
            self._shown_at = time.monotonic()
            self._print(lost)

    def close(self, lost: int) -> None:
        """Print the last rows, and leave the line on the screen."""
        self._print(lost, end="\n")

    def text(self, lost: int) -> str:
        """Return the line for the rows taken so far."""
        rows = np.concatenate(self._window)
        parts = [f"{self._of(rows, 0, TIME)[-1]:.1f} s"]
        parts += [self._axis_text(rows, axis) for axis in range(len(self._job.axes))]
        late = self._of(rows, 0, "late_us")
        if np.isfinite(late).any():
            parts.append(f"late p99 {np.nanpercentile(late, 99):.0f} us")
        parts.append(f"missed {self._missed(rows, lost)}")
        parts.append(f"lost {lost}")
        return "  ".join(parts)

    def _take(self, rows: Array) -> None:
        if self._rows == 0:
            self._first_cycle = self._of(rows, 0, CYCLE)[0]
        self._rows += len(rows)
        self._window.append(rows)
        oldest = self._of(rows, 0, TIME)[-1] - _WINDOW_S
        while self._of(self._window[0], 0, TIME)[-1] < oldest:
            self._window.popleft()

    def _axis_text(self, rows: Array, axis: int) -> str:
        kind = self._job.kinds[axis] if self._job.kinds else "rotary"
        error = self._of(rows, axis, "position_demand") - self._of(rows, axis, "position")
        text = f"{self._job.axes[axis]}: {self._state(rows, axis)}"
        if np.isfinite(error).any():
            text += f" error {np.sqrt(np.nanmean(error**2)):.2e} {unit('position', kind)} rms"
        compensation = self._of(rows, axis, "compensation")[-1]
        if np.isfinite(compensation):
            text += f" comp {compensation:+.3g} {unit('compensation', kind)}"
        return text

    def _state(self, rows: Array, axis: int) -> str:
        state = self._of(rows, axis, "state")[-1]
        return LoopState(int(state)).name if np.isfinite(state) else "?"

    def _missed(self, rows: Array, lost: int) -> int:
        cycles = self._of(rows, 0, CYCLE)[-1] - self._first_cycle + 1.0
        return max(0, int(cycles) - self._rows - lost) if np.isfinite(cycles) else 0

    def _of(self, rows: Array, axis: int, column: str) -> Array:
        """Return a column of an axis; NaN if the job has no such column."""
        if column not in self._columns:
            return np.full(len(rows), np.nan)
        return rows[:, axis * self._axis_width + self._columns[column]]

    def _print(self, lost: int, end: str = "") -> None:
        if not self._window or not self._is_visible:
            return
        try:
            sys.stderr.write(f"\r{printable(self.text(lost))[: _terminal_width()]}\x1b[K{end}")
            sys.stderr.flush()
        except OSError:
            self._is_visible = False  # the terminal is gone; the recording goes on


def _terminal_width() -> int:
    try:
        # a pseudo-terminal without a size reports 0
        return os.get_terminal_size(sys.stderr.fileno()).columns or _UNKNOWN_WIDTH
    except OSError:
        return _UNKNOWN_WIDTH
