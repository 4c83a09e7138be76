"""One cycle of the compensator: one compiled step over one flat state record, the same in the loop and in replay."""

import math
from functools import cache
from typing import Any

import numpy as np

from friction_hil.compensator import adaptation, intent, limit_cycle
from friction_hil.compensator import velocity as motion
from friction_hil.friction import kernel
from friction_hil.numerics.jit import Array, StructuredArray, compiled

WAKING_S = 0.01  # without a demand: time in which the compensation comes when the axis begins to move
RESTING_S = 0.3  # without motion it rests, and in as much time again the compensation goes

STATE = np.dtype(
    [
        ("cycle", "f8"),  # of the last step; negative before the first
        ("motion", motion.STATE),
        ("measured_torque", "f8"),  # of the last cycle
        ("deviation_square", "f8"),
        ("has_demand", "f8"),
        ("error", "f8"),  # demanded less measured position; 0 where unknown
        ("error_square", "f8"),
        ("play", "f8"),  # direction of a static map guided by hand, -1 to 1
        ("guided_velocity", "f8"),
        ("last_velocity", "f8"),
        ("slope", "f8"),  # of the velocity estimate, smoothed
        ("slopes", "f8", (intent.HORIZON,)),  # newest first
        ("velocities", "f8", (intent.HORIZON,)),  # of the same cycles
        ("change_square", "f8"),  # of the predicted change, smoothed
        ("change_product", "f8"),  # of the predicted one and the true one
        ("demands", "f8", (intent.HISTORY,)),  # newest first
        ("friction", "f8", (kernel.STATE_ROOM,)),
        ("friction_torque", "f8"),  # of the model, last cycle
        ("fade", "f8"),
        ("awake", "f8"),
        ("resting_position", "f8"),
        ("resting_s", "f8"),
        ("alternations", "f8"),
        ("compensation_sign", "f8"),
        ("demanded_sign", "f8"),
        ("reduction", "f8"),  # of the gain, by what `limit_cycle` saw
        ("factor", "f8", (2,)),  # learned by `adaptation`, for positive and negative torque
        ("weight", "f8", (2,)),
        ("product", "f8", (2,)),
        ("filtered_velocity", "f8"),
        ("filtered_torque", "f8"),
        ("filtered_model", "f8"),
        ("sliding_s", "f8"),
        ("compensation", "f8"),
        ("is_faulty", "f8"),  # the model gave a torque that is not finite
    ]
)


@cache
def settings_type(room: int) -> "np.dtype[np.void]":
    """Type of the settings, with the ``room`` that the parameters of the friction model need."""
    return np.dtype(
        [
            ("kind", "f8"),
            ("is_static", "f8"),
            ("friction", "f8", (room,)),
            ("level", "f8"),
            ("inertia", "f8"),
            ("gravity_constant", "f8"),
            ("gravity_sine", "f8"),
            ("gravity_cosine", "f8"),
            ("lead_s", "f8"),
            ("ahead_s", "f8"),  # from the moment to which the velocity estimate belongs to the torque's acting
            ("judged_cycles", "f8"),  # the same in whole cycles, from 1 to `intent.HORIZON`
            ("ahead_noise_square", "f8"),  # of a predicted change of velocity: what the encoder alone could cause
            ("period_s", "f8"),
            ("resolution", "f8"),
            ("motion", motion.SETTINGS),
            ("uses_torque", "f8"),  # whether the velocity estimator does
            ("delay_cycles", "f8"),  # of the velocity estimate
            ("noise", "f8"),  # of the velocity estimate
            ("rest", "f8"),  # positions within which an axis rests
            ("source", "f8"),
            ("epsilon", "f8"),
            ("epsilon_of_demand", "f8"),
            ("gate_square", "f8"),
            ("guided_share", "f8"),  # one-pole coefficient for the velocity of an axis that is moved by hand
            ("gain_positive", "f8"),
            ("gain_negative", "f8"),
            ("dead_band", "f8"),
            ("fade_s", "f8"),
            ("torque_limit", "f8"),
            ("torque_slew", "f8"),
            ("adaptation_s", "f8"),  # 0: off
            ("adaptation_bound", "f8"),
            ("sliding_velocity", "f8"),
        ]
    )


def begin(settings: StructuredArray, state: StructuredArray, initial_friction: Array) -> None:
    """Set a state to what it is before the first cycle."""
    r = state[0]
    r["cycle"] = -1.0
    r["friction"][: initial_friction.size] = initial_friction
    r["reduction"] = 1.0
    r["factor"] = 1.0
    r["weight"] = r["product"] = settings[0]["level"] ** 2


@compiled
def _load_torque(c: Any, position: float) -> float:
    if c.gravity_sine == 0.0 and c.gravity_cosine == 0.0:
        return float(c.gravity_constant)
    return float(c.gravity_constant + c.gravity_sine * math.sin(position) + c.gravity_cosine * math.cos(position))


