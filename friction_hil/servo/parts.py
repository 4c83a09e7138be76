"""Configuration of friction, load and gear of a simulated servo."""

from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from friction_hil.errors import UsageError
from friction_hil.friction import FrictionModel, create, describe
from friction_hil.friction.modifiers import NAMES as MODIFIERS
from friction_hil.servo.records import MOST_HARMONICS

Axis = Literal["rotary", "linear"]
Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0.0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]


# not a `checked_yaml.section.Section`, because this room must not depend on YAML files
class Part(BaseModel):
    """A section of the configuration: unknown keys are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class TrueFriction(Part):
    """Friction that acts in the simulated servo."""

    model: str = Field("lugre", description="name of a friction model")
    parameters: dict[str, Any] = Field(
        default_factory=lambda: dict(describe("lugre").example), description="parameters of the model, SI"
    )
    modifiers: dict[str, Any] = Field(default_factory=dict, description=f"modifiers: {', '.join(MODIFIERS)}")

    @model_validator(mode="after")
    def _exists(self) -> "TrueFriction":
        try:
            create(self.model, modifiers=self.modifiers, **self.parameters)
        except UsageError as error:
            raise ValueError(str(error)) from None  # pydantic collects it, together with its field path
        return self

    def create(self, axis: Axis) -> FrictionModel:
        """Return the model for a rotary or linear axis, a new object at each call."""
        return create(self.model, modifiers=self.modifiers, axis=axis, **self.parameters)


class Harmonic(Part):
    """One harmonic of a position."""

    order: Positive = Field(description="periods per revolution; on a linear axis per metre")
    cosine: Finite = Field(0.0, description="factor of the cosine")
    sine: Finite = Field(0.0, description="factor of the sine")


Harmonics = Annotated[tuple[Harmonic, ...], Field(max_length=MOST_HARMONICS)]


class Load(Part):
    """Second mass, driven through a coupling; all values are referred to the axis's own coordinate."""

    inertia: Positive = Field(description="inertia behind the coupling, kg m^2 (linear: mass, kg)")
    stiffness: Positive = Field(description="stiffness of the coupling, N m/rad")
    damping: NotNegative = Field(0.0, description="damping of the coupling, N m s/rad")
    backlash: NotNegative = Field(
        0.0, description="whole gap of the coupling, rad; its faces push and never pull, 0: none"
    )
    friction: TrueFriction | None = Field(None, description="friction at the load, besides the one at the motor")


class Gravity(Part):
    """Pendulum: load torque that depends on the position, opposing positive motion; with the terms of a model file."""

    sine: Finite = Field(0.0, description="N m times the sine of the position: mass g length if 0 is hanging down")
    cosine: Finite = Field(0.0, description="N m times the cosine of the position: mass g length if 0 is horizontal")


class Spring(Part):
    """Spring between load and machine frame."""

    stiffness: Positive = Field(description="N m/rad")
    rest: Finite = Field(0.0, description="position without torque, rad")


class ExternalSine(Part):
    """Load torque that oscillates."""

    amplitude: Finite = Field(description="N m")
    frequency_hz: Positive = Field(description="Hz")


class ExternalStep(Part):
    """Load torque from a time on."""

    time_s: NotNegative = Field(description="since the start of the simulation, s")
    torque: Finite = Field(description="from then on, N m; 0 ends a pulse")


class External(Part):
    """Load torque that is a function of time, e.g. a cutting force; positive opposes positive motion."""

    sine: ExternalSine | None = Field(None, description="sine of time")
    steps: tuple[ExternalStep, ...] = Field((), description="constant between the times")
    file: Path | None = Field(
        None,
        description="text file of two columns, time in s and torque in N m, interpolated linearly; "
        "relative to the configuration file",
    )

    @model_validator(mode="after")
    def _is_ordered(self) -> "External":
        times = [step.time_s for step in self.steps]
        if any(after <= before for before, after in pairwise(times)):
            raise ValueError(f"the times of steps must rise, not {', '.join(f'{time:g}' for time in times)}")
        if self.steps and self.file is not None:
            raise ValueError("either steps or a file, not both")
        return self


class Hysteresis(Part):
    """Torsional hysteresis of a gear, parallel to its stiffness: Dahl's equation in the twist."""

    torque: Positive = Field(description="largest torque of the hysteresis, half the height of the loop, N m")
    stiffness: Positive = Field(description="slope where the twist reverses, besides the coupling's, N m/rad")


class Gear(Part):
    """Gear between motor and load."""

    forward_efficiency: Annotated[float, Field(gt=0.0, le=1.0)] = Field(
        1.0, description="efficiency while the motor drives; its losses are friction in proportion to the torque"
    )
    backward_efficiency: Annotated[float, Field(ge=-10.0, le=1.0)] = Field(
        1.0, description="efficiency while the load drives; 0 or less: self-locking"
    )
    transmission_error: Harmonics = Field(
        (), description="position error of the load over the position of the motor, rad; needs mechanics.load"
    )
    hysteresis: Hysteresis | None = Field(None, description="torsional hysteresis; needs mechanics.load")
