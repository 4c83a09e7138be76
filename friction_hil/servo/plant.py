"""Inner loop of the simulated servo: drive control, torque lag, mechanics with true friction, encoder."""

import math
from typing import Any

from friction_hil.friction import kernel
from friction_hil.motion.controller import cascade
from friction_hil.numerics.dual import overloaded
from friction_hil.numerics.jit import StructuredArray, compiled, inlined, inner
from friction_hil.servo import actuator, mechanics, sensors
from friction_hil.servo.records import MACHINE, has_parts

__all__ = [
    "BRIDGED_PERIODS",
    "CSP",
    "CST",
    "CSV",
    "OFF",
    "QUICK_STOP",
    "advance",
    "control",
    "driven",
    "is_braked",
    "load_position",
    "measured_position",
    "measured_torque",
]

_BALANCE = 1e-12  # relative difference of torque and friction below which they balance
BRIDGED_PERIODS = 1.5  # for which a missing target is extrapolated: one that was lost, or comes a period late
OFF, QUICK_STOP, CSP, CSV, CST = 0, 2, 8, 9, 10


@inner
def interpolate_position(s: StructuredArray, u: float, period: float) -> tuple[float, float, float]:
    """Evaluate the quadratic B-spline of the last three targets, 1.5 periods behind the newest, smooth in velocity.

    ``u`` is the time since the last set-point, in periods. Missing targets are extrapolated at constant velocity for up
    to `BRIDGED_PERIODS`; after that the demand is constant. Returns position, velocity and acceleration.
    """
    r = s[0]
    bend = r.target0 - 2.0 * r.target1 + r.target2
    if u <= 1.0:
        position = 0.5 * (r.target0 + r.target1) + u * (r.target1 - r.target0) + 0.5 * u * u * bend
        return position, (r.target1 - r.target0 + u * bend) / period, bend / (period * period)
    velocity = (r.target2 - r.target1) / period
    bridged = min(u - 1.0, BRIDGED_PERIODS)
    position = 0.5 * (r.target1 + r.target2) + bridged * (r.target2 - r.target1)
    return position, velocity if bridged < BRIDGED_PERIODS else 0.0, 0.0


@inner
def interpolate_velocity(s: StructuredArray, u: float, period: float) -> tuple[float, float]:
    """Interpolate linearly from the last target to the newest over one period, then hold; return v and dv/dt."""
    r = s[0]
    if u <= 1.0:
        return r.target1 + u * (r.target2 - r.target1), (r.target2 - r.target1) / period
    return r.target2, 0.0


@inner
def _read_encoder(plant: StructuredArray, s: StructuredArray, dt: float) -> float:
    c, r = plant[0], s[0]
    counts = math.floor(r.position * c.counts_per_unit)
    measured = (counts - r.counts) / (c.counts_per_unit * dt)
    r.counts = counts
    r.velocity_estimate += c.velocity_filter_coefficient * (measured - r.velocity_estimate)
    return counts / c.counts_per_unit


def _encoder_position(plant: StructuredArray, s: StructuredArray, dt: float) -> float:
    """Sample the encoders, estimate the velocity, and return the position for the drive's loops."""
    raise NotImplementedError  # exists in compiled code only


@overloaded(_encoder_position)
def _choose_encoder(plant: Any, s: Any, dt: Any) -> Any:
    chosen = sensors.read_encoders if has_parts(plant) else _read_encoder
    return lambda plant, s, dt: chosen(plant, s, dt)


@compiled
def _position_of_motor(plant: StructuredArray, s: StructuredArray) -> float:
    return math.floor(s[0].position * plant[0].counts_per_unit) / plant[0].counts_per_unit


@compiled
def _position_of_encoder(plant: StructuredArray, s: StructuredArray) -> float:
    return sensors.position_counts(plant, s) / plant[0].load_counts_per_unit


def measured_position(plant: StructuredArray, s: StructuredArray) -> float:
    """Return the position that the drive reports now, in whole counts, rad or m."""
    return (_position_of_encoder if _is_machine(plant) else _position_of_motor)(plant, s)


