"""Following error over a window, without and with compensation. Pure."""

import math

import numpy as np

from friction_hil.analysis import following
from friction_hil.daemon.figures import Condition, ErrorFigures, FollowingErrors, figures_of
from friction_hil.daemon.safety import LoopState
from friction_hil.live.reading import Rows
from friction_hil.live.window import Window
from friction_hil.numerics.jit import Array


class RollingErrors:
    """Following error of one axis over the last steady motion without and with compensation.

    What counts is found by the class that finds the figures of a run (`friction_hil.daemon.figures.FollowingErrors`).
    Here every such cycle of the window counts, not only whole periods of the motion.

    ``ramp_s``: time that the axes take to start. ``window_s``: s of steady motion in each condition.
    """

    def __init__(self, period_s: float, ramp_s: float, window_s: float) -> None:
        self._period_s = period_s
        self._motion = FollowingErrors(period_s, ramp_s, math.inf)
        self._windows = {each: Window(round(window_s / period_s)) for each in (Condition.WITHOUT, Condition.WITH)}
        self._fade: following.Fade = (False, -math.inf)
        self._was_running = False
        self._cycle = math.nan

    def take(self, rows: Rows, axis: str, fade_s: float, lost: int) -> Array:
        """Take further rows; return the following error in each (n,), NaN where it is not known.

        ``fade_s``: time in which the compensation fades in or out. ``lost``: rows before these that were lost on the
        way here.
        """
        columns = motion_columns(rows, axis)
        error = following.error(columns)
        if not len(rows):
            return error
        cycle = rows.of(axis, "cycle")
        condition, self._fade = following.conditions(cycle, columns, fade_s / self._period_s, self._fade)
        missed = missed_before(cycle, self._cycle, lost)
        is_running = columns["state"] == LoopState.RUNNING
        is_start = np.diff(
            is_running, prepend=self._was_running and not lost
        )  # what happened in lost rows is not known
        counts = np.zeros(len(rows), dtype=bool)
        for k in np.flatnonzero(is_running).tolist():
            if is_start[k]:
                self._motion, missed[k] = self._motion.anew(), 0.0
            is_usable = bool(np.isfinite(error[k]))
            counts[k] = self._motion.take(Condition(condition[k]), float(error[k]), int(missed[k]), is_usable)
        for each, window in self._windows.items():
            window.extend(error[counts & (condition == each)])
        self._cycle, self._was_running = float(cycle[-1]), bool(is_running[-1])
        return error

    def forget(self, condition: Condition) -> None:
        """Forget the cycles of a condition so far."""
        self._windows[condition].clear()

    def figures(self, condition: Condition) -> ErrorFigures | None:
        """Return the figures of a condition; None if no cycle of it counts."""
        values = self._windows[condition].values()
        if not values.size:
            return None
        found = figures_of(values)
        return ErrorFigures(found.rms, found.peak, values.size * self._period_s)


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
