"""Does the compensation make the following error larger? Settled motion with it against settled motion before. Pure.

A torque of the wrong sign, or of far too much, makes an axis worse, and nothing else in a run says so. Compared are
cycles of the same demanded velocity and acceleration, whatever the path: so a motion that changes is not taken for a
compensation that is bad. A force that lasts moves the error of both directions alike: it is left out of both sides. A
shock, noise or vibration does not repeat itself: what counts is the error that two windows in a row have in common, and
in both directions it must be larger than all of the error without compensation.

Only the first settled motion after the time without compensation is judged: later, friction and load may have changed.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from friction_hil.daemon.figures import Condition
from friction_hil.numerics.jit import Array

_WINDOW_S = 1.0  # of moving, at least; of a periodic motion whole periods
_MOST_WINDOWS = 6  # without a clear result, after which the compensation counts as no worse
_WORSE = 1.15  # times the RMS without compensation
_ALIKE = 0.7  # correlation of the mean errors of both windows, by velocity and acceleration
_COVERED = 0.7  # of the cycles that need a counterpart without compensation
_FEWEST = 5  # cycles of one velocity and acceleration
_OCTAVES, _CHANGES = 24, 9  # classes of velocity; of its relative change, in each direction and at none


class Worse(NamedTuple):
    """RMS of the following error over the same velocities, without and with compensation, rad or m."""

    without: float
    compensated: float


class _Errors:
    """Sums of the following error by direction, octave of the demanded velocity, and octave of its relative change."""

    __slots__ = ("count", "cycles", "squares", "sums")

    def __init__(self) -> None:
        self.cycles, self.sums, self.squares = (np.zeros((2, _OCTAVES, 2 * _CHANGES + 1)) for _ in range(3))
        self.count = 0

    def add(self, velocity: float, acceleration: float, error: float, least: float) -> None:
        """Add a cycle; ``least`` is the smallest velocity."""
        speed, change = abs(velocity), 0
        if abs(acceleration) > speed:  # per second
            change = min(1 + int(math.log2(abs(acceleration) / speed)), _CHANGES)
        key = int(velocity > 0.0), min(int(math.log2(speed / least)), _OCTAVES - 1), change
        if acceleration * velocity < 0.0:
            key = *key[:2], _CHANGES + change
        self.cycles[key] += 1.0
        self.sums[key] += error
        self.squares[key] += error * error
        self.count += 1

    def centre(self, common: NDArray[np.bool_]) -> float:
        """Return the mean of the mean errors of both directions; 0 where there is only one."""
        cycles, sums = (np.where(common, each, 0.0).sum((1, 2)) for each in (self.cycles, self.sums))
        return float(np.mean(sums / cycles)) if cycles.all() else 0.0

    def means(self, centre: float) -> Array:
        """Return the mean errors relative to ``centre``, by class; NaN where there is none."""
        return self.sums / self.cycles - centre

    def mean_squares(self, centre: float) -> Array:
        """Return the mean squares of the errors about ``centre``, by class; NaN where there is none."""
        return np.maximum((self.squares - 2.0 * centre * self.sums) / self.cycles + centre * centre, 0.0)


class WorseningJudge:
    """Judge of one axis.

    ``motion_s``: period of the motion, s; infinity if it has none. ``resolution``: smallest step of the position, SI.
    """

    __slots__ = ("_before", "_given", "_least_velocity", "_resolution", "_window", "_windows", "_with", "_without")

    def __init__(self, period_s: float, motion_s: float, resolution: float) -> None:
        self._given = period_s, motion_s, resolution
        whole_s = math.ceil(_WINDOW_S / motion_s - 1e-9) * motion_s if math.isfinite(motion_s) else _WINDOW_S
        self._window = max(1, round(whole_s / period_s))  # cycles
        self._resolution, self._least_velocity = resolution, 0.5 * resolution / period_s
        self._without, self._with = _Errors(), _Errors()
        self._before: _Errors | None = None  # the window before this one
        self._windows = 0

    def anew(self) -> "WorseningJudge":
        """Return a judge for another motion of the same kind."""
        return WorseningJudge(*self._given)

    def restart(self) -> None:
        """Judge the compensation from now on: its settings have changed."""
        self._with, self._before, self._windows = _Errors(), None, 0

    def take(self, condition: Condition, velocity: float, acceleration: float, error: float) -> Worse | None:
        """Take a cycle of settled motion; return the result once the compensation has made the error larger.

        ``velocity``, ``acceleration``: demanded, SI. ``error``: demanded minus measured position.
        """
        if not abs(velocity) > self._least_velocity or self._windows >= _MOST_WINDOWS:
            return None
        if condition is Condition.WITHOUT:
            if self._windows or self._with.count:  # a new time without compensation
                self._without = _Errors()
                self.restart()
            self._without.add(velocity, acceleration, error, self._least_velocity)
            return None
        if self._without.count < round(_WINDOW_S / self._given[0]) // 2:
            return None  # there is nothing to compare with
        self._with.add(velocity, acceleration, error, self._least_velocity)
        if self._with.count < self._window:
            return None
        return self._end_window()

    def _end_window(self) -> Worse | None:
        """Compare the last two windows with the motion without compensation."""
        new, before, old = self._with, self._before, self._without
        self._with, self._before = _Errors(), new
        self._windows += 1
        common = np.minimum(new.cycles, old.cycles) >= _FEWEST
        if before is not None:
            common &= before.cycles >= _FEWEST
        weights = np.where(common, new.cycles, 0.0)
        count = float(weights.sum())
        if not count or count < _COVERED * new.count:
            return None  # another motion
        with np.errstate(all="ignore"):  # classes without a cycle have no weight
            zero = np.where(common, old.mean_squares(old.centre(common)), 0.0)
            now = np.where(common, new.mean_squares(new.centre(common)), 0.0)
            found = Worse(math.sqrt((weights * zero).sum() / count), math.sqrt((weights * now).sum() / count))
            if found.compensated < found.without:
                self._windows = _MOST_WINDOWS  # it helps: what comes later has other causes
            is_larger = found.compensated > max(_WORSE * found.without, found.without + self._resolution)
            if before is None or not is_larger:
                return None
            one, two = (np.where(common, each.means(each.centre(common)), 0.0) for each in (new, before))
        repeated, first, second, least = (
            (weights * each).sum((1, 2)) for each in (one * two, one * one, two * two, _WORSE**2 * zero)
        )
        is_worse = (repeated > least) & (repeated > _ALIKE * np.sqrt(first * second))
        if not np.all(is_worse[weights.any((1, 2))]):  # in each direction
            return None
        self._windows = _MOST_WINDOWS
        return found
