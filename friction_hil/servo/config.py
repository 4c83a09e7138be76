"""Configuration of a simulated servo: the servo keys of an axis's ``simulation``."""

import math
from itertools import pairwise
from typing import Annotated

from pydantic import Field, model_validator

from friction_hil.friction import FrictionModel
from friction_hil.servo.drive_parts import Encoder, Loops, Motor, Thermal, TorqueFeedback, Wear
from friction_hil.servo.parts import (
    Axis,
    External,
    Finite,
    Gear,
    Gravity,
    Harmonics,
    Load,
    Part,
    Positive,
    Spring,
    TrueFriction,
)
from friction_hil.servo.records import HISTORY_ROOM, MOST_TIMES

__all__ = ["Encoder", "Gear", "Loops", "Motor", "ServoConfig", "ServoMechanics", "TrueFriction", "least_integration_hz"]


class ServoMechanics(Part):
    """Moving masses, load and brake."""

    axis: Axis = Field("rotary", description="rotary: rad and N m; linear: m and N")
    inertia: Positive = Field(
        2e-4, description="inertia of motor and load, kg m^2 (linear: mass, kg); with mechanics.load of the motor alone"
    )
    load_torque: Finite = Field(
        0.0, description="constant load torque, N m, opposing positive motion; e.g. the weight on a vertical axis"
    )
    has_brake: bool = Field(False, description="true: a brake holds the axis while the drive is off")
    load: Load | None = Field(None, description="second mass behind a coupling; load torques act there")
    gravity: Gravity | None = Field(None, description="load torque of a pendulum")
    spring: Spring | None = Field(None, description="spring between load and machine frame")
    inertia_variation: Harmonics = Field(
        (), description="inertia of the load that depends on its position, in kg m^2, added to the constant one"
    )
    external: External | None = Field(None, description="load torque that is a function of time")

    @property
    def total_inertia(self) -> float:
        """Of motor and load, without its variation, kg m^2 or kg."""
        return self.inertia + (0.0 if self.load is None else self.load.inertia)

    @property
    def is_rigid(self) -> bool:
        """True for one mass with constant load torque."""
        parts = (self.load, self.gravity, self.spring, self.external)
        return not (any(part is not None for part in parts) or self.inertia_variation)

    @model_validator(mode="after")
    def _is_possible(self) -> "ServoMechanics":
        if self.gravity is not None and self.axis == "linear":
            raise ValueError("gravity is that of a pendulum, on a rotary axis; the weight of a linear one: load_torque")
        swing = sum(math.hypot(each.cosine, each.sine) for each in self.inertia_variation)
        inertia = self.inertia if self.load is None else self.load.inertia
        if swing >= inertia:
            raise ValueError(
                f"inertia_variation of {swing:g} would make the inertia of {inertia:g} kg m^2 negative somewhere"
            )
        return self


