"""Configuration of encoder, torque feedback, motor and loops of a simulated servo."""

from itertools import pairwise
from typing import Annotated, Literal

from pydantic import Field, model_validator

from friction_hil.servo.parts import Finite, Harmonics, NotNegative, Part, Positive


class Encoder(Part):
    """Position sensor of the simulated servo.

    With ``at: both`` the errors, noise and latency are those of the encoder at the load.
    """

    counts: Positive = Field(1048576, description="counts per revolution (linear: per metre)")
    at: Literal["motor", "load", "both"] = Field(
        "motor",
        description="where it is; both: the position loop has one at the load, the velocity loop one at the motor",
    )
    load_counts: Positive | None = Field(
        None,
        description="counts of the encoder at the load, of the position loop with both, of none with motor (CANopen: "
        "60E4h); the same as counts by default",
    )
    periodic_error: Harmonics = Field(
        (), description="position error over position, rad: eccentricity (order 1), interpolation (order: lines)"
    )
    noise: NotNegative = Field(0.0, description="standard deviation of white noise before quantisation, rad")
    latency_s: NotNegative = Field(0.0, description="age of a position when the loops and the bus get it, s")

    @model_validator(mode="after")
    def _has_second(self) -> "Encoder":
        if self.load_counts is not None and self.at == "load":
            raise ValueError("load_counts is the resolution of a second encoder; with 'at: load', counts is that one's")
        return self

    @property
    def position_counts(self) -> float:
        """Counts per revolution or metre of the encoder that the position loop reads, and the drive reports."""
        return self.counts_at_load if self.at == "both" else self.counts

    @property
    def counts_at_load(self) -> float:
        """Counts per revolution or metre of the encoder at the load."""
        return self.load_counts or self.counts

    @property
    def is_plain(self) -> bool:
        """True for an encoder at the motor that only quantises."""
        return self.at == "motor" and not (self.periodic_error or self.noise or self.latency_s)


class TorqueFeedback(Part):
    """Errors of the torque that the drive reports (6077h)."""

    gain: Positive = Field(1.0, description="reported torque over current times nominal torque constant")
    offset: Finite = Field(0.0, description="N m")
    noise: NotNegative = Field(0.0, description="standard deviation of white noise, N m")
    delay_s: NotNegative = Field(0.0, description="age of the reported torque, s")

    @property
    def is_plain(self) -> bool:
        """True if the reported torque is the true one."""
        return self.gain == 1.0 and not (self.offset or self.noise or self.delay_s)


class Motor(Part):
    """Torque of the simulated servo."""

    rated_torque: Positive = Field(0.64, description="rated torque, N m; 1000 per mille in 6071h, 6077h, 60B2h")
    peak_torque: Positive = Field(1.92, description="largest torque of the power stage, N m")
    torque_lag_s: NotNegative = Field(3e-4, description="time constant between torque demand and torque, s")
    torque_constant_error: Annotated[float, Field(gt=-1.0, le=10.0)] = Field(
        0.0, description="relative error of the torque: the shaft gets (1 + error) times what the drive computes"
    )
    no_load_speed: Positive | None = Field(
        None, description="speed at which the bus voltage leaves no torque, rad/s; no limit by default"
    )
    corner_speed: NotNegative = Field(
        0.0, description="speed up to which there is the peak torque, rad/s; it falls linearly to no_load_speed"
    )
    torque_ripple: Harmonics = Field((), description="relative change of the torque over the position of the motor")
    cogging: Harmonics = Field((), description="torque over the position of the motor, also without current, N m")

    @model_validator(mode="after")
    def _falls(self) -> "Motor":
        if self.no_load_speed is None and self.corner_speed > 0.0:
            raise ValueError("corner_speed needs no_load_speed, the speed at which the torque is zero")
        if self.no_load_speed is not None and self.corner_speed >= self.no_load_speed:
            raise ValueError(f"corner_speed must be below no_load_speed = {self.no_load_speed:g}")
        return self

    @property
    def is_plain(self) -> bool:
        """True for a motor whose torque is the demand, limited and delayed."""
        limits = self.torque_constant_error or self.no_load_speed
        return not (limits or self.torque_ripple or self.cogging)


class Notch(Part):
    """Filter of the torque demand against a resonance."""

    frequency_hz: Positive = Field(description="middle of the notch, Hz")
    width_hz: Positive = Field(description="width at half the power, Hz")
    depth: Annotated[float, Field(ge=0.0, lt=1.0)] = Field(0.0, description="gain in the middle; 0: none passes")


