"""Trajectories in the configuration: the motion that an axis shall make."""

import math
from typing import Annotated, Literal

from pydantic import Field

from friction_hil.checked_yaml.section import POSITION, VELOCITY, Section, key

_RAMP = key("time to reach full speed from rest, and to come to rest", "s", default=1.0, gt=0)


class Circle(Section):
    """x = radius cos(2 pi frequency t + phase); a second axis a quarter behind (phase -pi/2) makes the circle."""

    kind: Literal["circle"]
    radius: float = key("amplitude of this axis", POSITION, gt=0)
    frequency: float = key("rounds per second", "Hz", gt=0)
    phase: float = key("phase of this axis", "rad", default=0.0)
    ramp_s: float = _RAMP


class Sine(Section):
    """x = amplitude sin(2 pi frequency t + phase)."""

    kind: Literal["sine"]
    amplitude: float = key("amplitude", POSITION, gt=0)
    frequency: float = key("periods per second", "Hz", gt=0)
    phase: float = key("phase", "rad", default=0.0)
    ramp_s: float = _RAMP


class Triangle(Section):
    """Constant speed to and fro, with rounded corners."""

    kind: Literal["triangle"]
    amplitude: float = key("amplitude", POSITION, gt=0)
    frequency: float = key("periods per second", "Hz", gt=0)
    rounding: float = key("share of a quarter period over which a corner is rounded", "1", default=0.1, gt=0, le=0.5)


class ExperimentBounds(Section):
    """How far and how fast an axis may move to show its friction."""

    velocity: float = key("highest speed, where travel leaves room for it", VELOCITY, gt=0)
    travel: float = key("largest distance from the start, to either side", POSITION, gt=0)
    acceleration: float | None = key("highest acceleration", f"{VELOCITY} per s", default=None, gt=0)
    duration_s: float = key("length", "s", default=60.0, ge=10)
    ramp_s: float = _RAMP


class AxisExperiment(ExperimentBounds):
    """What `tune` has to be told of an axis."""

    axis: Literal["rotary", "linear"] | None = key(
        "kind of the axis while its model file is not there yet: rotary (by default) or linear", default=None
    )


class Experiment(ExperimentBounds):
    """Swelling sines from presliding to full speed, back to the start, then rest: the motion for `identify`."""

    kind: Literal["experiment"]


class Hold(Section):
    """Stay where the axis is."""

    kind: Literal["hold"]


class NoTrajectory(Section):
    """No set-point: the torque is the compensation alone (mode cst). The axis can be moved by hand."""

    kind: Literal["none"]


Trajectory = Annotated[Circle | Sine | Triangle | Experiment | Hold | NoTrajectory, Field(discriminator="kind")]


def peak_speed(trajectory: Trajectory) -> float:
    """Return the highest speed of a trajectory, rad/s or m/s."""
    if trajectory.kind == "circle":
        return math.tau * trajectory.frequency * trajectory.radius
    if trajectory.kind == "sine":
        return math.tau * trajectory.frequency * trajectory.amplitude
    if trajectory.kind == "triangle":
        return 4.0 * trajectory.frequency * trajectory.amplitude
    if trajectory.kind == "experiment":
        return trajectory.velocity
    return 0.0
