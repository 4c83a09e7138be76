"""When the compensation of an axis is on in a run, and which condition a cycle counts for. Pure."""

import math
from typing import TYPE_CHECKING

from friction_hil.daemon.figures import Condition
from friction_hil.daemon.safety import LoopState

if TYPE_CHECKING:
    from friction_hil.config import AxisConfig

_COMPENSATED = (LoopState.IDLE, LoopState.RUNNING)


class Schedule:
    """Compensation of an axis that the daemon moves: on after the time without it at the start of each motion."""

    __slots__ = ("_baseline_s", "_begins_s", "_is_enabled", "fade_s")

    def __init__(self, config: "AxisConfig") -> None:
        given = config.compensation
        self._baseline_s, self._is_enabled = given.baseline_s, given.enabled
        self.fade_s = given.fade_s  # in which it is switched on or off
        self._begins_s = self._baseline_s  # time of the motion at which it is switched on

    def begin_again(self) -> None:
        """Begin another motion, without compensation as the first one."""
        self._begins_s = self._baseline_s

    def switch(self, *, is_enabled: bool, running_s: float) -> None:
        """Switch the compensation on or off; ``running_s``: time since the motion began, s; NaN before."""
        self._is_enabled = is_enabled
        self._begins_s = max(self._baseline_s, running_s if math.isfinite(running_s) else 0.0)

    def take_back(self) -> None:
        """Switch the compensation off: it makes the axis worse."""
        self._is_enabled = False

    def is_on(self, state: LoopState, running_s: float, elapsed_s: float, is_operating: bool) -> bool:
        """Return True if the compensation is to be faded in, or kept, in a cycle.

        ``elapsed_s``: since the cycle before, s. ``is_operating``: the drive does what the compensation is made for.
        """
        return self._is_enabled and state in _COMPENSATED and running_s >= self._begins_s

    def condition(self, running_s: float, is_faded_out: bool) -> Condition:
        """Return what a cycle of the motion counts for."""
        if not self._is_enabled or running_s < self._begins_s:
            return Condition.WITHOUT if is_faded_out else Condition.FADING
        return Condition.WITH if running_s >= self._begins_s + self.fade_s else Condition.FADING


class FollowerSchedule(Schedule):
    """Compensation of an axis that another controller moves: its time counts while the drive operates."""

    __slots__ = ("_baseline_left_s", "_on_s")

    def __init__(self, config: "AxisConfig") -> None:
        super().__init__(config)
        self._baseline_left_s = self._baseline_s
        self._on_s = 0.0  # time for which the compensation has been on

    def begin_again(self) -> None:
        """Begin another time of compensation, without it as the first one."""
        self._baseline_left_s, self._on_s = self._baseline_s, 0.0

    def is_on(self, state: LoopState, running_s: float, elapsed_s: float, is_operating: bool) -> bool:
        """Return True if the compensation is to be faded in, or kept, in a cycle; see `Schedule.is_on`."""
        is_open = is_operating and state in _COMPENSATED and running_s >= 0.0
        if is_open and self._baseline_left_s > 0.0:
            self._baseline_left_s -= elapsed_s
            is_open = False
        is_on = is_open and self._is_enabled
        self._on_s = self._on_s + elapsed_s if is_on else 0.0
        return is_on

    def condition(self, running_s: float, is_faded_out: bool) -> Condition:
        """Return what a cycle counts for in which the drive operates."""
        if self._on_s > self.fade_s:
            return Condition.WITH
        return Condition.WITHOUT if is_faded_out else Condition.FADING
