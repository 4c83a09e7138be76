"""One cycle of the compensator, compiled: estimate the motion, run the friction model, apply the gain, limit."""

import math
from typing import Any

from friction_hil.compensator import (
    adaptation,
    bridge,
    limit_cycle,
    load,
    reference,
    temperature,
    transmission,
    velocity,
)
from friction_hil.compensator.limiter import limit_torque
from friction_hil.friction import kernel
from friction_hil.numerics.jit import Array, StructuredArray, compiled, inlined

# what a step finds, by the columns of the recording
RESULTS = ("compensation", "velocity_estimate", "load_estimate", "temperature_estimate", "motor_offset")
WAKING_S = 0.01  # without a demand: fade-in time once the axis begins to move
RESTING_S = 0.3  # without motion: time until the compensation fades out, and fade-out time


@inlined
def _update_velocity(
    c: Any, r: Any, cycle: float, position: float, drive_velocity: float, torque: float, load_torque: float
) -> None:
    """Give fresh feedback to the velocity estimator, with the known torque on the inertia where that is used."""
    net = 0.0
    if c.uses_torque > 0.0 and r.reference.has_demand > 0.0:
        # Without a demand a hand moves the axis with an unknown torque: the known rest would mislead the estimate.
        # The torque is the mean over the cycle that ends here. The friction is that of the reference velocity, which
        # holds while the axis follows its demand. What exceeds the level is viscous: held over a cycle, it must
        # not reverse the axis.
        bound = c.level + 0.5 * c.inertia * abs(r.motion.velocity) / c.period_s
        friction = min(max(r.friction_torque, -bound), bound)
        net = 0.5 * (torque + r.measured_torque) - friction - load.weight(c, position, load_torque)
    velocity.update(c.motion, r.motion, cycle, position, drive_velocity, net)
    r.measured_torque = torque


@inlined
def _restart(
    c: Any, r: Any, cycle: float, position: float, drive_velocity: float, torque: float, demand: float
) -> None:
    """Forget the past: at the first cycle and after a gap too long to bridge."""
    velocity.begin(c.motion, r.motion, cycle, position, drive_velocity)
    r.measured_torque = torque
    r.resting_position = position
    r.resting_s = RESTING_S
    reference.begin(r.reference, r.motion.velocity, demand)
    adaptation.forget(r.adaptation)


@inlined
def _estimate(
    c: Any,
    r: Any,
    cycle: float,
    position: float,
    drive_velocity: float,
    torque: float,
    position_demand: float,
    velocity_demand: float,
    has_demand: bool,
    is_fresh: bool,
    load_torque: float,
) -> float:
    """Take feedback and demand of a cycle; return the time since the last step, s."""
    demand = velocity_demand if math.isfinite(velocity_demand) else 0.0
    elapsed = cycle - r.cycle
    is_gap = is_fresh and cycle - r.motion.position_cycle > velocity.MAX_GAP_CYCLES
    if r.cycle < 0.0 or elapsed <= 0.0 or is_gap:
        elapsed = 1.0
        _restart(c, r, cycle, position, drive_velocity, torque, demand)
    else:
        reference.remember(r.reference, r.motion.velocity, demand, has_demand, elapsed)
        if is_fresh:
            _update_velocity(c, r, cycle, position, drive_velocity, torque, load_torque)
        else:
            velocity.predict(c.motion, r.motion, cycle, 0.0)
    r.cycle = cycle
    reference.see(r.reference, position, position_demand, has_demand, is_fresh)
    return float(elapsed * c.period_s)


@inlined
def _friction(
    c: Any,
    r: Any,
    position: float,
    position_demand: float,
    velocity_demand_ahead: float,
    acceleration: float,
    celsius: float,
    has_demand: bool,
    load_torque: float,
    dt: float,
) -> tuple[float, float, float]:
    """Run the friction model; return its torque, the part that the motor feels, and the velocity of its level."""
    state_velocity, level_velocity = reference.model_velocities(
        c, r.reference, r.motion.velocity, velocity_demand_ahead, dt
    )
    reached = position + c.lead_s * level_velocity  # position at which the torque will act
    r.load_torque = load.transmitted_torque(
        c, reached, position_demand, velocity_demand_ahead, acceleration, load_torque
    )
    friction = kernel.step(
        int(c.kind),
        c.friction,
        r.friction,
        state_velocity,
        level_velocity,
        dt,
        reached,
        r.load_torque,
        celsius,
        0.0,
        c.epsilon_of_demand if has_demand and c.source != reference.MEASURED else c.epsilon,
    )
    r.friction_torque = friction
    felt = friction
    if c.load_share > 0.0:
        felt = transmission.felt_at_motor(c, r.transmission, friction, state_velocity, dt)
    return friction, felt, level_velocity


@inlined
def _standstill_fade(c: Any, r: Any, position: float, keeps_torque: bool, dt: float) -> float:
    """Fade the compensation out while an axis without a demand rests, and in again when it moves; 0 to 1.

    A model's state holds its torque at rest. Where that were more than the axis's friction, it would set off.
    """
    r.resting_s += dt
    if abs(position - r.resting_position) > c.rest:
        r.resting_position = position
        r.resting_s = 0.0
    if keeps_torque or r.resting_s < RESTING_S:
        r.standstill_fade = min(r.standstill_fade + dt / WAKING_S, 1.0)
    else:
        r.standstill_fade = max(r.standstill_fade - dt / RESTING_S, 0.0)
    return float(r.standstill_fade)


