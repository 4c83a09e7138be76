"""Units of a simulated drive: encoder counts and per mille of rated torque, against SI. Pure."""

import math
import struct
from dataclasses import dataclass
from fractions import Fraction

from friction_hil.servo.servo import Servo
from friction_hil_drivers.cia402.units import wrap

INT16, INT32 = (-0x8000, 0x7FFF), (-(1 << 31), (1 << 31) - 1)

_COUNTS = 0xB5
_PER_TURN = {0x01: 1.0, 0x10: 2.0 * math.pi, 0x41: 360.0, 0xB4: 1.0}  # m, rad, degrees, revolutions
_SECONDS = {0x03: 1.0, 0x47: 60.0}
_NAMES = {  # exponent, numerator, denominator
    "counts/s": (0, _COUNTS, 0x03),
    "rpm": (0, 0xB4, 0x47),
    "rev/s": (0, 0xB4, 0x03),
    "rad/s": (0, 0x10, 0x03),
    "deg/s": (0, 0x41, 0x03),
    "m/s": (0, 0x01, 0x03),
    "mm/s": (-3, 0x01, 0x03),
}
_EXPONENTS = {f"{10.0**exponent:g}": exponent for exponent in range(-6, 7)}


def saturated(value: float, bounds: tuple[int, int]) -> int:
    """Return the nearest integer within ``bounds``."""
    return round(min(max(value, bounds[0]), bounds[1]))


def unwrapped(position: int, near: int) -> int:
    """Return the position without wraps that equals ``position`` modulo 2^32 and is closest to ``near``."""
    return near + wrap(position - near)


@dataclass(frozen=True, slots=True)
class VelocityUnit:
    """Unit of 606Bh, 606Ch, 60B1h and 60FFh, by object 60A9h (CiA 402-2 with the codes of CiA 303-2)."""

    exponent: int = 0  # a power of ten
    numerator: int = _COUNTS  # code, e.g. B5h counts; 03h second for the denominator
    denominator: int = 0x03

    @classmethod
    def parse(cls, text: str) -> "VelocityUnit":
        """Return the unit of a text like ``rpm``, ``0.1 rpm`` or ``counts/s``.

        Raises `ValueError`: the text is none of these.
        """
        number, _, name = text.strip().rpartition(" ")
        known = _NAMES.get(name)
        exponent = _EXPONENTS.get(number or "1")
        if known is None or exponent is None:
            raise ValueError(
                f"{text!r} is not a unit of velocity: one of {', '.join(_NAMES)}, or a power of ten and a blank "
                "before it, e.g. '0.1 rpm'"
            )
        return cls(known[0] + exponent, *known[1:])

    @classmethod
    def decode(cls, code: int) -> "VelocityUnit | None":
        """Return the unit of a value of 60A9h, None for one that is not known."""
        exponent, numerator, denominator, _ = struct.unpack(">bBBB", struct.pack(">I", code & 0xFFFFFFFF))
        known = numerator in _PER_TURN | {_COUNTS: 0.0} and denominator in _SECONDS
        return cls(exponent, numerator, denominator) if known else None

    @property
    def code(self) -> int:
        """Value of 60A9h."""
        return int.from_bytes(struct.pack(">bBBB", self.exponent, self.numerator, self.denominator, 0), "big")

    def increments(self, counts: float, revolution: float) -> float:
        """Return the increments of a velocity of 1 rad/s (m/s).

        ``counts``: counts per rad (m). ``revolution``: rad (m) of a revolution.
        """
        numerator = counts if self.numerator == _COUNTS else _PER_TURN[self.numerator] / revolution
        scale = _SECONDS[self.denominator] * 10.0**-self.exponent
        return numerator * scale


class SimulatedUnits:
    """Conversion of one axis.

    A revolution is one turn of a rotary axis and one metre of a linear one. The rated torque is rounded to whole
    mN m (mN), the unit of object 6076h, so that both sides of the bus use the same scale.

    ``servo``: the motor and its encoder. ``resolution``: counts of 6064h for a revolution; those of the encoder when
    not given. ``rated_torque``: torque at 1000 per mille, mN m (mN); the motor's when not given. ``velocity``: counts/s
    when not given. ``is_inverted``: the positive direction on the bus is the servo's negative one.
    """

    def __init__(
        self,
        servo: Servo,
        *,
        resolution: Fraction | None = None,
        rated_torque: int | None = None,
        velocity: VelocityUnit | None = None,
        is_inverted: bool = False,
    ) -> None:
        config = servo.config
        revolution = config.encoder.position_counts / servo.counts_per_unit  # rad or m
        self.is_resolution_given = resolution is not None
        if resolution is None:
            resolution = Fraction(config.encoder.position_counts).limit_denominator(1000)
            self.counts = servo.counts_per_unit  # per rad or m
        else:
            self.counts = float(resolution) / revolution
        self.resolution = resolution  # counts a revolution
        self.is_velocity_given = velocity is not None
        self._per_minute = float(self.resolution) / 60.0
        self.rated_torque = rated_torque or max(1, round(1000.0 * config.motor.rated_torque))  # mN m or mN
        self.torque = self.rated_torque * 1e-6  # N m or N per per mille
        self.velocity = VelocityUnit() if velocity is None else velocity
        self.increments = self.velocity.increments(self.counts, revolution)  # of velocity, per rad/s or m/s
        self.sign = -1 if is_inverted else 1

    def speed(self, revolutions_per_minute: int) -> float:
        """Return the counts per second of a speed in revolutions per minute."""
        return revolutions_per_minute * self._per_minute
