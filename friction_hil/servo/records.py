"""Records of the simulated servo: what the kernels read and change.

A rigid servo has the records `PLANT` and `STATE`. One with any further part has `MACHINE` and `MACHINE_STATE`, which
begin with the same fields. Kernels are compiled for the type of the record, so that a rigid servo contains no code of
parts that it does not have. Servos that share a mechanism are `MACHINE` too, with a `MECHANISM` between them.
"""

from typing import Any

import numpy as np

from friction_hil.friction import kernel

MOST_HARMONICS = 8
HARMONICS_ROOM = 1 + 3 * MOST_HARMONICS  # number of harmonics; angle per position, cosine and sine of each
HISTORY_ROOM = 64  # samples of the drive's loops
MOST_TIMES = 8
TIMES_ROOM = 1 + 2 * MOST_TIMES  # number of times; time and value of each

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

MACHINE = np.dtype(
    [
        *PLANT.descr,
        ("load_inertia", "f8"),  # behind the coupling; 0: one mass
        ("stiffness", "f8"),  # of the coupling
        ("damping", "f8"),
        ("gap", "f8"),  # total backlash of the coupling
        ("load_friction_kind", "f8"),  # below 0: none
        ("is_load_friction_static", "f8"),
        ("load_stick_velocity", "f8"),
        ("load_friction", "f8", (kernel.PLAIN_ROOM,)),
        ("gravity_sine", "f8"),
        ("gravity_cosine", "f8"),
        ("spring_stiffness", "f8"),
        ("spring_rest", "f8"),
        ("inertia_variation", "f8", (HARMONICS_ROOM,)),
        ("external_amplitude", "f8"),  # of the sine
        ("external_rad_per_s", "f8"),
        ("external_address", "i8"),  # of (n, 2) numbers: time, torque
        ("external_rows", "i8"),
        ("transmission_error", "f8", (HARMONICS_ROOM,)),
        ("hysteresis_torque", "f8"),
        ("hysteresis_stiffness", "f8"),
        ("is_load_measured", "f8"),  # by the position loop
        ("is_load_velocity_measured", "f8"),  # by the velocity loop
        ("load_counts_per_unit", "f8"),
        ("is_encoder_plain", "f8"),
        ("encoder_latency_s", "f8"),
        ("encoder_noise", "f8"),
        ("encoder_error", "f8", (HARMONICS_ROOM,)),
        ("is_torque_plain", "f8"),
        ("torque_feedback_gain", "f8"),
        ("torque_feedback_offset", "f8"),
        ("torque_noise", "f8"),
        ("torque_delay_s", "f8"),
        ("has_history", "f8"),  # a signal arrives late
        ("seed", "f8"),
        ("is_motor_plain", "f8"),
        ("rated_torque", "f8"),
        ("peak_torque", "f8"),
        ("torque_constant_error", "f8"),
        ("no_load_speed", "f8"),  # 0: no limit
        ("corner_speed", "f8"),
        ("torque_ripple", "f8", (HARMONICS_ROOM,)),
        ("cogging", "f8", (HARMONICS_ROOM,)),
        ("torque_filter_coefficient", "f8"),  # 1: none
        ("notch", "f8", (5,)),  # b0, b1, b2, a1, a2; b0 0: none
        ("dead_samples", "f8"),
        ("has_anti_windup", "f8"),
        ("is_aging", "f8"),  # has heat or wear
        ("has_heat", "f8"),
        ("time_lapse", "f8"),
        ("wear", "f8", (TIMES_ROOM,)),
        ("ambient", "f8", (TIMES_ROOM,)),
        ("reference_temperature", "f8"),
        ("copper_loss", "f8"),  # at the rated torque
        ("winding_capacity", "f8"),
        ("motor_capacity", "f8"),
        ("gear_capacity", "f8"),  # 0: friction heats the motor
        ("winding_conductance", "f8"),
        ("motor_conductance", "f8"),
        ("gear_conductance", "f8"),
        ("contact_conductance", "f8"),
        ("resistance_coefficient", "f8"),
        ("torque_constant_coefficient", "f8"),
    ]
)

