"""Configuration of trajectories, the motion of an axis."""

import math
from typing import Annotated, Literal

from pydantic import Field

from friction_hil.checked_yaml.section import POSITION, VELOCITY, Section, key

_RAMP = key("time from rest to full speed, and from full speed to rest", "s", default=1.0, gt=0)


class Circle(Section):
    """x = radius cos(2 pi frequency t + phase). A circle needs a second axis with a phase of -pi/2."""

    kind: Literal["circle"]
    radius: float = key("amplitude of this axis", POSITION, gt=0)
    frequency: float = key("laps per second", "Hz", gt=0)
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
    """Motion to and fro at constant speed, with rounded corners."""

    kind: Literal["triangle"]
    amplitude: float = key("amplitude", POSITION, gt=0)
    frequency: float = key("periods per second", "Hz", gt=0)
    rounding: float = key(
        "duration of the rounding of a corner, as a fraction of a quarter period", "1", default=0.1, gt=0, le=0.5
    )


class ExperimentBounds(Section):
    """Bounds of the motion of an identification experiment."""

    velocity: float = key("highest speed, reached if travel permits", VELOCITY, gt=0)
    travel: float = key("largest distance from the start, to either side", POSITION, gt=0)
    acceleration: float | None = key("highest acceleration", f"{VELOCITY} per s", default=None, gt=0)
    duration_s: float = key("duration", "s", default=60.0, ge=10)
    ramp_s: float = _RAMP


class AxisExperiment(ExperimentBounds):
    """Bounds of the experiment of `tune`."""

    axis: Literal["rotary", "linear"] | None = key(
        "kind of an axis without a model file: rotary (default) or linear", default=None
    )


class Experiment(ExperimentBounds):
    """Sines of increasing amplitude, from presliding to full speed, for `identify`; then back to the start and rest."""

    kind: Literal["experiment"]


class Hold(Section):
    """Stay at the present position."""

    kind: Literal["hold"]


class NoTrajectory(Section):
    """No set-point: the torque is only the compensation (mode cst), and the axis can be moved by hand."""

    kind: Literal["none"]


class Master(Section):
    """The motion of the controller that is master of the bus (bus.role: sidecar); its set-points are listened to."""

    kind: Literal["master"]


Trajectory = Annotated[
    Circle | Sine | Triangle | Experiment | Hold | NoTrajectory | Master, Field(discriminator="kind")
]


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
