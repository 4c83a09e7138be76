"""Records of a simulated servo from its configuration."""

import math
from collections.abc import Sequence

import numpy as np

from friction_hil.errors import UsageError
from friction_hil.friction import FrictionModel
from friction_hil.motion.controller import CONTROLLER
from friction_hil.numerics.jit import Array, StructuredArray
from friction_hil.servo.config import ServoConfig
from friction_hil.servo.parts import Harmonic
from friction_hil.servo.records import HARMONICS_ROOM, MACHINE, MACHINE_STATE, PLANT, STATE, TIMES_ROOM


def plant_record(config: ServoConfig, external: Array | None = None) -> StructuredArray:
    """Return the `PLANT` record of a rigid servo, or the `MACHINE` record of one with further parts.

    ``external`` is a table from `external_table`, which must live as long as the record.
    """
    return _common_record(config, PLANT) if config.is_rigid else machine_record(config, external)


def machine_record(config: ServoConfig, external: Array | None = None) -> StructuredArray:
    """Return the `MACHINE` record, which can be that of a rigid servo too; see `plant_record`."""
    record = _common_record(config, MACHINE)
    _set_mechanics(record, config, external)
    _set_gear(record, config)
    c, encoder = record[0], config.encoder
    c["is_load_measured"] = encoder.at != "motor"
    c["is_load_velocity_measured"] = encoder.at == "load"
    c["load_counts_per_unit"] = encoder.position_counts / _revolution(config)
    _set_feedback(record, config)
    _set_motor(record, config)
    _set_filters(record, config)
    _set_aging(record, config)
    return record


def servo_state(config: ServoConfig, plant: StructuredArray, position: float) -> StructuredArray:
    """Return the state for a record of `plant_record` or `machine_record`: at rest at ``position``."""
    state = np.zeros(1, STATE if plant.dtype == PLANT else MACHINE_STATE)
    r = state[0]
    r["position"] = r["position_demand"] = position
    r["counts"] = math.floor(position * plant[0]["counts_per_unit"])
    r["torque_limit"] = config.motor.peak_torque
    if plant.dtype == PLANT:
        return state
    r["load_position"] = r["position_history"] = position
    r["friction_factor"] = 1.0
    ambient = math.nan if config.thermal is None else config.thermal.ambient
    for node in ("friction", "winding", "motor", "gear", "ambient"):
        r[f"{node}_temperature"] = ambient
    return state


def _common_record(config: ServoConfig, kind: np.dtype[np.void]) -> StructuredArray:
    step_s = 1.0 / config.integration_hz
    lag = config.motor.torque_lag_s
    record = np.zeros(1, kind)
    c = record[0]
    c["inertia"] = config.mechanics.inertia
    c["load_torque"] = config.mechanics.load_torque
    c["has_brake"] = config.mechanics.has_brake
    _set_friction(record, "", config.friction_model)
    c["step_s"] = step_s
    c["torque_lag_coefficient"] = 1.0 if lag == 0.0 else -math.expm1(-step_s / lag)
    c["counts_per_unit"] = config.encoder.counts / _revolution(config)
    c["steps_per_control"] = round(config.integration_hz / config.loops.rate_hz)
    c["velocity_filter_coefficient"] = -math.expm1(
        -2.0 * math.pi * config.loops.velocity_filter_hz / config.loops.rate_hz
    )
    return record


def _revolution(config: ServoConfig) -> float:
    return 2.0 * math.pi if config.mechanics.axis == "rotary" else 1.0


def controller_record(config: ServoConfig, inertia: float | None = None) -> StructuredArray:
    """Return the `CONTROLLER` record of the drive's loops; ``inertia`` is by default that of motor and load."""
    record = np.zeros(1, CONTROLLER)
    k = record[0]
    k["position_gain"] = config.loops.position_gain
    k["velocity_gain"] = config.loops.velocity_gain
    k["integral_hz"] = config.loops.integral_hz
    k["velocity_feedforward"] = config.loops.velocity_feedforward
    k["inertia"] = config.loops.inertia_feedforward * (config.mechanics.total_inertia if inertia is None else inertia)
    return record


