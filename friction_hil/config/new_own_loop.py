"""Text of a new configuration for a loop of the user's own, from what a log of its joints showed."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from friction_hil.config.annotated import FILL_IN, Page
from friction_hil.config.axis import AxisConfig, AxisLimits
from friction_hil.config.own_loop import OwnLoopOptions
from friction_hil.friction import FrictionModel
from friction_hil.numerics.readable import FORCE_UNITS

_MARGIN = 1.5  # of the limits, over the largest value in the log
_LEAST = 1e-9  # a limit is above zero
_STEADY_S, _STEPS = 1.0, 1000  # of a motion at which the friction is that of its speed


@dataclass(frozen=True, slots=True)
class LoggedJoint:
    """A joint of a log, SI."""

    model: Path  # model file, as the configuration names it
    is_linear: bool
    friction: FrictionModel
    resolution: float | None  # step of the position; None: not quantised
    speed: float  # highest in the log
    load: float  # largest absolute torque through its gear


def own_loop_configuration(joints: Mapping[str, LoggedJoint]) -> str:
    """Return a configuration for `friction_hil.Compensator`: its limits are those of the log and half as much again."""
    head = Page(is_linear=False)
    head.lines += [
        "# For friction_hil.Compensator, in the order of the log's joints. Limits are what the log showed and half as",
        "# much again: adapt them to the robot. 'friction-hil config check' finds every mistake.",
    ]
    head.key(0, "version", 1)
    head.key(0, "axes", None)
    lines = head.lines
    for name, joint in joints.items():
        page = Page(is_linear=joint.is_linear)
        page.key(1, name, None)
        resolution = FILL_IN if joint.resolution is None else float(f"{joint.resolution:.4g}")
        page.of(2, OwnLoopOptions, "position_resolution", resolution)
        page.key(2, "limits", None)
        unit = FORCE_UNITS["linear" if joint.is_linear else "rotary"]
        page.key(3, "torque", _limit(_largest(joint)), f"{unit}; limit of the compensation")
        page.of(3, AxisLimits, "velocity", _limit(joint.speed))
        page.of(3, AxisLimits, "following_error", None)
        page.of(2, AxisConfig, "model", joint.model)
        lines += page.lines
    return "\n".join([*lines, ""])


def _largest(joint: LoggedJoint) -> float:
    """Return the largest steady friction at the log's highest speed and load, and in slow motion."""
    found = joint.friction.level
    for speed in (joint.speed, -joint.speed):
        for load in (joint.load, -joint.load):
            velocity = np.full(_STEPS, speed)
            torque = joint.friction.simulate(velocity, _STEADY_S / _STEPS, position=0.0, load_torque=load)
            found = max(found, abs(float(torque[-1])))
    return found


def _limit(value: float) -> float:
    """Return a limit with two digits, rounded up."""
    value = max(value, _LEAST)
    digit = 10.0 ** (math.floor(math.log10(value)) - 1)
    return float(f"{math.ceil(_MARGIN * value / digit) * digit:.3g}")
