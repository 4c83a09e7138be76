"""Settings and state of the compensator as records of float64, as the compiled step takes them.

Kernels call an element of the settings ``c``, and an element of `STATE`, or of their own part of it, ``r``.
"""

from functools import cache

import numpy as np

from friction_hil.compensator import adaptation, bridge, limit_cycle, reference, temperature, transmission, velocity
from friction_hil.friction import kernel
from friction_hil.numerics.jit import Array, StructuredArray

# Each part belongs to the module that states its fields; only that module's functions change them. The order is that of
# the states in recordings, which a later version verifies.
STATE = np.dtype(
    [
        ("cycle", "f8"),  # of the last step; negative before the first
        ("motion", velocity.STATE),
        ("measured_torque", "f8"),  # of the last cycle
        ("reference", reference.STATE),
        ("friction", "f8", (kernel.STATE_ROOM,)),
        ("friction_torque", "f8"),  # of the model, last cycle
        ("fade", "f8"),
        ("standstill_fade", "f8"),
        ("resting_position", "f8"),
        ("resting_s", "f8"),
        ("limit_cycle", limit_cycle.STATE),
        ("adaptation", adaptation.STATE),
        ("load_torque", "f8"),  # that the model was given
        ("temperature", temperature.STATE),
        ("transmission", transmission.STATE),
        ("compensation", "f8"),
        ("bridge", bridge.STATE),
        ("is_faulty", "f8"),  # the model gave a torque that is not finite
    ]
)

# Settings that no change touches: the safety of the axis depends on them, or the motion of its set-point
FIXED = (
    ("period_s", "f8"),
    ("resolution", "f8"),
    ("torque_limit", "f8"),
    ("torque_slew", "f8"),
    ("uses_torque", "f8"),  # by the velocity estimator
    ("delay_cycles", "f8"),  # of the velocity estimate
    ("velocity_limit", "f8"),
    ("setpoint_cycles", "f8"),  # until the drive's demand equals the set-point
    ("offset_acceleration", "f8"),  # 0: there is no offset
    ("offset_velocity", "f8"),
    ("offset_limit", "f8"),
)


@cache
def settings_type(parameter_room: int) -> "np.dtype[np.void]":
    """Return the type of the settings for a friction model with ``parameter_room`` parameter values."""
    return np.dtype(
        [
            *FIXED,
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
            ("lead_s", "f8"),
            ("ahead_s", "f8"),  # age of the velocity estimate plus lead_s
            ("ahead_cycles", "f8"),  # the same in cycles, at most `prediction.HORIZON`
            ("judged_cycles", "f8"),  # the same in whole cycles, from 1 to `reference.HORIZON`
            ("ahead_noise_square", "f8"),  # square of the predicted change that encoder noise alone could cause
            ("motion", velocity.SETTINGS),
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
    r["limit_cycle"]["gain_factor"] = 1.0
    adaptation.begin(r["adaptation"], settings[0]["level"])
    r["temperature"]["given"] = settings[0]["reference_temperature"]
    r["temperature"]["body"] = settings[0]["first_temperature"]


def copy(settings: StructuredArray, target: StructuredArray) -> None:
    """Copy settings, (1,), into others with at least as much room for the parameters of a model."""
    room = settings[0]["friction"].size
    for name in settings.dtype.names or ():
        if name != "friction":
            target[0][name] = settings[0][name]
    target[0]["friction"] = 0.0
    target[0]["friction"][:room] = settings[0]["friction"]


def place(path: str) -> int:
    """Return the index of a field, such as ``bridge.left``, in the flat view of a state."""
    at, kind = 0, STATE
    for name in path.split("."):
        assert kind.fields is not None
        kind, begin = kind.fields[name][:2]
        at += begin // 8
    return at
