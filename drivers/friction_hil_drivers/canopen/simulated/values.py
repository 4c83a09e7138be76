"""Objects of a simulated drive that mirror the servo, and those whose defaults depend on it."""

from collections.abc import Iterable

from friction_hil.drive import Mode
from friction_hil.servo.servo import Servo
from friction_hil_drivers.canopen import objects
from friction_hil_drivers.canopen.si_units import COUNTS_CODE, encode_unit
from friction_hil_drivers.canopen.simulated.dictionary import Dictionary
from friction_hil_drivers.canopen.simulated.units import INT16, INT32, SimulatedUnits, saturated
from friction_hil_drivers.canopen.units import wrap


def connect_live_values(dictionary: Dictionary, servo: Servo, units: SimulatedUnits) -> None:
    """Make the entries for demands and actual values read from the servo."""
    counts, torque, speed = units.sign * units.counts, units.sign * units.torque, units.sign * units.increments
    dictionary.of(objects.POSITION_ACTUAL).on_read = lambda: wrap(round(servo.position * counts))
    dictionary.of(objects.POSITION_DEMAND).on_read = lambda: wrap(round(servo.position_demand * counts))
    dictionary.of(objects.FOLLOWING_ERROR).on_read = lambda: saturated(servo.following_error * counts, INT32)
    dictionary.of(objects.VELOCITY_ACTUAL).on_read = lambda: saturated(servo.velocity * speed, INT32)
    dictionary.of(objects.VELOCITY_DEMAND).on_read = lambda: saturated(servo.velocity_demand * speed, INT32)
    dictionary.of(objects.TORQUE_ACTUAL).on_read = lambda: saturated(servo.torque / torque, INT16)
    dictionary.of(objects.TORQUE_DEMAND).on_read = lambda: saturated(servo.torque_demand / torque, INT16)


def set_defaults(dictionary: Dictionary, servo: Servo, units: SimulatedUnits, modes: Iterable[Mode]) -> None:
    """Set the entries that describe this motor, as its commissioning would do.

    The quick stop uses half of the rated torque on the inertia, the profile ramp a quarter; the following
    error window is a twentieth of a revolution.
    """
    motor, inertia = servo.config.motor, servo.config.mechanics.inertia
    strongest = motor.rated_torque / inertia * units.increments  # velocity units per second
    defaults = {
        objects.SUPPORTED_MODES: sum(1 << (mode - 1) for mode in modes),
        objects.RATED_TORQUE: units.rated_torque,
        objects.MAX_TORQUE: round(motor.peak_torque / units.torque),
        objects.ENCODER_INCREMENTS: units.resolution.numerator,
        objects.MOTOR_REVOLUTIONS: units.resolution.denominator,
        objects.FOLLOWING_ERROR_WINDOW: round(units.resolution / 20),
        objects.PROFILE_DECELERATION: max(1, round(0.25 * strongest)),
        objects.QUICK_STOP_DECELERATION: max(1, round(0.5 * strongest)),
        # 6064h counts the encoder, whatever gear, feed and unit a vendor's file has as defaults
        objects.VELOCITY_ENCODER_INCREMENTS: 1,
        objects.VELOCITY_MOTOR_REVOLUTIONS: 1,
        objects.GEAR_MOTOR_REVOLUTIONS: 1,
        objects.GEAR_SHAFT_REVOLUTIONS: 1,
        objects.FEED: 1,
        objects.FEED_SHAFT_REVOLUTIONS: 1,
        objects.VELOCITY_FACTOR_NUMERATOR: 1,
        objects.VELOCITY_FACTOR_DIVISOR: 1,
        objects.POSITION_UNIT: encode_unit(0, COUNTS_CODE),
        objects.VELOCITY_UNIT: units.velocity.code,
    }
    for known, value in defaults.items():
        dictionary.set_default(known, value)