@compiled
def _follow_motion(c: Any, r: Any, cycle: float, position: float, velocity: float, torque: float) -> None:
    net = 0.0
    if c.uses_torque > 0.0 and r.has_demand > 0.0:
        # without a demand a hand moves the axis, whose torque nobody knows: what is known of the rest would mislead;
        # over the cycle that ends here; the model's friction is that of the intended motion, as long as the axis
        # follows its own. What exceeds the level is viscous: held over a cycle, it may not turn the axis round
        bound = c.level + 0.5 * c.inertia * abs(r.motion.velocity) / c.period_s
        friction = min(max(r.friction_torque, -bound), bound)
        net = 0.5 * (torque + r.measured_torque) - friction - _load_torque(c, position)
    motion.update(c.motion, r.motion, cycle, position, velocity, net)
    r.measured_torque = torque


@compiled
def _wake(c: Any, r: Any, position: float, is_led: bool, dt: float) -> float:
    """Share of the compensation: none, in the end, while an axis rests whose motion nobody demands.

    A model's state holds its torque at rest. Where that were more than the axis's friction, it would set off.
    """
    r.resting_s += dt
    if abs(position - r.resting_position) > c.rest:
        r.resting_position = position
        r.resting_s = 0.0
    if is_led or r.resting_s < RESTING_S:
        r.awake = min(r.awake + dt / WAKING_S, 1.0)
    else:
        r.awake = max(r.awake - dt / RESTING_S, 0.0)
    return float(r.awake)


@compiled
def step(
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
) -> float:
    """One cycle; see `Compensator.step`."""
    c, r = settings[0], state[0]
    demand = velocity_demand if math.isfinite(velocity_demand) else 0.0
    elapsed = cycle - r.cycle
    has_demand = math.isfinite(velocity_demand_ahead)
    is_led = has_demand or c.source == intent.MEASURED
    if r.cycle < 0.0:
        r.awake = 1.0 if is_led else 0.0
    is_gap = is_fresh > 0.0 and cycle - r.motion.position_cycle > motion.MAX_GAP_CYCLES
    if r.cycle < 0.0 or elapsed <= 0.0 or is_gap:
        elapsed = 1.0
        motion.begin(c.motion, r.motion, cycle, position, velocity)
        r.measured_torque = torque
        r.resting_position = position
        r.resting_s = RESTING_S
        r.guided_velocity = r.motion.velocity
        intent.forget(r, demand)
        intent.forget_changes(r)
        adaptation.forget(r)
    else:
        if has_demand and r.has_demand == 0.0:
            intent.forget(r, demand)
        elif r.has_demand > 0.0 and not has_demand:
            intent.forget_changes(r)
        intent.remember(r, demand, elapsed)
        if is_fresh > 0.0:
            _follow_motion(c, r, cycle, position, velocity, torque)
        else:
            motion.predict(c.motion, r.motion, cycle, 0.0)
    r.cycle = cycle
    r.has_demand = 1.0 if has_demand else 0.0
    dt = elapsed * c.period_s

    if is_fresh > 0.0:
        r.error = position_demand - position if math.isfinite(position_demand) else 0.0
    state_velocity, level_velocity = intent.velocities(c, r, velocity_demand_ahead, dt)
    reached = position + c.lead_s * level_velocity  # where the torque will act
    load = _load_torque(c, reached)
    friction = kernel.step(
        int(c.kind),
        c.friction,
        r.friction,
        state_velocity,
        level_velocity,
        dt,
        reached,
        load,
        math.nan,
        0.0,
        c.epsilon_of_demand if has_demand and c.source != intent.MEASURED else c.epsilon,
    )
    r.friction_torque = friction
    if c.adaptation_s > 0.0 and is_fresh > 0.0:
        adaptation.learn(c, r, friction, torque, load, dt)

    change = dt / c.fade_s
    r.fade = min(r.fade + change, 1.0) if is_enabled > 0.0 else max(r.fade - change, 0.0)
    gain = (c.gain_positive if friction > 0.0 else c.gain_negative) * r.fade * r.reduction
    gain *= _wake(c, r, position, is_led, dt)
    if c.dead_band > 0.0:
        gain *= min(abs(level_velocity) / c.dead_band, 1.0)
    wanted = gain * adaptation.factor(r, friction) * friction
    r.is_faulty = 0.0
    if not math.isfinite(wanted):
        r.is_faulty = 1.0
        wanted = 0.0
    wanted = min(max(wanted, -c.torque_limit), c.torque_limit)
    slew = c.torque_slew * dt
    r.compensation = min(max(wanted, r.compensation - slew), r.compensation + slew)
    limit_cycle.watch(c, r, r.compensation, velocity_demand_ahead, dt)
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
    compensation: Array,
    velocity_estimate: Array,
) -> None:
    """Run `step` over recorded inputs, each (n,); fills ``compensation`` and ``velocity_estimate``, (n,)."""
    for k in range(cycle.shape[0]):
        compensation[k] = step(
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
        )
        velocity_estimate[k] = state[0].motion.velocity
