"""Configuration of trajectories, the motion of an axis."""

import math
from typing import Annotated, Literal

from pydantic import Field

from friction_hil.checked_yaml.section import (
    LEAST_FREQUENCY_HZ,
    MOST_ACCELERATION,
    MOST_FREQUENCY_HZ,
    MOST_POSITION,
    MOST_S,
    MOST_VELOCITY,
    POSITION,
    VELOCITY,
    Section,
    key,
)
from friction_hil.motion.multisine import DURATION_S, LEAST_S, LOW_HZ
from friction_hil.motion.sequence import STROKE_SPEED, moving_s

LONGEST_EXPERIMENT_S = 600.0  # 60 s are usual, and the whole path is examined before the first motion
_RAMP = key("time from rest to full speed, and from full speed to rest", "s", default=1.0, gt=0, le=3600)


class Circle(Section):
    """x = radius cos(2 pi frequency t + phase). A circle needs a second axis with a phase of -pi/2."""

    kind: Literal["circle"]
    radius: float = key("amplitude of this axis", POSITION, gt=0, le=MOST_POSITION)
    frequency: float = key("laps per second", "Hz", ge=LEAST_FREQUENCY_HZ, le=MOST_FREQUENCY_HZ)
    phase: float = key("phase of this axis", "rad", default=0.0, ge=-1e3, le=1e3)
    ramp_s: float = _RAMP


class Sine(Section):
    """x = amplitude sin(2 pi frequency t + phase)."""

    kind: Literal["sine"]
    amplitude: float = key("amplitude", POSITION, gt=0, le=MOST_POSITION)
    frequency: float = key("periods per second", "Hz", ge=LEAST_FREQUENCY_HZ, le=MOST_FREQUENCY_HZ)
    phase: float = key("phase", "rad", default=0.0, ge=-1e3, le=1e3)
    ramp_s: float = _RAMP


class Triangle(Section):
    """Motion to and fro at constant speed, with rounded corners."""

    kind: Literal["triangle"]
    amplitude: float = key("amplitude", POSITION, gt=0, le=MOST_POSITION)
    frequency: float = key("periods per second", "Hz", ge=LEAST_FREQUENCY_HZ, le=MOST_FREQUENCY_HZ)
    rounding: float = key(
        "duration of the rounding of a corner, as a fraction of a quarter period", "1", default=0.1, gt=0, le=0.5
    )


class ExperimentBounds(Section):
    """Bounds of the motion of an identification experiment."""

    velocity: float = key("highest speed, reached if travel permits", VELOCITY, gt=0, le=MOST_VELOCITY)
    travel: float = key("largest distance from the start, to either side", POSITION, gt=0, le=MOST_POSITION)
    acceleration: float | None = key(
        "highest acceleration", f"{VELOCITY} per s", default=None, gt=0, le=MOST_ACCELERATION
    )
    duration_s: float = key("duration", "s", default=60.0, ge=10, le=LONGEST_EXPERIMENT_S)
    ramp_s: float = _RAMP


class AxisExperiment(ExperimentBounds):
    """Bounds of the experiment of `tune`."""

    duration_s: float = key(
        "longest duration; the experiment ends earlier when what is unknown does not matter any more",
        "s",
        default=60.0,
        ge=10,
        le=LONGEST_EXPERIMENT_S,
    )
    axis: Literal["rotary", "linear"] | None = key(
        "kind of an axis without a model file: rotary (default) or linear", default=None
    )


class Experiment(ExperimentBounds):
    """Sines of increasing amplitude, from presliding to full speed, for `identify`; then back to the start and rest."""

    kind: Literal["experiment"]


