"""Configuration of a simulated servo: the servo keys of an axis's ``simulation``."""

import math
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from friction_hil.errors import UsageError
from friction_hil.friction import FrictionModel, create, describe

Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0.0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]


# not a `checked_yaml.section.Section`, because this room must not depend on YAML files
class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class ServoMechanics(_Part):
    """Moving mass, load and brake."""

    axis: Literal["rotary", "linear"] = Field("rotary", description="rotary: rad and N m; linear: m and N")
    inertia: Positive = Field(2e-4, description="inertia of motor and load, kg m^2 (linear: mass, kg)")
    load_torque: Finite = Field(
        0.0, description="constant load torque, N m, opposing positive motion; e.g. the weight on a vertical axis"
    )
    has_brake: bool = Field(False, description="true: a brake holds the axis while the drive is off")


class TrueFriction(_Part):
    """Friction that acts in the simulated servo."""

    model: str = Field("lugre", description="name of a friction model")
    parameters: dict[str, Any] = Field(
        default_factory=lambda: dict(describe("lugre").example), description="parameters of the model, SI"
    )
    modifiers: dict[str, Any] = Field(
        default_factory=dict, description="modifiers: direction, viscous, load, temperature, ripple"
    )

    @model_validator(mode="after")
    def _exists(self) -> "TrueFriction":
        try:
            create(self.model, modifiers=self.modifiers, **self.parameters)
        except UsageError as error:
            raise ValueError(str(error)) from None  # pydantic collects it, together with its field path
        return self


class Encoder(_Part):
    """Position sensor of the simulated servo."""

    counts: Positive = Field(1048576, description="counts per revolution (linear: per metre)")


class Motor(_Part):
    """Torque of the simulated servo."""

    rated_torque: Positive = Field(0.64, description="rated torque, N m; 1000 per mille in 6071h, 6077h, 60B2h")
    peak_torque: Positive = Field(1.92, description="largest torque of the power stage, N m")
    torque_lag_s: NotNegative = Field(3e-4, description="time constant between torque demand and torque, s")


class Loops(_Part):
    """Control loops of the drive."""

    rate_hz: Positive = Field(8000.0, description="sampling rate of the loops, Hz")
    position_gain: NotNegative = Field(200.0, description="gain of the position loop, 1/s")
    velocity_gain: NotNegative = Field(0.2, description="gain of the velocity loop, N m s/rad")
    integral_hz: NotNegative = Field(16.0, description="corner frequency of the velocity loop's integral part, Hz")
    velocity_filter_hz: Positive = Field(
        1000.0, description="corner frequency of the low-pass on the velocity from encoder differences, Hz"
    )
    velocity_feedforward: NotNegative = Field(1.0, description="gain of the velocity feed-forward; 1: full")
    inertia_feedforward: NotNegative = Field(
        1.0, description="gain of the feed-forward of inertia times demanded acceleration; 1: full"
    )


class ServoConfig(_Part):
    """A simulated servo: mechanics with true friction, encoder, motor and drive loops."""

    mechanics: ServoMechanics = ServoMechanics()
    friction: TrueFriction = TrueFriction()
    encoder: Encoder = Encoder()
    motor: Motor = Motor()
    loops: Loops = Loops()
    integration_hz: Positive = Field(
        80000.0, description="integration steps per second, Hz; a multiple of loops.rate_hz"
    )

    @model_validator(mode="after")
    def _is_integrable(self) -> "ServoConfig":
        ratio = self.integration_hz / self.loops.rate_hz
        if ratio < 1.0 or abs(ratio - round(ratio)) > 1e-9 * ratio:
            raise ValueError(
                f"integration_hz must be a multiple of loops.rate_hz, not {ratio:g} times it; "
                f"try {max(1, round(ratio)) * self.loops.rate_hz:g}"
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
        """The friction model, a new object at each access."""
        friction = self.friction
        return create(friction.model, modifiers=friction.modifiers, axis=self.mechanics.axis, **friction.parameters)

    def _least_integration_hz(self) -> float:
        """Return the rate at which the explicit coupling of inertia and bristle is well within its stability limit."""
        parameters: dict[str, Any] = self.friction.parameters
        stiffness = self.friction_model.presliding_stiffness / self.mechanics.inertia
        damping = sum(parameters.get(name, 0.0) for name in ("sigma1", "sigma2", "viscous")) / self.mechanics.inertia
        return max(2.0 * math.sqrt(stiffness), damping, 20000.0)
