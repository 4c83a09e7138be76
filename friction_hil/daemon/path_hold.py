"""What becomes of the path in periods that brought no set-point to the drives. Pure."""

import math
from collections import deque

from friction_hil.daemon.log import RunLog
from friction_hil.daemon.safety import MOVING, LoopState
from friction_hil.motion.trajectory import PathTime

_REGULAR_TIMES, _REGULAR_PERIODS = 10, 200  # so often in so many: the loop is too slow for its period
_BRIDGED_PERIODS = 1  # without a set-point, which a drive bridges; after more, going on with time would be a step


class PathHold:
    """Lets the path wait for periods in which nothing was sent.

    Where no axis has stopped meanwhile (csv, cst: ``is_needed`` is False), the path goes on with time, as the axes
    have. ``setpoint_delay_s``: set-points are sent ahead by it.
    """

    __slots__ = ("_before", "_is_needed", "_is_slowness_told", "_log", "_path_time", "_period_s", "_setpoint_delay_s")

    def __init__(
        self, path_time: PathTime, period_s: float, setpoint_delay_s: float, log: RunLog, *, is_needed: bool
    ) -> None:
        self._path_time, self._period_s, self._setpoint_delay_s = path_time, period_s, setpoint_delay_s
        self._log, self._is_needed = log, is_needed
        self._before: deque[tuple[int, int]] = deque(maxlen=_REGULAR_TIMES)  # cycle, and periods missed before
        self._is_slowness_told = False

    def after_missed(self, cycle: int, state: LoopState, missed: int) -> None:
        """Let the path go on in ``cycle`` from where it was ``missed`` periods before.

        A loop that misses periods regularly has a longer period in truth: the path then does not wait for single ones,
        which drives bridge.
        """
        if not self._is_needed or state not in MOVING:
            return
        self._before.append((cycle, missed))
        within = cycle - self._before[0][0]
        if len(self._before) == _REGULAR_TIMES and within < _REGULAR_PERIODS:
            missed = 0 if missed <= _BRIDGED_PERIODS else missed
            if not self._is_slowness_told:
                self._is_slowness_told = True
                text = (
                    f"the computer is too slow for {1e3 * self._period_s:g} ms: it missed periods {_REGULAR_TIMES} "
                    f"times in {within + 1}, so set-points no longer wait for a missed one; take a longer period_s"
                )
                self._log.warn(cycle, text)
        if missed > 0:
            self._hold(cycle, missed)

    def after_lost(self, cycle: int, state: LoopState) -> None:
        """Let the path wait for the period before ``cycle``, whose set-point did not get to a drive."""
        if self._is_needed and state in MOVING:
            self._hold(cycle, 1)

    def _hold(self, cycle: int, periods: int) -> None:
        time_s, held_s = cycle * self._period_s, periods * self._period_s
        self._path_time.hold(time_s, held_s, time_s + self._setpoint_delay_s)

    def lag_s(self, time_s: float, state: LoopState) -> float:
        """Return by how much the path is behind after missed periods, s; NaN while the axes do not move on it."""
        return self._path_time.lag_s(time_s) if state in MOVING else math.nan