@overloaded(measured_position)
def _choose_position(plant: Any, s: Any) -> Any:
    chosen = _position_of_encoder if has_parts(plant) else _position_of_motor
    return lambda plant, s: chosen(plant, s)


def load_position(s: StructuredArray) -> float:
    """Return the true position of the load, rad or m; that of the motor on a rigid servo."""
    raise NotImplementedError  # exists in compiled code only


@overloaded(load_position)
def _choose_load(s: Any) -> Any:
    if has_parts(s):
        return lambda s: s[0].load_position
    return lambda s: s[0].position


@compiled
def _plain_torque(plant: StructuredArray, s: StructuredArray) -> float:
    return s[0].torque


def measured_torque(plant: StructuredArray, s: StructuredArray) -> float:
    """Return the torque that the drive reports now, N m or N."""
    return (sensors.reported_torque if _is_machine(plant) else _plain_torque)(plant, s)


@overloaded(measured_torque)
def _choose_torque(plant: Any, s: Any) -> Any:
    chosen = sensors.reported_torque if has_parts(plant) else _plain_torque
    return lambda plant, s: chosen(plant, s)


def _integral_bound(plant: StructuredArray, s: StructuredArray) -> float:
    """Return the torque up to which the integral part of the velocity loop grows, N m."""
    raise NotImplementedError  # exists in compiled code only


@overloaded(_integral_bound)
def _choose_bound(plant: Any, s: Any) -> Any:
    if has_parts(plant):
        return lambda plant, s: s[0].torque_limit if plant[0].has_anti_windup > 0.0 else math.inf
    return lambda plant, s: s[0].torque_limit


@inner
def _shape(plant: StructuredArray, s: StructuredArray, torque: float) -> float:
    return 0.0 if s[0].mode == OFF else actuator.shape(plant, s, torque)


def _shaped(plant: StructuredArray, s: StructuredArray, torque: float) -> float:
    """Return the torque demand after the filters of the drive, N m."""
    raise NotImplementedError  # exists in compiled code only


@overloaded(_shaped)
def _choose_shape(plant: Any, s: Any, torque: Any) -> Any:
    if has_parts(plant):
        return lambda plant, s, torque: _shape(plant, s, torque)
    return lambda plant, s, torque: torque


def _is_machine(plant: StructuredArray) -> bool:
    return plant.dtype == MACHINE


@inner
def control(plant: StructuredArray, controller: StructuredArray, s: StructuredArray) -> None:
    """Compute one sample of the drive's own loops: demands, cascade, torque limit."""
    c, r = plant[0], s[0]
    dt = c.steps_per_control * c.step_s
    position = _encoder_position(plant, s, dt)

    bound = _integral_bound(plant, s)
    period = r.period_steps * c.step_s
    u = r.phase / r.period_steps
    torque = 0.0
    if r.mode == CSP:
        demand, velocity_demand, acceleration = interpolate_position(s, u, period)
        r.position_demand, r.velocity_demand = demand, velocity_demand
        torque, r.integral = cascade(
            controller,
            r.integral,
            demand - position,
            velocity_demand,
            acceleration,
            r.velocity_estimate - r.velocity_offset,  # whole, whatever the gain of the feed-forward of the velocity
            dt,
            bound,
        )
        torque += r.torque_offset
    elif r.mode == CSV:
        velocity_demand, acceleration = interpolate_velocity(s, u, period)
        r.velocity_demand = velocity_demand + r.velocity_offset
        r.position_demand += dt * r.velocity_demand
        # the target is no feed-forward here: the part of it that the gain leaves out comes back
        target = (1.0 - controller[0].velocity_feedforward) * r.velocity_demand
        velocity = r.velocity_estimate - target
        torque, r.integral = cascade(controller, r.integral, 0.0, r.velocity_demand, acceleration, velocity, dt, bound)
        torque += r.torque_offset
    elif r.mode == QUICK_STOP:
        change = r.deceleration * dt
        r.velocity_demand -= min(max(r.velocity_demand, -change), change)
        r.position_demand += dt * r.velocity_demand
        torque, r.integral = cascade(
            controller,
            r.integral,
            r.position_demand - position,
            r.velocity_demand,
            0.0,
            r.velocity_estimate,
            dt,
            bound,
        )
    else:
        if r.mode == CST:
            torque = r.target2 + r.torque_offset
        r.integral = 0.0
        r.position_demand, r.velocity_demand = position, r.velocity_estimate
    torque = _shaped(plant, s, torque)
    limited = min(max(torque, -r.torque_limit), r.torque_limit)
    r.is_limited = 1.0 if limited != torque else 0.0
    r.torque_demand = limited