def external_table(config: ServoConfig, content: Array | None) -> Array | None:
    """Return the load torque over time as the kernel takes it, (n, 2), or None.

    ``content``, (n, 2): of ``mechanics.external.file``, if there is one. Raises `UsageError`: it is missing, or no
    table of rising times and finite torques.
    """
    external = config.mechanics.external
    if external is None or external.file is None:
        if external is None or not external.steps:
            return None
        rows, torque = [], 0.0
        for step in external.steps:  # two rows at the same time are a step
            rows += [(step.time_s, torque), (step.time_s, step.torque)]
            torque = step.torque
        return np.array(rows)
    if content is None:
        raise UsageError(f"mechanics.external.file: the content of {external.file} is missing")
    table = np.array(content, dtype=np.float64, order="C")
    if table.ndim != 2 or table.shape[1] != 2 or len(table) == 0:
        raise UsageError(f"{external.file}: two columns, time in s and torque in N m, are needed")
    if not np.isfinite(table).all():
        raise UsageError(f"{external.file}: row {1 + int(np.argmin(np.isfinite(table).all(axis=1)))} is not finite")
    if not (falling := np.diff(table[:, 0]) > 0.0).all():
        raise UsageError(f"{external.file}: the time of row {2 + int(np.argmin(falling))} is not after the one before")
    return table


def _set_friction(record: StructuredArray, prefix: str, friction: FrictionModel) -> None:
    c = record[0]
    c[f"{prefix}friction_kind"] = friction.kind
    c[f"is_{prefix}friction_static"] = friction.family.is_static
    c[f"{prefix}friction"] = friction.values
    c[f"{prefix}stick_velocity"] = friction.parameters.get("stick_velocity", 0.0)


def _set_mechanics(record: StructuredArray, config: ServoConfig, external: Array | None) -> None:
    c, mechanics = record[0], config.mechanics
    load, friction = mechanics.load, config.load_friction_model
    c["load_friction_kind"] = -1.0
    if load is not None:
        c["load_inertia"], c["stiffness"] = load.inertia, load.stiffness
        c["damping"], c["gap"] = load.damping, load.backlash
    if friction is not None:
        _set_friction(record, "load_", friction)
    if mechanics.gravity is not None:
        c["gravity_sine"], c["gravity_cosine"] = mechanics.gravity.sine, mechanics.gravity.cosine
    if mechanics.spring is not None:
        c["spring_stiffness"], c["spring_rest"] = mechanics.spring.stiffness, mechanics.spring.rest
    c["inertia_variation"] = _harmonics(mechanics.inertia_variation, mechanics.axis)
    if mechanics.external is not None and mechanics.external.sine is not None:
        c["external_amplitude"] = mechanics.external.sine.amplitude
        c["external_rad_per_s"] = 2.0 * math.pi * mechanics.external.sine.frequency_hz
    if external is not None:
        c["external_address"], c["external_rows"] = external.ctypes.data, len(external)


def _set_gear(record: StructuredArray, config: ServoConfig) -> None:
    c, gear = record[0], config.gear
    c["transmission_error"] = _harmonics(gear.transmission_error, config.mechanics.axis)
    if gear.hysteresis is not None:
        c["hysteresis_torque"], c["hysteresis_stiffness"] = gear.hysteresis.torque, gear.hysteresis.stiffness


def _harmonics(harmonics: Sequence[Harmonic], axis: str) -> Array:
    """Return harmonics as the kernel takes them: their number; then angle per position, cosine and sine of each."""
    angle_per_position = 1.0 if axis == "rotary" else 2.0 * math.pi
    table = np.zeros(HARMONICS_ROOM)
    table[0] = len(harmonics)
    for i, each in enumerate(harmonics):
        table[1 + 3 * i : 4 + 3 * i] = each.order * angle_per_position, each.cosine, each.sine
    return table


