"""Limits, plausibility, and the states of a run. Pure: what is wrong with an axis, and what follows from it.

What is not finite, not fresh or not plausible never becomes a command. A fault fades the compensation, brings
the axes to rest by the drives' quick stop and then disables them; holding torque stays until standstill, for
a vertical axis must not fall. Nothing here leaves a fault by itself.
"""

import math
from dataclasses import dataclass
from enum import IntEnum

from friction_hil.drive import DriveState, Feedback, Request

MAX_STALE_CYCLES = 10
_JUMP_MARGIN = 2.0


class LoopState(IntEnum):
    """Where a run stands."""

    IDLE = 0  # listening only
    ENABLING = 1
    RUNNING = 2
    STOPPING = 3  # the set-point comes to rest, the compensation fades
    FAULT_STOPPING = 4  # the drives' quick stop
    DISABLING = 5
    DONE = 6


REQUESTS = {
    LoopState.IDLE: Request.LISTEN,
    LoopState.ENABLING: Request.ENABLE,
    LoopState.RUNNING: Request.ENABLE,
    LoopState.STOPPING: Request.ENABLE,
    LoopState.FAULT_STOPPING: Request.QUICK_STOP,
    LoopState.DISABLING: Request.DISABLE,
    LoopState.DONE: Request.DISABLE,
}
# in the very cycle in which something is found wrong, before the state follows
REQUESTS_AFTER_FAULT = REQUESTS | {
    LoopState.ENABLING: Request.DISABLE,
    LoopState.RUNNING: Request.QUICK_STOP,
    LoopState.STOPPING: Request.QUICK_STOP,
}

_NOT_YET_ENABLED = (LoopState.IDLE, LoopState.ENABLING)


@dataclass(frozen=True, slots=True)
class Limits:
    """Bounds of one axis, SI; infinity where there is none."""

    torque: float
    velocity: float
    torque_slew: float = math.inf
    following_error: float = math.inf
    position_low: float = -math.inf
    position_high: float = math.inf


class Supervisor:
    """Watches the feedback of one axis.

    Parameters
    ----------
    name : str
        Name of the axis, for messages.
    limits : Limits
    period_s : float
        Period of the loop, s.
    position_resolution : float
        Smallest step of the position, SI.
    unit : str
        Unit of position, for messages: ``rad`` or ``m``.
    max_stale_cycles : int
        Cycles in a row without usable feedback that are still bridged.
    """

    __slots__ = (
        "_jump",
        "_last_position",
        "_limits",
        "_max_stale_cycles",
        "_missing",
        "_name",
        "_slack",
        "_stale_cycles",
        "_unit",
    )

    def __init__(
        self,
        name: str,
        limits: Limits,
        period_s: float,
        position_resolution: float,
        unit: str = "rad",
        max_stale_cycles: int = MAX_STALE_CYCLES,
    ) -> None:
        self._name = name
        self._limits = limits
        self._unit = unit
        self._jump = _JUMP_MARGIN * limits.velocity * period_s
        self._slack = 10.0 * position_resolution
        self._last_position = math.nan
        self._stale_cycles = 0
        self._max_stale_cycles = max_stale_cycles
        self._missing = ""  # what was said of the feedback that is missing now

    @property
    def position(self) -> float:
        """Last usable position; NaN before there was one."""
        return self._last_position

    @property
    def is_current(self) -> bool:
        """Whether that position is of the last cycle."""
        return self._stale_cycles == 0

    def is_usable(self, feedback: Feedback) -> bool:
        """Whether this cycle's feedback is fresh, finite and plausible; to be asked once a cycle.

        A position that jumps further than twice the velocity limit allows is a glitch, for as many cycles as
        feedback may be missing.
        """
        usable = (
            feedback.is_fresh
            and math.isfinite(feedback.position)
            and math.isfinite(feedback.velocity)
            and math.isfinite(feedback.torque)
        )
        if usable and math.isfinite(self._last_position):
            reach = self._jump * (self._stale_cycles + 1) + self._slack
            usable = abs(feedback.position - self._last_position) <= reach
        if usable:
            self._last_position = feedback.position
            self._stale_cycles = 0
        else:
            self._stale_cycles += 1
        return usable

    def fault(self, feedback: Feedback, state: LoopState, velocity: float, position_demand: float) -> str | None:
        """What is wrong with the axis, in words, or None.

        Parameters
        ----------
        feedback : Feedback
            After `is_usable`.
        state : LoopState
            Decides what is expected: following and an enabled drive only while it moves.
        velocity : float
            Estimated velocity, SI.
        position_demand : float
            Demanded position at the time of the feedback; NaN where there is none.
        """
        name, limits, unit = self._name, self._limits, self._unit
        if feedback.message:
            return f"{name}: {feedback.message}"
        if self._stale_cycles > self._max_stale_cycles:
            if not self._missing:  # the reason changes with each byte that comes, what is wrong does not
                text = f"{name}: no usable feedback for more than {self._max_stale_cycles} cycles"
                why = feedback.missing
                if feedback.is_fresh:
                    why = (
                        f"its position jumps further than limits.velocity allows, now to {feedback.position:.4g} {unit}"
                    )
                self._missing = f"{text}: {why}" if why else text
            return self._missing
        self._missing = ""
        if feedback.state in (DriveState.FAULT, DriveState.FAULT_REACTION_ACTIVE):
            text = f"{name}: the drive is in fault: {feedback.error or 'it does not say why'}"
            return f"{text}; --reset-fault leaves it" if state in _NOT_YET_ENABLED else text
        if state not in (LoopState.RUNNING, LoopState.STOPPING):
            return None
        if feedback.state is not DriveState.OPERATION_ENABLED:
            return f"{name}: the drive left Operation enabled: {feedback.state.words}"
        if not abs(velocity) <= limits.velocity:
            return f"{name}: velocity {velocity:.4g} is beyond its limit of {limits.velocity:g} {unit}/s"
        position = self._last_position
        if not limits.position_low <= position <= limits.position_high:
            return (
                f"{name}: position {position:.4g} {unit} is outside "
                f"[{limits.position_low:g}, {limits.position_high:g}] {unit}"
            )
        if math.isfinite(position_demand) and not abs(position_demand - position) <= limits.following_error:
            return (
                f"{name}: following error {position_demand - position:.4g} {unit} is beyond its limit of "
                f"{limits.following_error:g} {unit}"
            )
        return None


class SlewLimiter:
    """Bounds a torque and its rate; holds what it gave last."""

    __slots__ = ("_limit", "_step", "torque")

    def __init__(self, limit: float, slew: float, period_s: float) -> None:
        self._limit = limit
        self._step = slew * period_s
        self.torque = 0.0

    def limit(self, wanted: float) -> float:
        """Return the torque allowed in this cycle, N m; a value that is not finite counts as zero."""
        if not math.isfinite(wanted):
            wanted = 0.0
        wanted = min(max(wanted, -self._limit), self._limit)
        self.torque = min(max(wanted, self.torque - self._step), self.torque + self._step)
        return self.torque
