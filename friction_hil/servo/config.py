"""What a simulated servo is: the servo part of an axis's ``simulation`` in the configuration."""

import math
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from friction_hil.errors import UsageError
from friction_hil.friction import FrictionModel, create

Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0.0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Mechanics(_Part):
    """What the motor turns or pushes."""

    axis: Literal["rotary", "linear"] = Field("rotary", description="rotary: rad and N m; linear: m and N")
    inertia: Positive = Field(2e-4, description="inertia of motor and load, kg m^2 (linear: mass, kg)")
    load_torque: Finite = Field(
        0.0, description="constant load, N m, opposing positive motion; weight on a vertical axis"
    )
    has_brake: bool = Field(False, description="a brake holds the axis while the drive is off")


class TrueFriction(_Part):
    """The friction that really acts in the simulated servo."""

    model: str = Field("lugre", description="name of a friction model")
    parameters: dict[str, Any] = Field(
        default_factory=lambda: {
            "sigma0": 2000.0,
            "sigma1": 1.0,
            "sigma2": 2e-3,
            "coulomb": 0.08,
            "static": 0.12,
            "stribeck_velocity": 0.2,
            "damping_velocity": 0.2,
        },
        description="its parameters, SI",
    )
    modifiers: dict[str, Any] = Field(
        default_factory=dict, description="what changes it: direction, viscous, load, temperature, ripple"
    )

    @model_validator(mode="after")
    def _exists(self) -> "TrueFriction":
        try:
            create(self.model, modifiers=self.modifiers, **self.parameters)
        except UsageError as error:
            raise ValueError(str(error)) from None  # what pydantic gathers, with its place in the file
        return self


class Encoder(_Part):
    """Position sensor of the simulated servo."""

    counts: Positive = Field(1048576, description="counts per revolution (linear: per metre)")


class Motor(_Part):
    """Torque production of the simulated servo."""

    rated_torque: Positive = Field(0.64, description="rated torque, N m: 1000 per mille in 6071h, 6077h, 60B2h")
    peak_torque: Positive = Field(1.92, description="largest torque of the power stage, N m")
    torque_lag_s: NotNegative = Field(3e-4, description="time constant from torque demand to torque, s")


class Loops(_Part):
    """The drive's own control loops."""

    rate_hz: Positive = Field(8000.0, description="sampling rate of the loops")
    position_gain: NotNegative = Field(200.0, description="position loop, 1/s")
    velocity_gain: NotNegative = Field(0.2, description="velocity loop, N m s/rad")
    integral_hz: NotNegative = Field(16.0, description="corner of the velocity loop's integral action, Hz")
    velocity_filter_hz: Positive = Field(1000.0, description="low-pass on the encoder difference, Hz")
    velocity_feedforward: NotNegative = Field(1.0, description="share of the demanded velocity fed forward")
    inertia_feedforward: NotNegative = Field(
        1.0, description="share of inertia times demanded acceleration fed forward"
    )


class ServoConfig(_Part):
    """A simulated servo: mechanics with true friction, encoder, motor and drive loops."""

    mechanics: Mechanics = Mechanics()
    friction: TrueFriction = TrueFriction()
    encoder: Encoder = Encoder()
    motor: Motor = Motor()
    loops: Loops = Loops()
    integration_hz: Positive = Field(80000.0, description="integration steps per second; a multiple of the loops' rate")

    @model_validator(mode="after")
    def _is_integrable(self) -> "ServoConfig":
        ratio = self.integration_hz / self.loops.rate_hz
        if ratio < 1.0 or abs(ratio - round(ratio)) > 1e-9 * ratio:
            raise ValueError(
                f"integration_hz must be a multiple of loops.rate_hz, not {ratio:g} times it; "
                f"{max(1, round(ratio)) * self.loops.rate_hz:g} would do"
            )
        needed = self._least_integration_hz()
        if self.integration_hz < needed:
            raise ValueError(
                f"integration_hz = {self.integration_hz:g} is too slow for this friction and inertia; "
                f"at least {math.ceil(needed / self.loops.rate_hz) * self.loops.rate_hz:g} is needed"
            )
        return self

    @property
    def friction_model(self) -> FrictionModel:
        """The friction model, made anew at each call."""

        friction = self.friction
        return create(friction.model, modifiers=friction.modifiers, axis=self.mechanics.axis, **friction.parameters)

    def _least_integration_hz(self) -> float:
        """Rate at which the explicit coupling of inertia and bristle is well inside its stability limit."""
        parameters: dict[str, Any] = self.friction.parameters
        stiffness = self.friction_model.presliding_stiffness / self.mechanics.inertia
        damping = sum(parameters.get(name, 0.0) for name in ("sigma1", "sigma2", "viscous")) / self.mechanics.inertia
        return max(2.0 * math.sqrt(stiffness), damping, 20000.0)
