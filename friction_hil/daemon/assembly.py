"""Objects of an axis made from its configuration, in the same way for the loop and for replay."""

import math
from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np

from friction_hil.compensator import Compensator, CompensatorSettings, ThermalObserver
from friction_hil.compensator.velocity_offset import SetpointShift, VelocityOffset
from friction_hil.daemon.safety import SafetyLimits
from friction_hil.drive import AxisFacts
from friction_hil.errors import OptionError
from friction_hil.motion import experiment, multisine
from friction_hil.motion.controller import CONTROLLER
from friction_hil.motion.sequence import Part, sequence_path, strokes_path
from friction_hil.motion.trajectory import Path, Sweep, circle_path, sine_path, still_path, sweeps_path, triangle_path
from friction_hil.numerics.jit import StructuredArray

if TYPE_CHECKING:
    from friction_hil.config import AxisConfig, ExperimentBounds, Multisine
    from friction_hil.config.trajectories import PeriodicMotion
    from friction_hil.models.model_file import ModelFile

_LEAST_RAMP_S = 0.1


def make_compensator(config: "AxisConfig", model: "ModelFile", facts: AxisFacts, period_s: float) -> Compensator:
    """Return the compensator of an axis for one of its models."""
    given, offset = config.compensation, config.compensation.transmission
    # the motor has one offset, that of the axis, also for a shadow model, whose demand would otherwise be another
    mechanics = model.mechanics if offset is None else config.model.mechanics
    gravity, load = mechanics.gravity, mechanics.load
    settings = CompensatorSettings(
        period_s=period_s,
        position_resolution=facts.position_resolution,
        lead_s=lead_s(model, facts, period_s),
        inertia=model.mechanics.inertia,
        torque_ratio=model.mechanics.torque_ratio,
        gravity=(gravity.constant, gravity.sine, gravity.cosine),
        torque_limit=config.limits.torque,
        torque_slew=math.inf if config.limits.torque_slew is None else config.limits.torque_slew,
        gain=given.gain,
        gain_negative=given.gain_negative,
        source=given.source,
        fade_s=given.fade_s,
        velocity=given.velocity,
        smoothing=given.smoothing,
        acceleration=math.nan if given.acceleration is None else given.acceleration,
        max_acceleration=max_acceleration(config, period_s),
        dead_band=given.dead_band,
        adaptation_s=0.0 if given.adaptation is None else given.adaptation.time_s,
        adaptation_bound=0.0 if given.adaptation is None else given.adaptation.bound,
        load_inertia=None if load is None else load.inertia,
        load_friction=None if load is None else load.friction,
        thermal=thermal_observer(model),
        backlash=mechanics.backlash,
        stiffness=math.inf if load is None or load.stiffness is None else load.stiffness,
        offset_acceleration=0.0 if offset is None else offset.acceleration,
        offset_velocity=math.inf if offset is None or offset.velocity is None else offset.velocity,
        offset_limit=largest_offset(config),
        velocity_limit=config.limits.velocity,
        setpoint_delay_s=facts.setpoint_delay_s,
    )
    return Compensator(model.friction_model, settings)


def make_velocity_offset(config: "AxisConfig", facts: AxisFacts, period_s: float) -> VelocityOffset | None:
    """Return what gives the compensation as a velocity offset, None where the drive is given the torque.

    Its limit is a whole number of steps of the drive's velocity. Raises `OptionError`: it is less than one.
    """
    given, step = config.compensation.velocity_offset, facts.velocity_resolution
    if given is None:
        return None
    if config.compensation.is_by_position:
        step = 0.0
    limit = math.floor(given.limit / step * (1.0 + 1e-12)) * step if step > 0.0 else given.limit
    if limit == 0.0:
        text = f"is {given.limit:g}, less than a step of the drive's velocity, {step:.3g}"
        raise OptionError(facts.name, "compensation.velocity_offset.limit", text)
    fade_s = config.compensation.fade_s
    return VelocityOffset(period_s, given.velocity_gain, given.integral_hz, limit, given.slew, fade_s)


def make_setpoint_shift(config: "AxisConfig", period_s: float) -> SetpointShift | None:
    """Return what makes the velocity offset of the position set-point, None where the drive takes the offset itself."""
    given = config.compensation.velocity_offset
    if given is None or given.position_gain is None:
        return None
    return SetpointShift(period_s, given.velocity_gain, given.position_gain, given.velocity_feedforward, given.inertia)


def velocity_offset_shortage(config: "AxisConfig") -> str:
    """Return that the limit of the velocity offset is too small for the model's friction; empty where it is not.

    At a reversal the integral part of the drive's loop holds the torque of one direction and that of the other is due.
    """
    given = config.compensation.velocity_offset
    if given is None:
        return ""
    step = 2.0 * config.compensation.gain * config.model.friction_model.level / given.velocity_gain
    if given.limit >= step:
        return ""
    return (
        f"is {given.limit:g}, and the friction of the model needs up to {step:.3g} at a reversal: the rest comes late"
    )


def largest_offset(config: "AxisConfig") -> float:
    """Return the bound on the offset of the motor, SI: half the gap and the greatest twist; 0 without an offset.

    The twist is that of the load's friction, of gravity in every position, and of the inertia at the acceleration of
    the offset, which is what the drive can follow.
    """
    given, mechanics = config.compensation.transmission, config.model.mechanics
    if given is None or mechanics.load is None:
        return 0.0
    load, gravity = mechanics.load, mechanics.gravity
    weight = abs(gravity.constant) + math.hypot(gravity.sine, gravity.cosine)
    carried = weight + (load.friction or 0.0) + load.inertia * given.acceleration
    return 0.5 * mechanics.backlash + (0.0 if load.stiffness is None else carried / load.stiffness)


