"""Steps of a position that are beyond the velocity limit, several in a row and in one direction. Pure.

One step too far may be a frame that came late, or a glitch. Several in a row are an axis that is too fast, whatever the
drive reports as its velocity; no estimate and no other plausibility check stands in between.
"""

import math

MOST_FAST_CYCLES = 3  # in a row beyond the velocity limit, of one witness alone: fewer may be noise or late


class FastSteps:
    """Steps of one axis.

    ``reach``: way within a period at the velocity limit, SI. ``resolution``: smallest step of the position, SI.

    Examples
    --------
    >>> steps = FastSteps(reach=1e-3, resolution=1e-6)
    >>> for position in (0.0, 0.5e-3, 0.5e-3, 2.5e-3, 3e-3, 4.5e-3, 6e-3, 7.5e-3):
    ...     steps.take(position, 1)
    >>> steps.is_too_fast, round(steps.ratio, 3)
    (True, 1.5)
    """

    __slots__ = ("_count", "_elapsed", "_periods", "_position", "_reach", "_resolution", "_way")

    def __init__(self, reach: float, resolution: float) -> None:
        self._reach, self._resolution = reach, resolution
        self._position = math.nan
        self._elapsed = 0  # periods since that position
        self._way, self._periods, self._count = 0.0, 0, 0  # of the steps in a row

    def take(self, position: float, periods: int) -> None:
        """Take the position of a cycle, NaN if there is none, and the periods since the cycle before."""
        elapsed, step = self._elapsed + periods, position - self._position
        reach = self._reach * elapsed
        if -reach <= step <= reach:  # in most cycles
            self._position, self._elapsed, self._count = position, 0, 0
        elif math.isnan(position):
            self._elapsed = elapsed
        else:
            is_fast = math.isfinite(step)  # else it is the first position
            if not is_fast or not self._count or step * self._way < 0.0:
                self._way, self._periods, self._count = 0.0, 0, 0
            if is_fast:
                self._way, self._periods, self._count = self._way + step, self._periods + elapsed, self._count + 1
            self._position, self._elapsed = position, 0

    @property
    def is_too_fast(self) -> bool:
        """True if there are enough such steps, and together they are beyond the limit by more than rounding."""
        if self._count < MOST_FAST_CYCLES:
            return False
        return abs(self._way) > self._reach * self._periods + 2.0 * self._resolution

    @property
    def ratio(self) -> float:
        """Mean velocity of these steps over the velocity limit."""
        return self._way / (self._reach * self._periods)