@inlined
def _gain(
    c: Any,
    r: Any,
    position: float,
    friction: float,
    level_velocity: float,
    keeps_torque: bool,
    is_enabled: float,
    dt: float,
) -> float:
    """Return the factor on the model's torque: gain, fades, dead band and adaptation."""
    change = dt / c.fade_s
    r.fade = min(r.fade + change, 1.0) if is_enabled > 0.0 else max(r.fade - change, 0.0)
    gain = (c.gain_positive if friction > 0.0 else c.gain_negative) * r.fade * r.limit_cycle.gain_factor
    gain *= _standstill_fade(c, r, position, keeps_torque, dt)
    if c.dead_band > 0.0:
        gain *= min(abs(level_velocity) / c.dead_band, 1.0)
    return float(gain * adaptation.factor(r.adaptation, friction))


@compiled
def whole_step(
    settings: StructuredArray,
    state: StructuredArray,
    cycle: float,
    position: float,
    velocity: float,
    torque: float,
    position_demand: float,
    velocity_demand: float,
    velocity_demand_ahead: float,
    is_fresh: float,
    is_enabled: float,
    acceleration_demand_ahead: float,
    measured_temperature: float,
    load_torque: float,
) -> float:
    """Compute one cycle; see `Compensator.step`."""
    c, r = settings[0], state[0]
    torque = torque / c.torque_ratio
    has_demand = math.isfinite(velocity_demand_ahead)
    keeps_torque = has_demand or c.source == reference.MEASURED
    is_first = r.cycle < 0.0
    if is_first:
        r.standstill_fade = 1.0 if keeps_torque else 0.0
    passed = max(cycle - r.cycle, 0.0)
    celsius = temperature.follow(c, r.temperature, measured_temperature, is_first, c.period_s * passed)
    motor_demand = position_demand
    motor_velocity, motor_velocity_ahead = velocity_demand, velocity_demand_ahead
    if c.offset_acceleration > 0.0:
        offset, elapsed = r.transmission, cycle - r.cycle if r.cycle >= 0.0 else 1.0
        ahead = position_demand + c.lead_s * velocity_demand_ahead
        transmission.follow(
            c, offset, elapsed, ahead, velocity_demand_ahead, acceleration_demand_ahead, has_demand, r.fade
        )
        motor_demand += offset.offset_now
        motor_velocity += offset.velocity_now
        motor_velocity_ahead += offset.velocity_ahead
    dt = _estimate(
        c,
        r,
        cycle,
        position,
        velocity,
        torque,
        motor_demand,
        motor_velocity,
        has_demand,
        is_fresh > 0.0,
        load_torque,
    )
    friction, felt, level_velocity = _friction(
        c,
        r,
        position,
        position_demand,
        motor_velocity_ahead,
        acceleration_demand_ahead,
        celsius,
        has_demand,
        load_torque,
        dt,
    )
    if c.heat_capacity > 0.0:
        temperature.observe(c, r.temperature, friction, level_velocity, torque, dt)
    if c.adaptation_s > 0.0 and is_fresh > 0.0:
        weight = load.weight(c, position, load_torque)
        adaptation.learn(c, r.adaptation, r.motion.velocity, friction, torque, weight, dt)
    wanted = _gain(c, r, position, felt, level_velocity, keeps_torque, is_enabled, dt) * felt
    r.is_faulty = 0.0 if math.isfinite(wanted) else 1.0
    wanted = bridge.cross(c, r.bridge, r.compensation, friction, wanted, dt)
    r.compensation = limit_torque(wanted, r.compensation, c.torque_limit, c.torque_slew * dt)
    limit_cycle.watch(c, r.limit_cycle, r.compensation, motor_velocity_ahead, dt)
    return float(r.compensation)


@compiled
def replay(
    settings: StructuredArray,
    state: StructuredArray,
    cycle: Array,
    position: Array,
    velocity: Array,
    torque: Array,
    position_demand: Array,
    velocity_demand: Array,
    velocity_demand_ahead: Array,
    is_fresh: Array,
    is_enabled: Array,
    acceleration_demand_ahead: Array,
    measured_temperature: Array,
    load_torque: Array,
    results: Array,
) -> None:
    """Run `whole_step` over recorded inputs, each (n,); fills ``results``, (5, n), in the order of `RESULTS`."""
    r = state[0]
    for k in range(cycle.shape[0]):
        results[0, k] = whole_step(
            settings,
            state,
            cycle[k],
            position[k],
            velocity[k],
            torque[k],
            position_demand[k],
            velocity_demand[k],
            velocity_demand_ahead[k],
            is_fresh[k],
            is_enabled[k],
            acceleration_demand_ahead[k],
            measured_temperature[k],
            load_torque[k],
        )
        results[1, k] = r.motion.velocity
        results[2, k] = r.load_torque
        results[3, k] = r.temperature.given
        results[4, k] = r.transmission.offset_now
