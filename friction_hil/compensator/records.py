"""Settings and state of the compensator as flat records of float64, as the compiled step takes them.

Kernels call an element of `SETTINGS` ``c``, and an element of `STATE` ``r``.
"""

from functools import cache

import numpy as np

from friction_hil.compensator import prediction, reference, transmission, velocity
from friction_hil.friction import kernel
from friction_hil.numerics.jit import Array, StructuredArray

STATE = np.dtype(
    [
        ("cycle", "f8"),  # of the last step; negative before the first
        ("motion", velocity.STATE),
        ("measured_torque", "f8"),  # of the last cycle
        ("deviation_square", "f8"),
        ("deviations", "f8", (prediction.ROOM,)),  # measured less demanded velocity, newest first
        ("predictions", "f8", (prediction.ROOM,)),  # made in the same cycles
        ("before_square", "f8"),  # smoothed moments of the deviation `before` a prediction, the one a cycle `earlier`
        ("before_product", "f8"),  # and the one that `came`: before times earlier
        ("earlier_square", "f8"),
        ("before_came", "f8"),
        ("earlier_came", "f8"),
        ("came_square", "f8"),
        ("predicted_miss", "f8"),  # mean square error of the predictions, and of the advanced deviation
        ("advanced_miss", "f8"),
        ("has_demand", "f8"),
        ("error", "f8"),  # demanded less measured position; 0 where unknown
        ("has_error", "f8"),
        ("evidence", "f8"),  # that the axis deviates by more than the rounding of the encoder, 0 to 1
        ("error_square", "f8"),
        ("guided_direction", "f8"),  # of a static map on an axis moved by hand, -1 to 1
        ("guided_velocity", "f8"),
        ("last_velocity", "f8"),
        ("slope", "f8"),  # of the velocity estimate, smoothed
        ("slopes", "f8", (reference.HORIZON,)),  # newest first
        ("velocities", "f8", (reference.HORIZON,)),  # of the same cycles
        ("change_square", "f8"),  # of the predicted change of velocity, smoothed
        ("change_product", "f8"),  # of the predicted and the true change, smoothed
        ("demands", "f8", (reference.HISTORY,)),  # demanded velocity, newest first
        ("friction", "f8", (kernel.STATE_ROOM,)),
        ("friction_torque", "f8"),  # of the model, last cycle
        ("fade", "f8"),
        ("standstill_fade", "f8"),
        ("resting_position", "f8"),
        ("resting_s", "f8"),
        ("alternations", "f8"),
        ("compensation_sign", "f8"),
        ("demanded_sign", "f8"),
        ("gain_factor", "f8"),  # below 1 after `limit_cycle` has seen limit cycles
        ("factor", "f8", (2,)),  # learned by `adaptation`, for positive and negative torque
        ("weight", "f8", (2,)),
        ("product", "f8", (2,)),
        ("filtered_velocity", "f8"),
        ("filtered_torque", "f8"),
        ("filtered_model", "f8"),
        ("sliding_s", "f8"),
        ("sliding_travel", "f8"),  # since then
        ("learned_s", "f8"),  # in which `adaptation` has learned
        ("load_torque", "f8"),  # that the model was given
        ("temperature", "f8"),  # that the model was given, as far as it depends on one
        ("body_temperature", "f8"),  # of the thermal observer
        ("side", "f8"),  # on which the transmission is in contact, -1, 0 or 1
        ("direction", "f8"),  # of the last demanded motion, -1, 0 or 1
        ("offset", "f8"),  # of the position, the newest
        ("offset_velocity", "f8"),
        ("offsets", "f8", (transmission.HISTORY,)),  # newest first
        ("offset_velocities", "f8", (transmission.HISTORY,)),
        ("offset_now", "f8"),  # of the drive's demand now
        ("offset_now_velocity", "f8"),
        ("offset_ahead_velocity", "f8"),  # when this cycle's torque acts
        ("offset_sent", "f8"),  # for the set-point of this cycle
        ("offset_sent_velocity", "f8"),
        ("wound_up", "f8"),  # torque of the load's friction that the coupling transmits to the motor
        ("compensation", "f8"),
        ("bridge_left", "f8"),  # of the difference at a change of settings, 1 to 0; see `bridge`
        ("bridge_directed", "f8"),  # part of that difference which changes sign with the friction
        ("bridge_fixed", "f8"),  # part which does not; in the first cycle, the torque of the former settings
        ("is_faulty", "f8"),  # the model gave a torque that is not finite
    ]
)