@compiled
def _advance_rigid(plant: StructuredArray, controller: StructuredArray, s: StructuredArray, steps: int) -> None:
    """Integrate a rigid servo over ``steps`` integration steps by the semi-implicit Euler method.

    A static friction map stops the axis when its velocity would change sign, and holds it up to the break-away
    level. A dynamic model has its own presliding.
    """
    c, r = plant[0], s[0]
    kind = int(c.friction_kind)
    gain = c.step_s / c.inertia
    for _ in range(steps):
        if r.control_phase <= 0.0:
            control(plant, controller, s)
            r.control_phase = c.steps_per_control
        r.control_phase -= 1.0
        r.phase += 1.0
        r.torque += c.torque_lag_coefficient * (r.torque_demand - r.torque)
        if r.mode == OFF and c.has_brake > 0.0:
            r.velocity = 0.0
            continue
        drive = r.torque - c.load_torque
        friction = kernel.step(
            kind,
            c.friction,
            r.friction,
            r.velocity,
            r.velocity,
            c.step_s,
            r.position,
            c.load_torque,
            math.nan,
            drive,
            0.0,
        )
        velocity = r.velocity + gain * (drive - friction)
        if c.is_friction_static > 0.0:
            is_balanced = abs(drive - friction) <= _BALANCE * abs(drive)
            if velocity * r.velocity < 0.0 or (is_balanced and abs(r.velocity) <= c.stick_velocity):
                velocity = 0.0
        r.velocity = velocity
        r.position += c.step_s * velocity


@inlined
def driven(plant: StructuredArray, controller: StructuredArray, s: StructuredArray) -> float:
    """Advance drive and motor of a servo with further parts by one step; return the torque at the shaft, N m."""
    c, r = plant[0], s[0]
    if r.control_phase <= 0.0:
        control(plant, controller, s)
        actuator.pass_on(plant, s, r.mode == OFF)
        if c.is_aging > 0.0:
            actuator.warm(plant, s, c.steps_per_control * c.step_s)
        r.control_phase = c.steps_per_control
    r.control_phase -= 1.0
    r.phase += 1.0
    return actuator.shaft_torque(plant, s, r.acting_demand)


@inlined
def is_braked(plant: StructuredArray, s: StructuredArray) -> bool:
    """Return True while the brake holds the motor."""
    return s[0].mode == OFF and plant[0].has_brake > 0.0


@compiled
def _advance_machine(plant: StructuredArray, controller: StructuredArray, s: StructuredArray, steps: int) -> None:
    """Integrate a servo with further parts; see `friction_hil.servo.mechanics`."""
    for _ in range(steps):
        torque = driven(plant, controller, s)
        mechanics.move(plant, s, torque, is_braked(plant, s))


def advance(plant: StructuredArray, controller: StructuredArray, s: StructuredArray, steps: int) -> None:
    """Simulate ``steps`` integration steps.

    Records of length 1: `PLANT`, `CONTROLLER` and `STATE`, or `MACHINE`, `CONTROLLER` and `MACHINE_STATE`.
    """
    (_advance_machine if _is_machine(plant) else _advance_rigid)(plant, controller, s, steps)


@overloaded(advance)
def _choose_advance(plant: Any, controller: Any, s: Any, steps: Any) -> Any:
    chosen = _advance_machine if has_parts(plant) else _advance_rigid
    return lambda plant, controller, s, steps: chosen(plant, controller, s, steps)