MACHINE_STATE = np.dtype(
    [
        *STATE.descr,
        ("load_position", "f8"),
        ("load_velocity", "f8"),
        ("load_friction", "f8", (kernel.STATE_ROOM,)),
        ("velocity_before", "f8"),  # one integration step before
        ("load_velocity_before", "f8"),
        ("hysteresis", "f8"),  # torque of the hysteresis of the gear
        ("steps", "f8"),  # integration steps done
        ("external_row", "i8"),  # of the table, last used
        ("transmitted_torque", "f8"),  # from motor to load
        ("friction_torque", "f8"),
        ("load_friction_torque", "f8"),
        ("shaft_torque", "f8"),  # acting on the motor, with ripple
        ("motor_work", "f8"),  # by the motor torque, J
        ("load_work", "f8"),  # by constant and external load torque
        ("friction_heat", "f8"),  # dissipated at the motor
        ("load_friction_heat", "f8"),
        ("coupling_heat", "f8"),
        ("friction_factor", "f8"),  # wear
        ("friction_temperature", "f8"),  # NaN: the friction's reference
        ("winding_temperature", "f8"),
        ("motor_temperature", "f8"),
        ("gear_temperature", "f8"),
        ("ambient_temperature", "f8"),
        ("heat_before", "f8"),  # J, at the last update of the temperatures
        ("samples", "i8"),  # of the drive's loops
        ("sampled_at", "f8"),  # integration steps at the last sample
        ("head", "i8"),  # of the rings
        ("position_history", "f8", (HISTORY_ROOM,)),
        ("torque_history", "f8", (HISTORY_ROOM,)),
        ("acting_demand", "f8"),  # of torque, after filters and dead time
        ("filtered", "f8"),
        ("notch", "f8", (2,)),
        ("demand_head", "i8"),
        ("demand_history", "f8", (HISTORY_ROOM,)),
    ]
)

FORCES_ROOM = 1 + 4 * MOST_TIMES  # number of times; time and three components of each, reversed
GANTRY, ARM = 0, 1

MECHANISM = np.dtype(
    [
        ("kind", "f8"),
        ("tool_forces", "f8", (FORCES_ROOM,)),
        ("inertia", "f8", (4,)),  # matrix of a gantry, without the motors, row by row
        ("span", "f8"),
        ("yaw_stiffness", "f8"),
        ("yaw_damping", "f8"),
    ]
)

MECHANISM_STATE = np.dtype(
    [
        ("heat", "f8"),  # dissipated by the mechanism, J
        ("tool_work", "f8"),  # by the force at the tool, J
        ("kinetic", "f8"),  # energy of an arm at the beginning of the step, J
        ("kinetic_after", "f8"),  # at its end
    ]
)

JOINT = np.dtype(  # what a step of a mechanism knows of each of its axes
    [
        ("bias", "f8"),  # torque that the mechanism took without that of the change of velocity, in the last step
        ("bias_before", "f8"),  # in the one before
        ("matrix_at", "f8"),  # position for which the inertia matrix was computed
        *((name, "f8") for name in ("drive", "outside", "pull")),  # torques of motor, load and force at the tool
        *((name, "f8") for name in ("push", "friction", "excess")),  # all that move it, what brakes it, and the rest
        ("torque", "f8"),  # that the mechanism takes
        *((name, "f8") for name in ("is_held", "is_free")),  # by friction or brake; not to be held or released any more
        *((name, "f8") for name in ("half", "step")),  # of the change of velocity, and what it is corrected by
        *((name, "f8") for name in ("middle", "mean_velocity", "acceleration", "way")),  # way: half of it
        *((name, "f8") for name in ("end", "end_velocity", "momentum", "rest")),  # rest: 0
    ]
)


def has_parts(records: Any) -> bool:
    """Return True for the numba type of an array of `MACHINE` or `MACHINE_STATE` records."""
    return "load_inertia" in records.dtype.fields or "load_position" in records.dtype.fields
