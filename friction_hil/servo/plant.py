"""Inner loop of the simulated servo: drive control, torque lag, mechanics with true friction, encoder."""

import math

import numpy as np

from friction_hil.friction import kernel
from friction_hil.motion.controller import cascade
from friction_hil.numerics.jit import StructuredArray, compiled

_BALANCE = 1e-12  # relative difference of torque and friction below which they balance
BRIDGED_PERIODS = 1.5  # for which a missing target is extrapolated: one that was lost, or comes a period late
OFF, QUICK_STOP, CSP, CSV, CST = 0, 2, 8, 9, 10

PLANT = np.dtype(
    [
        ("inertia", "f8"),
        ("load_torque", "f8"),
        ("friction_kind", "f8"),
        ("is_friction_static", "f8"),
        ("stick_velocity", "f8"),
        ("has_brake", "f8"),
        ("step_s", "f8"),
        ("torque_lag_coefficient", "f8"),  # one-pole coefficient of the torque lag at the integration rate
        ("counts_per_unit", "f8"),
        ("steps_per_control", "f8"),
        ("velocity_filter_coefficient", "f8"),  # one-pole coefficient of the drive's velocity at its loop rate
        ("friction", "f8", (kernel.PLAIN_ROOM,)),
    ]
)

STATE = np.dtype(
    [
        ("position", "f8"),
        ("velocity", "f8"),
        ("torque", "f8"),  # acting on the mechanics, after the torque lag
        ("friction", "f8", (kernel.STATE_ROOM,)),
        ("mode", "f8"),
        ("period_steps", "f8"),
        ("phase", "f8"),  # integration steps since the last set-point
        ("control_phase", "f8"),
        ("target0", "f8"),  # the last three targets, oldest first: control points of the interpolation
        ("target1", "f8"),
        ("target2", "f8"),
        ("velocity_offset", "f8"),
        ("torque_offset", "f8"),
        ("deceleration", "f8"),
        ("torque_limit", "f8"),
        ("position_demand", "f8"),
        ("velocity_demand", "f8"),
        ("torque_demand", "f8"),
        ("counts", "f8"),
        ("velocity_estimate", "f8"),
        ("integral", "f8"),
        ("is_limited", "f8"),
    ]
)


@compiled
def interpolate_position(s: StructuredArray, u: float, period: float) -> tuple[float, float, float]:
    """Evaluate the quadratic B-spline of the last three targets, 1.5 periods behind the newest, smooth in velocity.

    ``u`` is the time since the last set-point, in periods. Missing targets are extrapolated at constant velocity for
    up to `BRIDGED_PERIODS`; after that the demand is constant.

    Returns
    -------
    tuple
        Position, velocity and acceleration.
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


@compiled
def interpolate_velocity(s: StructuredArray, u: float, period: float) -> tuple[float, float]:
    """Interpolate linearly from the last target to the newest over one period, then hold; return v and dv/dt."""
    r = s[0]
    if u <= 1.0:
        return r.target1 + u * (r.target2 - r.target1), (r.target2 - r.target1) / period
    return r.target2, 0.0


@compiled
def control(plant: StructuredArray, controller: StructuredArray, s: StructuredArray) -> None:
    """Compute one sample of the drive's own loops: demands, cascade, torque limit."""
    c, r = plant[0], s[0]
    dt = c.steps_per_control * c.step_s
    counts = math.floor(r.position * c.counts_per_unit)
    measured = (counts - r.counts) / (c.counts_per_unit * dt)
    r.counts = counts
    r.velocity_estimate += c.velocity_filter_coefficient * (measured - r.velocity_estimate)
    position = counts / c.counts_per_unit

    period = r.period_steps * c.step_s
    u = r.phase / r.period_steps
    torque = 0.0
    if r.mode == CSP:
        demand, velocity_demand, acceleration = interpolate_position(s, u, period)
        r.position_demand, r.velocity_demand = demand, velocity_demand + r.velocity_offset
        torque, r.integral = cascade(
            controller,
            r.integral,
            demand - position,
            r.velocity_demand,
            acceleration,
            r.velocity_estimate,
            dt,
            r.torque_limit,
        )
        torque += r.torque_offset
    elif r.mode == CSV:
        velocity_demand, acceleration = interpolate_velocity(s, u, period)
        r.velocity_demand = velocity_demand + r.velocity_offset
        r.position_demand += dt * r.velocity_demand
        torque, r.integral = cascade(
            controller, r.integral, 0.0, r.velocity_demand, acceleration, r.velocity_estimate, dt, r.torque_limit
        )
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
            r.torque_limit,
        )
    else:
        if r.mode == CST:
            torque = r.target2 + r.torque_offset
        r.integral = 0.0
        r.position_demand, r.velocity_demand = position, r.velocity_estimate
    limited = min(max(torque, -r.torque_limit), r.torque_limit)
    r.is_limited = 1.0 if limited != torque else 0.0
    r.torque_demand = limited


@compiled
def advance(plant: StructuredArray, controller: StructuredArray, s: StructuredArray, steps: int) -> None:
    """Integrate over ``steps`` integration steps by the semi-implicit Euler method.

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
