"""Following error over a window, without and with compensation. Pure."""

import numpy as np

from friction_hil.analysis import following
from friction_hil.daemon.figures import SETTLE_S, Condition, ErrorFigures
from friction_hil.daemon.safety import LoopState
from friction_hil.live.reading import Rows
from friction_hil.live.window import Window
from friction_hil.numerics.jit import Array


class RollingErrors:
    """Following error of one axis over the last steady motion without and with compensation.

    What counts is as in the figures of a run (`friction_hil.daemon.figures.FollowingErrors`): not the start of a
    motion, not the fade of the compensation, not the `SETTLE_S` after each, and not cycles shortly after a missed
    period or late feedback. Here every such cycle of the window counts, not only whole periods of the motion.

    ``ramp_s``: time that the axes take to start. ``window_s``: s of steady motion in each condition.
    """

    def __init__(self, period_s: float, ramp_s: float, window_s: float) -> None:
        self._period_s = period_s
        self._start = (ramp_s + SETTLE_S) / period_s  # cycles
        self._settle = SETTLE_S / period_s
        self._windows = {each: Window(round(window_s / period_s)) for each in (Condition.WITHOUT, Condition.WITH)}
        self._counts_from = -np.inf  # cycle
        self._was_on = self._was_running = False
        self._cycle = np.nan

    def take(self, rows: Rows, axis: str, fade_s: float, lost: int) -> Array:
        """Take further rows; return the following error in each (n,), NaN where it is not known.

        ``fade_s``: time in which the compensation fades in or out. ``lost``: rows before these that were lost on the
        way here.
        """
        columns = motion_columns(rows, axis)
        error = following.error(columns)
        cycle = rows.of(axis, "cycle")
        if not len(rows):
            return error
        missed = missed_before(cycle, self._cycle, lost)
        is_on, is_running = columns["is_enabled"] == 1.0, columns["state"] == LoopState.RUNNING
        waits = following.recovery(missed, columns["is_fresh"] == 1.0, self._period_s)
        waits = np.where(_changes(is_on, self._was_on), fade_s / self._period_s + self._settle, waits)
        waits = np.where(_changes(is_running, self._was_running), self._start, waits)
        if lost:  # what happened in them is not known
            waits[0] = self._start
        counts_from = np.maximum.accumulate(np.maximum(cycle + waits, self._counts_from))
        counts = is_running & np.isfinite(error) & (cycle >= counts_from)
        for condition, mask in ((Condition.WITHOUT, ~is_on), (Condition.WITH, is_on)):
            self._windows[condition].extend(error[counts & mask])
        self._counts_from, self._cycle = float(counts_from[-1]), float(cycle[-1])
        self._was_on, self._was_running = bool(is_on[-1]), bool(is_running[-1])
        return error

    def forget(self, condition: Condition) -> None:
        """Forget the cycles of a condition so far."""
        self._windows[condition].clear()

    def figures(self, condition: Condition) -> ErrorFigures | None:
        """Return the figures of a condition; None if no cycle of it counts."""
        values = self._windows[condition].values()
        if not values.size:
            return None
        rms, peak = float(np.sqrt(np.mean(values**2))), float(np.max(np.abs(values)))
        return ErrorFigures(rms, peak, values.size * self._period_s)


def motion_columns(rows: Rows, axis: str) -> dict[str, Array]:
    """Return what the following error is made of, by name; the position without the offset of the motor.

    See `friction_hil.analysis.following.columns_of`.
    """
    columns = {name: rows.of(axis, name) for name in following.COLUMNS}
    offset = rows.of(axis, "motor_offset")
    columns["position"] = columns["position"] - np.where(np.isfinite(offset), offset, 0.0)
    return columns


def missed_before(cycle: Array, last: float, lost: int) -> Array:
    """Return the periods that were missed before each row (n,), given the last cycle and the rows lost since."""
    first = cycle[0] - 1.0 if np.isnan(last) else last
    missed = np.diff(cycle, prepend=first) - 1.0
    missed[0] -= lost
    missed_rows: Array = np.maximum(missed, 0.0)
    return missed_rows


def _changes(values: "np.typing.NDArray[np.bool_]", before: bool) -> "np.typing.NDArray[np.bool_]":
    """Return where a value differs from the one before."""
    return np.diff(values, prepend=before)