class ServoConfig(Part):
    """A simulated servo: mechanics with true friction, gear, encoder, motor and drive loops."""

    mechanics: ServoMechanics = ServoMechanics()
    friction: TrueFriction = TrueFriction()
    gear: Gear = Gear()
    encoder: Encoder = Encoder()
    torque_feedback: TorqueFeedback = TorqueFeedback()
    motor: Motor = Motor()
    loops: Loops = Loops()
    thermal: Thermal | None = Field(None, description="heat of motor and gear; without it temperatures are constant")
    wear: Annotated[tuple[Wear, ...], Field(max_length=MOST_TIMES)] = Field(
        (), description="course of friction over thermal time, e.g. wear, and re-lubrication after it"
    )
    time_lapse: Positive = Field(
        1.0, description="thermal time, of heat and wear, over simulated time; 3600: an hour a second"
    )
    seed: Annotated[int, Field(ge=0, le=1000)] = Field(1, description="of the noise of encoder and torque feedback")
    integration_hz: Positive = Field(
        80000.0, description="integration steps per second, Hz; a multiple of loops.rate_hz"
    )

    @model_validator(mode="after")
    def _has_load(self) -> "ServoConfig":
        if self.mechanics.load is not None:
            return self
        for key, is_given in (
            ("encoder.at: load or both", self.encoder.at != "motor"),
            ("gear.transmission_error", bool(self.gear.transmission_error)),
            ("gear.hysteresis", self.gear.hysteresis is not None),
        ):
            if is_given:
                raise ValueError(f"{key} needs mechanics.load, the mass behind the coupling")
        return self

    @model_validator(mode="after")
    def _fits_in_time(self) -> "ServoConfig":
        rate = self.loops.rate_hz
        for key, delay_s in (
            ("encoder.latency_s", self.encoder.latency_s),
            ("torque_feedback.delay_s", self.torque_feedback.delay_s),
            ("loops.dead_time_s", self.loops.dead_time_s),
        ):
            if delay_s * rate > HISTORY_ROOM - 2:
                raise ValueError(f"{key} must be at most {(HISTORY_ROOM - 2) / rate:g} s at loops.rate_hz = {rate:g}")
        times = [each.time_s for each in self.wear]
        if any(after <= before for before, after in pairwise(times)):
            raise ValueError(f"the times of wear must rise, not {', '.join(f'{time:g}' for time in times)}")
        if self.thermal is not None and self.time_lapse / rate > 0.2 * self.thermal.least_time_constant_s:
            most = 0.2 * self.thermal.least_time_constant_s * rate
            raise ValueError(
                f"time_lapse = {self.time_lapse:g} is too fast for these thermal nodes; at most {most:.3g}"
            )
        return self

    @model_validator(mode="after")
    def _has_one_load_dependence(self) -> "ServoConfig":
        if self.gear_losses and "load" in self.friction.modifiers:
            raise ValueError("gear efficiencies and friction.modifiers.load are the same losses: give one of them")
        return self

    @model_validator(mode="after")
    def _is_integrable(self) -> "ServoConfig":
        ratio = self.integration_hz / self.loops.rate_hz
        if ratio < 1.0 or abs(ratio - round(ratio)) > 1e-9 * ratio:
            raise ValueError(
                f"integration_hz must be a multiple of loops.rate_hz, not {ratio:g} times it; "
                f"try {max(1, round(ratio)) * self.loops.rate_hz:g}"
            )
        needed = least_integration_hz(self.mechanics, self.friction)
        if self.integration_hz < needed:
            raise ValueError(
                f"integration_hz = {self.integration_hz:g} is too slow for this friction and inertia; "
                f"at least {math.ceil(needed / self.loops.rate_hz) * self.loops.rate_hz:g} is needed"
            )
        return self

    @property
    def is_rigid(self) -> bool:
        """True for one mass with constant load torque and friction, and no further part: the fastest to simulate."""
        parts = (self.encoder, self.torque_feedback, self.motor, self.loops)
        is_aging = self.thermal is not None or bool(self.wear)
        return self.mechanics.is_rigid and all(part.is_plain for part in parts) and not is_aging

    @property
    def gear_losses(self) -> dict[str, float]:
        """Modifier ``load`` of the friction at the motor that the efficiencies of the gear amount to; often empty."""
        gear = self.gear
        if gear.forward_efficiency == gear.backward_efficiency == 1.0:
            return {}
        return {"motoring": 1.0 / gear.forward_efficiency - 1.0, "driven": 1.0 - gear.backward_efficiency}

    @property
    def friction_model(self) -> FrictionModel:
        """The friction model at the motor with the losses of the gear, a new object at each access."""
        losses = self.gear_losses
        modifiers = self.friction.modifiers | ({"load": losses} if losses else {})
        return self.friction.model_copy(update={"modifiers": modifiers}).create(self.mechanics.axis)

    @property
    def load_friction_model(self) -> FrictionModel | None:
        """The friction model at the load, a new object at each access."""
        load = self.mechanics.load
        return None if load is None or load.friction is None else load.friction.create(self.mechanics.axis)


def least_integration_hz(mechanics: ServoMechanics, friction: TrueFriction) -> float:
    """Return the rate at which the explicit coupling of inertia and bristle is well within its stability limit, Hz.

    The coupling of two masses is implicit; its resonance gets twelve steps a period at least.
    """
    load, stiffness, damping = mechanics.load, *_stiffness_and_damping(friction, mechanics.axis)
    spring = 0.0 if mechanics.spring is None else mechanics.spring.stiffness
    swing = sum(math.hypot(each.cosine, each.sine) for each in mechanics.inertia_variation)
    if load is None:
        lightest = mechanics.inertia - swing
        damping *= 1.0 if mechanics.is_rigid else 2.0  # the velocity is extrapolated
        return max(2.0 * math.sqrt((stiffness + spring) / lightest), damping / lightest, 20000.0)
    lightest = load.inertia - swing
    needed = [
        20000.0,
        2.0 * math.sqrt(stiffness / mechanics.inertia),
        2.0 * damping / mechanics.inertia,
        2.0 * math.sqrt(load.stiffness * (1.0 / mechanics.inertia + 1.0 / lightest)),
    ]
    stiffness, damping = (0.0, 0.0) if load.friction is None else _stiffness_and_damping(load.friction, mechanics.axis)
    return max(*needed, 2.0 * math.sqrt((stiffness + spring) / lightest), 2.0 * damping / lightest)


def _stiffness_and_damping(friction: TrueFriction, axis: Axis) -> tuple[float, float]:
    damping = sum(friction.parameters.get(name, 0.0) for name in ("sigma1", "sigma2", "viscous"))
    return friction.create(axis).presliding_stiffness, damping
