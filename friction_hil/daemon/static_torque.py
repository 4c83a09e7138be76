"""Feed-forward of gravity and offset of a model file: how much of it an axis gets, and what is said about it."""

import math
from typing import TYPE_CHECKING, NamedTuple

from friction_hil.compensator.load import gravity_torque
from friction_hil.numerics.readable import FORCE_UNITS

if TYPE_CHECKING:
    from friction_hil.config import AxisConfig

_NOTEWORTHY = 0.01  # of limits.torque: identification finds a small offset where there is none


class StaticTorque(NamedTuple):
    """Feed-forward torque that depends on nothing but the position, N m or N.

    The values beside the bound are ``mechanics.offset`` and ``mechanics.gravity`` of the model file.
    """

    bound: float  # largest absolute torque; 0 where nothing is fed forward
    offset: float
    constant: float
    sine: float
    cosine: float

    def at(self, position: float) -> float:
        """Return the torque at a position (rad or m), N m or N; 0 where the position is not finite."""
        if self.bound == 0.0 or not math.isfinite(position):
            return 0.0
        torque = self.offset + float(gravity_torque(self.constant, self.sine, self.cosine, position))
        return min(max(torque, -self.bound), self.bound)

    @property
    def largest(self) -> float:
        """Largest absolute torque without the bound, over a whole turn, N m or N."""
        return abs(self.offset + self.constant) + math.hypot(self.sine, self.cosine)


class Fade:
    """Lets what a value differs by from the one before it vanish, linearly, instead of a step."""

    __slots__ = ("_difference", "_duration_s", "_is_due", "_last", "_left_s", "_period_s")

    def __init__(self, period_s: float) -> None:
        self._period_s = period_s
        self._last = self._difference = self._duration_s = self._left_s = 0.0
        self._is_due = False  # the next value is the first of the new ones

    def begin(self, duration_s: float) -> None:
        """Fade from the last value to those that come now."""
        self._duration_s, self._is_due = duration_s, True

    def next(self, wanted: float) -> float:
        """Return the value of a cycle."""
        if self._is_due:
            self._is_due, self._difference, self._left_s = False, self._last - wanted, self._duration_s
        elif self._left_s > 0.0:
            self._left_s = max(self._left_s - self._period_s, 0.0)
        if self._left_s > 0.0:
            wanted += self._difference * self._left_s / self._duration_s
        self._last = wanted
        return wanted


def static_torque(config: "AxisConfig") -> StaticTorque:
    """Return the feed-forward of gravity and offset of an axis.

    In csp and csv it is bounded by what ``limits.torque`` leaves beside the friction: a bound on the sum alone would
    take the compensation of one direction away. In cst, ``limits.torque`` is the limit of the whole.
    """
    given, mechanics = config.compensation, config.model.mechanics
    gravity = mechanics.gravity
    torque = StaticTorque(0.0, mechanics.offset, gravity.constant, gravity.sine, gravity.cosine)
    if not _is_fed(config) or torque.largest == 0.0:
        return torque
    if config.mode == "cst":
        return torque._replace(bound=config.limits.torque)
    gain = max(given.gain, given.gain if given.gain_negative is None else given.gain_negative)
    return torque._replace(bound=max(config.limits.torque - gain * _largest_friction(config, torque.largest), 0.0))


def _largest_friction(config: "AxisConfig", weight: float) -> float:
    """Return the largest torque of the model's friction in slow motion under a weight, N m or N."""
    friction = config.model.friction_model
    by_load = friction.modifiers.get("load", {})
    return friction.level + weight * float(max(by_load.get("motoring", 0.0), by_load.get("driven", 0.0)))


def _is_fed(config: "AxisConfig") -> bool:
    """Return False where the drive takes no torque, and beside a master, which carries the weight already."""
    if config.compensation.velocity_offset is not None:
        return False
    has_controller = config.mode == "cst" and config.controller is not None
    is_wanted = config.compensation.enabled or has_controller
    return config.compensation.gravity and is_wanted and config.trajectory.kind != "master"


def static_torque_note(config: "AxisConfig") -> str:
    """Return what is fed forward, and whether ``limits.torque`` is too small for it; empty for next to nothing."""
    torque = static_torque(config)
    if not _is_fed(config) or torque.largest <= _NOTEWORTHY * config.limits.torque:
        return ""
    text = (
        f"gravity and offset of the model, up to {torque.largest:.3g} {_unit(config)}, are fed forward as soon as the "
        "axis is enabled (compensation.gravity: false turns this off)"
    )
    shortage = static_torque_shortage(config)
    return f"{text}; limits.torque {shortage}" if shortage else text


def static_torque_shortage(config: "AxisConfig") -> str:
    """Return that ``limits.torque`` is too small for what is to be fed forward; empty where it is not."""
    torque = static_torque(config)
    if not _is_fed(config) or torque.largest <= torque.bound:
        return ""
    rest = "the axis cannot hold the rest" if config.mode == "cst" else "the loops of the drive have to hold the rest"
    return (
        f"leaves {torque.bound:.3g} {_unit(config)} for gravity and offset of the model, which need up to "
        f"{torque.largest:.3g} {_unit(config)}: {rest}"
    )


def _unit(config: "AxisConfig") -> str:
    return FORCE_UNITS[config.model.axis]
