"""Objects of a simulated drive that mirror the servo, and those whose defaults depend on it."""

import math
from collections.abc import Iterable
from fractions import Fraction
from functools import partial

from friction_hil.drive import Mode
from friction_hil.servo.servo import Servo
from friction_hil_drivers.cia402 import objects
from friction_hil_drivers.cia402.simulated.dictionary import Dictionary
from friction_hil_drivers.cia402.simulated.units import INT16, INT32, SimulatedUnits, VelocityUnit, saturated
from friction_hil_drivers.cia402.units import COUNTS_CODE, encode_unit, wrap

_LEAST_RESOLUTION = 2  # counts per revolution
# 6064h counts the encoder, whatever gear, feed and unit a vendor's file has as defaults
_COUNTS_OF_ENCODER = {
    objects.VELOCITY_ENCODER_INCREMENTS: 1,
    objects.VELOCITY_MOTOR_REVOLUTIONS: 1,
    objects.GEAR_MOTOR_REVOLUTIONS: 1,
    objects.GEAR_SHAFT_REVOLUTIONS: 1,
    objects.FEED: 1,
    objects.FEED_SHAFT_REVOLUTIONS: 1,
    objects.VELOCITY_FACTOR_NUMERATOR: 1,
    objects.VELOCITY_FACTOR_DIVISOR: 1,
    objects.POSITION_UNIT: encode_unit(0, COUNTS_CODE),
}


def connect_live_values(dictionary: Dictionary, servo: Servo, units: SimulatedUnits) -> None:
    """Make the entries for demands and actual values read from the servo."""
    counts, torque, speed = units.sign * units.counts, units.sign * units.torque, units.sign * units.increments
    for known, read in (
        (objects.POSITION_ACTUAL, lambda: wrap(round(servo.position * counts))),
        (objects.POSITION_DEMAND, lambda: wrap(round(servo.position_demand * counts))),
        (objects.FOLLOWING_ERROR, lambda: saturated(servo.following_error * counts, INT32)),
        (objects.VELOCITY_ACTUAL, lambda: saturated(servo.velocity * speed, INT32)),
        (objects.VELOCITY_DEMAND, lambda: saturated(servo.velocity_demand * speed, INT32)),
        (objects.TORQUE_ACTUAL, lambda: saturated(servo.torque / torque, INT16)),
        (objects.TORQUE_DEMAND, lambda: saturated(servo.torque_demand / torque, INT16)),
    ):
        dictionary.of(known).connect(read, known)
    load_counts = servo.load_counts_per_unit
    dictionary.of(objects.ADDITIONAL_POSITION).connect(
        lambda: wrap(units.sign * math.floor(servo.load_position * load_counts)), objects.ADDITIONAL_POSITION
    )
    if servo.config.thermal is not None:
        for known, node in (
            (objects.SIMULATED_MOTOR_TEMPERATURE, "motor"),
            (objects.SIMULATED_GEAR_TEMPERATURE, "gear"),
        ):
            dictionary.of(known).connect(partial(_temperature, servo, node), known)


def _temperature(servo: Servo, node: str) -> int:
    return saturated(10.0 * getattr(servo.temperatures, node), INT16)


def set_defaults(
    dictionary: Dictionary, servo: Servo, units: SimulatedUnits, modes: Iterable[Mode], *, are_modes_given: bool
) -> None:
    """Set the entries that describe this motor, as its commissioning would do.

    The quick stop uses half of the rated torque on the inertia, the profile ramp a quarter; the following error
    window is that of the configuration, or a twentieth of a revolution. Values of a vendor's file stay, unless they
    are zero, or in counts of an encoder that it does not tell. ``are_modes_given`` is True if the configuration says
    which modes there are.
    """
    window = servo.config.loops.following_error_window
    motor, inertia = servo.config.motor, servo.total_inertia
    load_resolution = Fraction(servo.config.encoder.counts_at_load).limit_denominator(1000)
    strongest = motor.rated_torque / inertia * units.increments  # velocity units per second
    defaults = {
        objects.RATED_TORQUE: units.rated_torque,
        objects.MAX_TORQUE: round(motor.peak_torque / units.torque),
        objects.VELOCITY_UNIT: units.velocity.code,
        objects.SUPPORTED_MODES: sum(1 << (mode - 1) for mode in modes),
    }
    in_counts = {
        objects.ENCODER_INCREMENTS: units.resolution.numerator,
        objects.MOTOR_REVOLUTIONS: units.resolution.denominator,
        objects.ADDITIONAL_INCREMENTS: load_resolution.numerator,
        objects.ADDITIONAL_REVOLUTIONS: load_resolution.denominator,
        objects.FOLLOWING_ERROR_WINDOW: round(units.resolution / 20 if window is None else window * units.counts),
        objects.PROFILE_DECELERATION: max(1, round(0.25 * strongest)),
        objects.QUICK_STOP_DECELERATION: max(1, round(0.5 * strongest)),
    }
    for known, value in (defaults | in_counts).items():
        is_said = (known is objects.SUPPORTED_MODES and are_modes_given) or (
            known is objects.VELOCITY_UNIT and units.is_velocity_given
        )
        is_said |= known is objects.FOLLOWING_ERROR_WINDOW and window is not None
        stays = dictionary.given(known) and (known in defaults or units.is_resolution_given)
        if is_said or not stays:
            dictionary.set_default(known, value)
    for known, value in _COUNTS_OF_ENCODER.items():
        dictionary.set_default(known, value)


def file_resolution(dictionary: Dictionary) -> Fraction | None:
    """Return the counts of a revolution in a vendor's file (608Fh); None where it tells none that makes sense.

    Many files hold 1/1 in an object that the drive does not use.
    """
    increments, revolutions = dictionary.given(objects.ENCODER_INCREMENTS), dictionary.given(objects.MOTOR_REVOLUTIONS)
    resolution = Fraction(increments, revolutions or 1)
    return resolution if resolution >= _LEAST_RESOLUTION else None


def file_velocity_unit(dictionary: Dictionary) -> VelocityUnit | None:
    """Return the velocity unit of a vendor's file (60A9h); None where it tells none."""
    code = dictionary.given(objects.VELOCITY_UNIT)
    unit = VelocityUnit.decode(code) if code else None
    if code and unit is None:
        dictionary.notes.append(f"60A9h:00: the unit {code:08X}h is not known; velocities are in counts/s")
    return unit
