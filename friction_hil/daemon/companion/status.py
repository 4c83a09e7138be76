"""Live lines on the terminal: state of the loop, then one line for each axis, a few times a second."""

import os
import sys
import time
from collections import deque
from collections.abc import Sequence

import numpy as np

from friction_hil.daemon.companion.job import Job
from friction_hil.daemon.safety import LoopState
from friction_hil.drive import DriveState
from friction_hil.numerics.readable import quantity, shortened
from friction_hil.printable import printable
from friction_hil.recordings.columns import CYCLE, TIME, unit
from friction_hil.recordings.recording import Array

_INTERVAL_S = 0.2
_UNKNOWN_SIZE = os.terminal_size((1000, 1000))
_WINDOW_S = 1.0  # of recorded time, over which errors and lateness are computed
_GAP = "  "
_MOVING = (LoopState.FIRST_MOTION, LoopState.RUNNING, LoopState.STOPPING)


class StatusLine:
    """Print the newest rows on a few lines of standard error, overwritten each time.

    On a narrow terminal a line loses its least important parts, which come last; nothing is wrapped.
    """

    def __init__(self, job: Job) -> None:
        self._job = job
        self._columns = {name: i for i, name in enumerate(job.columns)}
        self._axis_width = len(job.columns) + job.state_width
        self._window: deque[Array] = deque()
        self._first_cycle = np.nan
        self._rows = 0
        self._shown_at = -np.inf
        self._is_visible = True
        self._height = 0  # lines on the screen

    def show(self, rows: Array, lost: int) -> None:
        """Take rows (n, width) of the ring, and print when the interval is over."""
        if len(rows):
            self._take(rows)
        if time.monotonic() - self._shown_at >= _INTERVAL_S:
            self._shown_at = time.monotonic()
            self._print(lost)

    def close(self, lost: int) -> None:
        """Print the last rows, and leave the lines on the screen."""
        self._print(lost)
        self._write("\n" if self._height else "")

    def lines(self, lost: int, width: int, height: int) -> list[str]:
        """Return the lines for the rows taken so far, each at most ``width`` wide.

        ``lost``: rows that were lost so far. ``width``, ``height``: of the terminal; axes for which there is no line
        are counted in the last line.
        """
        rows = np.concatenate(self._window)
        parts = [self._axis_parts(rows, axis) for axis in range(len(self._job.axes))]
        room = max(height - 1, 2)  # the cursor's line included
        hidden = len(parts) - (room - 1)
        if hidden > 0:
            parts = parts[: room - 2]
        lines = [_fitted(self._loop_parts(rows, lost), width), *_aligned(parts, width)]
        return [*lines, f"... and {hidden + 1} more axes"[:width]] if hidden > 0 else lines

    def _take(self, rows: Array) -> None:
        if self._rows == 0:
            self._first_cycle = self._of(rows, 0, CYCLE)[0]
        self._rows += len(rows)
        self._window.append(rows)
        oldest = self._of(rows, 0, TIME)[-1] - _WINDOW_S
        while self._of(self._window[0], 0, TIME)[-1] < oldest:
            self._window.popleft()

    def _loop_parts(self, rows: Array, lost: int) -> list[str]:
        """Return the parts of the first line, the most important first."""
        title = (self._job.status_title,) if self._job.status_title else ()
        parts = [
            *title,
            f"{self._of(rows, 0, TIME)[-1]:.1f} s",
            self._state(rows),
            f"missed {self._missed(rows, lost)}",
        ]
        late = self._of(rows, 0, "late_us")
        if np.isfinite(late).any():
            parts.append(f"late p99 {np.nanpercentile(late, 99):.0f} µs")
        return [*parts, f"lost {lost}"]

    def _axis_parts(self, rows: Array, axis: int) -> list[str]:
        """Return the parts of an axis's line, the most important first; empty where nothing is known."""
        kind = self._job.kinds[axis] if self._job.kinds else "rotary"
        error = self._of(rows, axis, "position_demand") - self._of(rows, axis, "position")
        rms = float(np.sqrt(np.nanmean(error**2))) if np.isfinite(error).any() else np.nan
        compensation, velocity = (float(self._of(rows, axis, name)[-1]) for name in ("compensation", "velocity"))
        return [
            printable(self._job.axes[axis]),
            f"error {quantity(rms, unit('position', kind)):>9} rms",
            self._drive_state(rows, axis),
            f"comp {quantity(compensation, unit('compensation', kind)):>10}",
            f"velocity {quantity(velocity, unit('velocity', kind)):>11}",
        ]

    def _state(self, rows: Array) -> str:
        state = self._of(rows, 0, "state")[-1]
        return LoopState(int(state)).name if np.isfinite(state) else "?"

    def _drive_state(self, rows: Array, axis: int) -> str:
        """Return the state of a drive that is not as it should be while the axes move."""
        state, drive = self._of(rows, axis, "state")[-1], self._of(rows, axis, "drive_state")[-1]
        if not np.isfinite(drive) or state not in _MOVING or int(drive) == DriveState.OPERATION_ENABLED:
            return ""
        return DriveState(int(drive)).words

    def _missed(self, rows: Array, lost: int) -> int:
        cycles = self._of(rows, 0, CYCLE)[-1] - self._first_cycle + 1.0
        return max(0, int(cycles) - self._rows - lost) if np.isfinite(cycles) else 0

    def _of(self, rows: Array, axis: int, column: str) -> Array:
        """Return a column of an axis; NaN if the job has no such column."""
        if column not in self._columns:
            return np.full(len(rows), np.nan)
        return rows[:, axis * self._axis_width + self._columns[column]]

    def _print(self, lost: int) -> None:
        if not self._window or not self._is_visible:
            return
        size = _terminal_size()
        lines = self.lines(lost, size.columns - 1, size.lines)  # in the last column some terminals wrap
        up = f"\x1b[{self._height - 1}A" if self._height > 1 else ""
        self._height = max(len(lines), self._height)
        lines += [""] * (self._height - len(lines))
        self._write("\r" + up + "\n".join(f"{line}\x1b[K" for line in lines))

    def _write(self, text: str) -> None:
        try:
            sys.stderr.write(text)
            sys.stderr.flush()
        except OSError:
            self._is_visible = False  # the terminal is gone; the recording goes on