@cache
def settings_type(parameter_room: int) -> "np.dtype[np.void]":
    """Return the type of the settings for a friction model with ``parameter_room`` parameter values."""
    return np.dtype(
        [
            ("kind", "f8"),
            ("is_static", "f8"),
            ("friction", "f8", (parameter_room,)),
            ("level", "f8"),
            ("inertia", "f8"),
            ("gravity_constant", "f8"),
            ("gravity_sine", "f8"),
            ("gravity_cosine", "f8"),
            ("torque_ratio", "f8"),  # reported torque over the torque of the model
            ("load_inertia", "f8"),  # whose acceleration the transmission carries; all of it where it is not known
            ("load_friction", "f8"),  # friction level at the load; 0 where it is not known by itself
            ("reference_temperature", "f8"),  # NaN: the model does not depend on temperature
            ("heat_capacity", "f8"),  # of the thermal observer; 0 for none
            ("thermal_resistance", "f8"),
            ("ambient", "f8"),
            ("first_temperature", "f8"),
            ("copper_loss", "f8"),
            ("gap", "f8"),  # whole backlash that is crossed; 0 for none
            ("compliance", "f8"),  # of the transmission, whose twist is taken up; 0: stiff
            ("load_share", "f8"),  # of the friction that reaches the motor through the compliance
            ("offset_acceleration", "f8"),  # 0: there is no offset
            ("offset_velocity", "f8"),
            ("offset_limit", "f8"),
            ("velocity_limit", "f8"),
            ("setpoint_cycles", "f8"),  # until the drive's demand equals the set-point
            ("lead_s", "f8"),
            ("ahead_s", "f8"),  # age of the velocity estimate plus lead_s
            ("ahead_cycles", "f8"),  # the same in cycles, at most `prediction.HORIZON`
            ("judged_cycles", "f8"),  # the same in whole cycles, from 1 to `reference.HORIZON`
            ("ahead_noise_square", "f8"),  # square of the predicted change that encoder noise alone could cause
            ("period_s", "f8"),
            ("resolution", "f8"),
            ("motion", velocity.SETTINGS),
            ("uses_torque", "f8"),  # by the velocity estimator
            ("delay_cycles", "f8"),  # of the velocity estimate
            ("noise", "f8"),  # of the velocity estimate
            ("rest", "f8"),  # distance within which an axis counts as resting
            ("source", "f8"),
            ("epsilon", "f8"),
            ("epsilon_of_demand", "f8"),
            ("gate_square", "f8"),
            ("guided_coefficient", "f8"),  # one-pole coefficient for the velocity of an axis that is moved by hand
            ("gain_positive", "f8"),
            ("gain_negative", "f8"),
            ("dead_band", "f8"),
            ("fade_s", "f8"),
            ("torque_limit", "f8"),
            ("torque_slew", "f8"),
            ("adaptation_s", "f8"),  # 0: off
            ("adaptation_bound", "f8"),
            ("sliding_travel", "f8"),  # before adaptation counts it as sliding
        ]
    )


def begin(settings: StructuredArray, state: StructuredArray, initial_friction: Array) -> None:
    """Set ``state`` to its values before the first cycle."""
    r = state[0]
    r["cycle"] = -1.0
    r["friction"][: initial_friction.size] = initial_friction
    r["gain_factor"] = 1.0
    r["factor"] = 1.0
    r["temperature"] = settings[0]["reference_temperature"]
    r["body_temperature"] = settings[0]["first_temperature"]
    r["weight"] = r["product"] = settings[0]["level"] ** 2