class Loops(Part):
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
    notch: Notch | None = Field(None, description="notch filter of the torque demand")
    torque_filter_hz: Positive | None = Field(
        None, description="corner frequency of a low-pass on the torque demand, Hz; none by default"
    )
    dead_time_s: NotNegative = Field(
        0.0, description="time from sampling the encoder to the torque demand, s; whole samples of the loops"
    )
    has_anti_windup: bool = Field(True, description="false: the integral part grows on while the torque is limited")
    following_error_window: Positive | None = Field(
        None, description="following error, rad, beyond which the drive faults; CANopen: default of 6065h"
    )

    @model_validator(mode="after")
    def _is_sampled(self) -> "Loops":
        half = 0.5 * self.rate_hz
        for name, hz in (
            ("notch.frequency_hz", 0.0 if self.notch is None else self.notch.frequency_hz),
            ("torque_filter_hz", self.torque_filter_hz or 0.0),
        ):
            if hz >= half:
                raise ValueError(f"{name} must be below half of rate_hz, {half:g} Hz, not {hz:g}")
        samples = self.dead_time_s * self.rate_hz
        if abs(samples - round(samples)) > 1e-6 * max(1.0, samples):
            near = max(1, round(samples)) / self.rate_hz
            raise ValueError(
                f"dead_time_s must be whole samples of the loops, e.g. {near:g} s, not {samples:g} of them"
            )
        return self

    @property
    def is_plain(self) -> bool:
        """True for the cascade alone."""
        return self.notch is None and self.torque_filter_hz is None and not self.dead_time_s and self.has_anti_windup


class Winding(Part):
    """Thermal node of the motor's winding."""

    capacity: Positive = Field(description="heat capacity, J/K")
    resistance: Positive = Field(description="thermal resistance to the housing of the motor, K/W")
    loss: NotNegative = Field(description="copper loss at the rated torque and the reference temperature, W")


class Body(Part):
    """Thermal node of a housing."""

    capacity: Positive = Field(description="heat capacity, J/K")
    resistance: Positive = Field(description="thermal resistance to the ambient, K/W")


class AmbientStep(Part):
    """Ambient temperature from a time on."""

    time_s: NotNegative = Field(description="thermal time, s")
    temperature: Finite = Field(description="from then on, deg C")


class Thermal(Part):
    """Heat of motor and gear: lumped nodes of winding, motor and gear. Friction has the temperature of the gear."""

    ambient: Finite = Field(25.0, description="ambient temperature, deg C; all nodes start there")
    ambient_steps: Annotated[tuple[AmbientStep, ...], Field(max_length=8)] = Field(
        (), description="later ambient temperatures"
    )
    reference: Finite = Field(25.0, description="temperature at which loss and torque constant hold, deg C")
    winding: Winding = Field(description="winding of the motor")
    motor: Body = Field(description="housing of the motor")
    gear: Body | None = Field(None, description="gear or bearings, heated by friction; the motor's housing by default")
    contact: Positive | None = Field(
        None, description="thermal resistance between motor and gear, K/W; none by default"
    )
    resistance_coefficient: Finite = Field(3.9e-3, description="relative change of the winding's resistance, 1/K")
    torque_constant_coefficient: Finite = Field(
        0.0, description="relative change of the torque constant with the motor's temperature, 1/K; magnets: -0.001"
    )

    @model_validator(mode="after")
    def _is_possible(self) -> "Thermal":
        if self.contact is not None and self.gear is None:
            raise ValueError("contact is between motor and gear, and gear is missing")
        times = [step.time_s for step in self.ambient_steps]
        if any(after <= before for before, after in pairwise(times)):
            raise ValueError(f"the times of ambient_steps must rise, not {', '.join(f'{time:g}' for time in times)}")
        return self

    @property
    def least_time_constant_s(self) -> float:
        """Lower bound of the shortest time constant, s."""
        to_gear = 0.0 if self.contact is None else 1.0 / self.contact
        rates = [1.0 / (self.winding.resistance * self.winding.capacity)]
        rates.append((1.0 / self.winding.resistance + 1.0 / self.motor.resistance + to_gear) / self.motor.capacity)
        if self.gear is not None:
            rates.append((1.0 / self.gear.resistance + to_gear) / self.gear.capacity)
        return 1.0 / max(rates)


class Wear(Part):
    """Change of friction over a long time."""

    time_s: NotNegative = Field(description="thermal time, s")
    factor: Positive = Field(description="factor of all friction then; linear between the times")