class Multisine(Section):
    """Strokes of constant speed with many small sines on top, to show resonances to `identify`; then rest at the start.

    The velocity never changes its sign within a stroke, so that the axis slides.
    """

    kind: Literal["multisine"]
    velocity: float = key("highest speed", VELOCITY, gt=0, le=MOST_VELOCITY)
    travel: float = key("largest distance from the start, to either side", POSITION, gt=0, le=MOST_POSITION)
    acceleration: float | None = key(
        "highest acceleration, if it is to be less than a quarter of that of an experiment of the same velocity",
        f"{VELOCITY} per s",
        default=None,
        gt=0,
        le=MOST_ACCELERATION,
    )
    high_hz: float | None = key(
        "highest frequency; null: 250 Hz, but at most 0.4 of the loop rate",
        "Hz",
        default=None,
        ge=2.0 * LOW_HZ,
        le=MOST_FREQUENCY_HZ,
    )
    duration_s: float = key(
        "duration, rounded down to multiples of 8 s", "s", default=DURATION_S, ge=LEAST_S, le=LONGEST_EXPERIMENT_S
    )
    ramp_s: float = _RAMP


class Strokes(Section):
    """Strokes from the start to one side and back, with a rest after each."""

    kind: Literal["strokes"]
    stroke: float = key("length of a stroke", POSITION, gt=0, le=MOST_POSITION)
    frequency: float = key("strokes to and fro per second", "Hz", ge=LEAST_FREQUENCY_HZ, le=MOST_FREQUENCY_HZ)
    rest: float = key("fraction of the time at rest", "1", default=0.5, ge=0, le=0.99)


PeriodicMotion = Annotated[Circle | Sine | Triangle | Strokes, Field(discriminator="kind")]


class SequencePart(Section):
    """Whole periods of a motion that starts and stops smoothly, and a rest; at its end the axis is where it began."""

    name: str = key("name, for results", pattern="^[a-z][a-z0-9_]*$", max_length=32)
    motion: PeriodicMotion = key("motion: kind circle, sine, triangle or strokes")
    periods: int = key("periods of the motion", "1", default=1, ge=1, le=1_000_000)
    ramp_s: float = key(
        "time from rest to full speed and back; instead of that of the motion", "s", default=1.0, ge=0, le=3600
    )
    rest_s: float = key("rest after the motion", "s", default=0.5, ge=0, le=MOST_S)

    @property
    def length_s(self) -> float:
        """Length of the periods at full speed, s."""
        return self.periods / self.motion.frequency

    @property
    def moving_s(self) -> float:
        """Time from the start of the motion to its stop, s."""
        return moving_s(self.length_s, self.ramp_s)

    @property
    def duration_s(self) -> float:
        """Time until the next motion begins, s."""
        return self.moving_s + self.rest_s


class MotionSequence(Section):
    """Motions one after another, each from where the axis stands at the start, with rests; then rest."""

    kind: Literal["sequence"]
    motions: tuple[SequencePart, ...] = key("motions", min_length=1, max_length=100)
    ramp_s: float = _RAMP

    @property
    def duration_s(self) -> float:
        """Time of all motions, s."""
        return math.fsum(part.duration_s for part in self.motions)


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
    Circle | Sine | Triangle | Strokes | Experiment | Multisine | MotionSequence | Hold | NoTrajectory | Master,
    Field(discriminator="kind"),
]


def peak_speed(trajectory: Trajectory) -> float:
    """Return the highest speed of a trajectory, rad/s or m/s."""
    if trajectory.kind == "circle":
        return math.tau * trajectory.frequency * trajectory.radius
    if trajectory.kind == "sine":
        return math.tau * trajectory.frequency * trajectory.amplitude
    if trajectory.kind == "triangle":
        return 4.0 * trajectory.frequency * trajectory.amplitude
    if trajectory.kind == "strokes":
        return STROKE_SPEED * trajectory.stroke * 2.0 * trajectory.frequency / (1.0 - trajectory.rest)
    if trajectory.kind == "experiment" or trajectory.kind == "multisine":
        return trajectory.velocity
    if trajectory.kind == "sequence":
        return max(peak_speed(part.motion) for part in trajectory.motions)
    return 0.0
