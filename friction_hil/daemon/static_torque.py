"""Feed-forward of gravity and offset of a model file, or of an arm: what an axis gets of it, and what is said of it."""

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from friction_hil.compensator.load import gravity_torque
from friction_hil.dynamics import torques
from friction_hil.numerics.readable import FORCE_UNITS

if TYPE_CHECKING:
    from friction_hil.config import AxisConfig, Configuration

_POSES = 1000  # of an arm that are looked at for the largest weight
_NOTEWORTHY = 0.01  # of limits.torque: identification finds a small offset where there is none


class StaticTorque(NamedTuple):
    """Feed-forward torque that depends on nothing but the position, N m or N, and that of an arm.

    The values beside bound and per_load are ``mechanics.offset`` and ``mechanics.gravity`` of the model file.
    """

    bound: float  # largest absolute torque; 0 where nothing is fed forward
    offset: float
    constant: float
    sine: float
    cosine: float
    per_load: float = 0.0  # of the bound, that friction takes for each N m of the load of an arm

    def at(self, position: float, arm: float = 0.0, load: float = 0.0) -> float:
        """Return the torque at a position (rad or m), N m or N; 0 where the position is not finite.

        ``arm``, ``load``: what the arm needs on this axis, and what the gear carries of it, N m or N.
        """
        if self.bound == 0.0 or not math.isfinite(position):
            return 0.0
        torque = self.offset + float(gravity_torque(self.constant, self.sine, self.cosine, position)) + arm
        bound = self.bound if self.per_load == 0.0 else max(self.bound - self.per_load * abs(load), 0.0)
        return min(max(torque, -bound), bound)

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


def static_torque(config: "AxisConfig", *, is_of_arm: bool = False) -> StaticTorque:
    """Return the feed-forward of gravity and offset of an axis; ``is_of_arm``: the arm's weight and inertia come to it.

    In csp and csv it is bounded by what ``limits.torque`` leaves beside the friction: a bound on the sum alone would
    take the compensation of one direction away. In cst, ``limits.torque`` is the limit of the whole.
    """
    given, mechanics = config.compensation, config.model.mechanics
    gravity = mechanics.gravity
    torque = StaticTorque(0.0, mechanics.offset, gravity.constant, gravity.sine, gravity.cosine)
    if not _is_fed(config) or (torque.largest == 0.0 and not is_of_arm):
        return torque
    if config.mode == "cst":
        return torque._replace(bound=config.limits.torque)
    gain = max(given.gain, given.gain if given.gain_negative is None else given.gain_negative)
    level, by_load = gain * config.model.friction_model.level, gain * _by_load(config)
    bound = max(config.limits.torque - level - by_load * torque.largest, 0.0)
    return torque._replace(bound=bound, per_load=by_load if is_of_arm else 0.0)


def _by_load(config: "AxisConfig") -> float:
    """Return by how much a load raises the friction of the model at most, 1."""
    by_load = config.model.friction_model.modifiers.get("load", {})
    return float(max(by_load.get("motoring", 0.0), by_load.get("driven", 0.0)))


def _is_fed(config: "AxisConfig") -> bool:
    """Return False where the drive takes no torque, and beside a master, which carries the weight already."""
    if config.compensation.velocity_offset is not None:
        return False
    has_controller = config.mode == "cst" and config.controller is not None
    is_wanted = config.compensation.enabled or has_controller
    return config.compensation.gravity and is_wanted and config.trajectory.kind != "master"


def largest_weights(configuration: "Configuration") -> dict[str, float]:
    """Return the largest weight on each axis of the arm in many poses within ``limits.position``, N m or N.

    Without these limits a hinge may have any angle, and a prismatic joint is at zero.
    """
    if configuration.arm is None:
        return {}
    names, arm = list(configuration.arm.joints), configuration.arm.dynamics
    axes = [configuration.axes[name] for name in names]
    reaches = [0.0 if axis.model.axis == "linear" else math.pi for axis in axes]
    low, high = zip(*(axis.limits.position or (-r, r) for axis, r in zip(axes, reaches, strict=True)), strict=True)
    work, known = torques.workspace(len(names))
    largest = np.zeros(len(names))
    for pose in np.random.default_rng(0).uniform(low, high, (_POSES, len(names))):
        work[torques.Q] = pose
        torques.find_torques(arm.links, arm.gravity_vector, work, known)
        np.maximum(largest, np.abs(work[torques.LOAD]), out=largest)
    return dict(zip(names, largest.tolist(), strict=True))


def static_torque_note(config: "AxisConfig", weight: float | None = None) -> str:
    """Return what is fed forward, and whether ``limits.torque`` is too small for it; empty for next to nothing.

    ``weight``: of an axis of an arm, the largest one there, N m or N.
    """
    largest = static_torque(config).largest + (weight or 0.0)
    has_weight = largest > _NOTEWORTHY * config.limits.torque
    if not _is_fed(config) or not (has_weight or weight is not None):
        return ""
    what, size = "gravity and offset of the model", f"up to {largest:.3g} {_unit(config)}"
    if weight is not None:
        what = "inertia and coupling of the arm" + ", and its weight" * has_weight
    what += f", {size}," * has_weight
    text = f"{what} are fed forward as soon as the axis is enabled (compensation.gravity: false turns this off)"
    shortage = static_torque_shortage(config, weight)
    return f"{text}; limits.torque {shortage}" if shortage else text


def static_torque_shortage(config: "AxisConfig", weight: float | None = None) -> str:
    """Return that ``limits.torque`` is too small for what is to be fed forward; empty where it is not."""
    torque = static_torque(config, is_of_arm=weight is not None)
    largest, bound = torque.largest + (weight or 0.0), max(torque.bound - torque.per_load * (weight or 0.0), 0.0)
    if not _is_fed(config) or largest <= bound:
        return ""
    rest = "the axis cannot hold the rest" if config.mode == "cst" else "the loops of the drive have to hold the rest"
    what = "gravity and offset of the model" if weight is None else "the weight of the arm"
    unit = _unit(config)
    return f"leaves {bound:.3g} {unit} for {what}, which need up to {largest:.3g} {unit}: {rest}"


def _unit(config: "AxisConfig") -> str:
    return FORCE_UNITS[config.model.axis]