def _times(pairs: Sequence[tuple[float, float]]) -> Array:
    """Return times and values as the kernel takes them: their number, then time and value of each."""
    table = np.zeros(TIMES_ROOM)
    table[0] = len(pairs)
    for i, pair in enumerate(pairs):
        table[1 + 2 * i : 3 + 2 * i] = pair
    return table


def _set_feedback(record: StructuredArray, config: ServoConfig) -> None:
    c, encoder, torque = record[0], config.encoder, config.torque_feedback
    c["is_encoder_plain"] = not (encoder.periodic_error or encoder.noise or encoder.latency_s)
    c["encoder_latency_s"], c["encoder_noise"] = encoder.latency_s, encoder.noise
    c["encoder_error"] = _harmonics(encoder.periodic_error, config.mechanics.axis)
    c["is_torque_plain"] = torque.is_plain
    c["torque_feedback_gain"], c["torque_feedback_offset"] = torque.gain, torque.offset
    c["torque_noise"], c["torque_delay_s"] = torque.noise, torque.delay_s
    c["has_history"] = encoder.latency_s > 0.0 or torque.delay_s > 0.0
    c["seed"] = config.seed


def _set_motor(record: StructuredArray, config: ServoConfig) -> None:
    c, motor, axis = record[0], config.motor, config.mechanics.axis
    coefficient = 0.0 if config.thermal is None else config.thermal.torque_constant_coefficient
    c["is_motor_plain"] = motor.is_plain and coefficient == 0.0
    c["rated_torque"], c["peak_torque"] = motor.rated_torque, motor.peak_torque
    c["torque_constant_error"] = motor.torque_constant_error
    c["no_load_speed"], c["corner_speed"] = motor.no_load_speed or 0.0, motor.corner_speed
    c["torque_ripple"], c["cogging"] = _harmonics(motor.torque_ripple, axis), _harmonics(motor.cogging, axis)


def _set_filters(record: StructuredArray, config: ServoConfig) -> None:
    """Set low-pass and notch of the torque demand; the notch by the bilinear transformation, exact in its middle."""
    c, loops = record[0], config.loops
    c["has_anti_windup"] = loops.has_anti_windup
    c["dead_samples"] = round(loops.dead_time_s * loops.rate_hz)
    corner = loops.torque_filter_hz
    c["torque_filter_coefficient"] = 1.0 if corner is None else -math.expm1(-2.0 * math.pi * corner / loops.rate_hz)
    if loops.notch is None:
        return
    middle = 2.0 * math.pi * loops.notch.frequency_hz / loops.rate_hz
    width = math.tan(math.pi * loops.notch.width_hz / loops.rate_hz)
    scale = 1.0 / (1.0 + width)
    turned = -2.0 * math.cos(middle) * scale
    passed = loops.notch.depth * width
    c["notch"] = (1.0 + passed) * scale, turned, (1.0 - passed) * scale, turned, (1.0 - width) * scale


def _set_aging(record: StructuredArray, config: ServoConfig) -> None:
    c, heat = record[0], config.thermal
    c["is_aging"], c["has_heat"] = heat is not None or bool(config.wear), heat is not None
    c["time_lapse"] = config.time_lapse
    c["wear"] = _times([(each.time_s, each.factor) for each in config.wear])
    if heat is None:
        return
    c["ambient"] = _times([(step.time_s, step.temperature) for step in heat.ambient_steps])
    c["reference_temperature"], c["copper_loss"] = heat.reference, heat.winding.loss
    c["winding_capacity"], c["winding_conductance"] = heat.winding.capacity, 1.0 / heat.winding.resistance
    c["motor_capacity"], c["motor_conductance"] = heat.motor.capacity, 1.0 / heat.motor.resistance
    if heat.gear is not None:
        c["gear_capacity"], c["gear_conductance"] = heat.gear.capacity, 1.0 / heat.gear.resistance
    c["contact_conductance"] = 0.0 if heat.contact is None else 1.0 / heat.contact
    c["resistance_coefficient"] = heat.resistance_coefficient
    c["torque_constant_coefficient"] = heat.torque_constant_coefficient