def thermal_observer(model: "ModelFile") -> ThermalObserver | None:
    """Return the thermal observer of a model file, None if it has none."""
    given = model.thermal
    if given is None:
        return None
    initial = given.ambient if given.initial is None else given.initial
    return ThermalObserver(given.capacity, given.resistance, given.ambient, initial, given.copper_loss)


def max_acceleration(config: "AxisConfig", period_s: float) -> float:
    """Return the acceleration above which a position is rejected as a glitch, SI.

    By default ``limits.velocity / period_s``: no axis gets from rest to its velocity limit within a period.
    """
    given = config.compensation.max_acceleration
    return config.limits.velocity / period_s if given is None else given


def make_shadows(config: "AxisConfig", facts: AxisFacts, period_s: float) -> dict[str, Compensator]:
    """Return the compensators of the shadow models, by name."""
    return {shadow.name: make_compensator(config, shadow.model, facts, period_s) for shadow in config.shadows}


def lead_s(model: "ModelFile", facts: AxisFacts, period_s: float) -> float:
    """Return the time from sampling the position to the middle of the period in which the torque acts, s.

    The driver reports it; ``delay_s`` of the model file, to the beginning of the torque, takes precedence.
    """
    delay = model.mechanics.delay_s
    return (delay + 0.5 * period_s if delay > 0.0 else facts.actuation_delay_s) + model.mechanics.torque_lag_s


def ramp_s(axes: "Iterable[AxisConfig]") -> float:
    """Return the time in which all axes together start and stop, s: the longest of theirs."""
    return max([_LEAST_RAMP_S, *(getattr(axis.trajectory, "ramp_s", _LEAST_RAMP_S) for axis in axes)])


def make_path(config: "AxisConfig", position_resolution: float, period_s: float) -> Path:
    """Return the path of the configured trajectory; an experiment begins with a few counts of the encoder.

    Raises `UsageError`: the encoder is too coarse for an experiment, or the bounds of a multisine leave no room for it.
    """
    motion = config.trajectory
    if motion.kind == "experiment":
        return sweeps_path(experiment_sweeps(motion, position_resolution, period_s))
    if motion.kind == "multisine":
        plan = multisine_plan(motion, period_s)
        return sequence_path([Part(multisine.multisine_path(plan), plan.duration_s, motion.ramp_s, 0.0)])
    if motion.kind == "sequence":
        return sequence_path(
            [Part(periodic_path(part.motion), part.length_s, part.ramp_s, part.rest_s) for part in motion.motions]
        )
    if motion.kind == "hold" or motion.kind == "none" or motion.kind == "master":
        return still_path
    return periodic_path(motion)


def periodic_path(motion: "PeriodicMotion") -> Path:
    """Return the path of a motion that repeats."""
    if motion.kind == "circle":
        return circle_path(motion.radius, motion.frequency, motion.phase)
    if motion.kind == "sine":
        return sine_path(motion.amplitude, motion.frequency, motion.phase)
    if motion.kind == "triangle":
        return triangle_path(motion.amplitude, motion.frequency, motion.rounding)
    return strokes_path(motion.stroke, motion.frequency, motion.rest)


def multisine_plan(motion: "Multisine", period_s: float) -> multisine.MultisinePlan:
    """Return strokes and multisine within the bounds of a configuration; a `UsageError`: they leave no room."""
    return multisine.plan(
        motion.velocity,
        motion.travel,
        period_s=period_s,
        high_hz=motion.high_hz,
        acceleration=motion.acceleration,
        duration_s=motion.duration_s,
    )


def experiment_sweeps(motion: "ExperimentBounds", position_resolution: float, period_s: float) -> tuple[Sweep, ...]:
    """Return the sweeps of an experiment within these bounds; a `UsageError`: the encoder is too coarse."""
    return experiment.plan(
        motion.velocity,
        motion.travel,
        position_resolution,
        motion.duration_s,
        acceleration=math.inf if motion.acceleration is None else motion.acceleration,
        period_s=period_s,
    )


def experiment_note(config: "AxisConfig", position_resolution: float, period_s: float) -> str:
    """Return what the experiment of an axis cannot show with its encoder; empty for another trajectory, or for nothing.

    Raises `UsageError`: the encoder is too coarse for any experiment.
    """
    motion = config.trajectory
    if motion.kind != "experiment":
        return ""
    sweeps = experiment_sweeps(motion, position_resolution, period_s)
    return experiment.not_shown(sweeps, position_resolution, period_s)


def make_limits(config: "AxisConfig") -> SafetyLimits:
    """Return the limits of an axis; infinity where the configuration has none."""
    limits = config.limits
    low, high = limits.position or (-math.inf, math.inf)
    return SafetyLimits(
        torque=limits.torque,
        velocity=limits.velocity,
        torque_slew=math.inf if limits.torque_slew is None else limits.torque_slew,
        following_error=math.inf if limits.following_error is None else limits.following_error,
        position_low=low,
        position_high=high,
    )


def make_controller(config: "AxisConfig", *, is_of_arm: bool = False) -> StructuredArray:
    """Return the gains of the loop's own controller, all zero where the configuration has none.

    ``is_of_arm``: the inertia is fed forward as that of the arm, and must not be twice.
    """
    record = np.zeros(1, CONTROLLER)
    given = config.controller
    if given is not None:
        record[0]["position_gain"] = given.position_gain
        record[0]["velocity_gain"] = given.velocity_gain
        record[0]["integral_hz"] = given.integral_hz
        record[0]["velocity_feedforward"] = 1.0
        record[0]["inertia"] = 0.0 if is_of_arm else config.model.mechanics.inertia
    return record
