"""Units of a simulated drive: encoder counts and per mille of rated torque, against SI. Pure."""

from fractions import Fraction

from friction_hil.servo.servo import Servo
from friction_hil_drivers.canopen.units import wrap

INT16, INT32 = (-0x8000, 0x7FFF), (-(1 << 31), (1 << 31) - 1)


def saturated(value: float, bounds: tuple[int, int]) -> int:
    """Return the nearest integer within ``bounds``."""
    return round(min(max(value, bounds[0]), bounds[1]))


def unwrapped(position: int, near: int) -> int:
    """Return the position without wraps that equals ``position`` modulo 2^32 and is closest to ``near``."""
    return near + wrap(position - near)


class SimulatedUnits:
    """Conversion of one axis.

    A revolution is one turn of a rotary axis and one metre of a linear one. The rated torque is rounded to whole
    mN m (mN), the unit of object 6076h, so that both sides of the bus use the same scale.
    """

    def __init__(self, servo: Servo) -> None:
        config = servo.config
        self.counts = servo.counts_per_unit  # per rad or m
        self.resolution = Fraction(config.encoder.counts).limit_denominator(1000)  # counts a revolution
        self._per_minute = float(self.resolution) / 60.0
        self.rated_torque = max(1, round(1000.0 * config.motor.rated_torque))  # mN m or mN
        self.torque = self.rated_torque * 1e-6  # N m or N per per mille

    def speed(self, revolutions_per_minute: int) -> float:
        """Return the counts per second of a speed in revolutions per minute."""
        return revolutions_per_minute * self._per_minute