def _fitted(parts: Sequence[str], width: int) -> str:
    """Return as many of the first parts as fit side by side; of the first one alone, what fits."""
    shown = list(filter(None, parts))
    while len(shown) > 1 and len(_GAP.join(shown)) > width:
        shown.pop()
    return _GAP.join(shown)[:width]


def _aligned(table: Sequence[Sequence[str]], width: int) -> list[str]:
    """Return a line for each row of parts, the parts one below the other; what does not fit is dropped in all rows."""
    sizes = [max(map(len, column)) for column in zip(*table, strict=True)]
    kept = [k for k, size in enumerate(sizes) if size]
    while len(kept) > 1 and sum(sizes[k] for k in kept) + len(_GAP) * (len(kept) - 1) > width:
        if len(kept) == 2 and sizes[kept[1]] + len(_GAP) < width:
            sizes[kept[0]] = width - sizes[kept[1]] - len(_GAP)  # a long name is shortened before its figure goes
            break
        kept.pop()
    return [_GAP.join(f"{shortened(row[k], sizes[k]):<{sizes[k]}}" for k in kept).rstrip()[:width] for row in table]


def _terminal_size() -> os.terminal_size:
    try:
        size = os.get_terminal_size(sys.stderr.fileno())
    except OSError:
        return _UNKNOWN_SIZE
    # a pseudo-terminal without a size reports 0
    return os.terminal_size((size.columns or _UNKNOWN_SIZE.columns, size.lines or _UNKNOWN_SIZE.lines))
