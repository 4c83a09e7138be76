"""Units of a drive: its integers as SI units of the axis, objects 60A8h and 60A9h, the key ``velocity_unit``. Pure.

An SI unit object has four bytes, from the highest: prefix (a power of ten, signed), numerator, denominator, reserved
(CiA 402-2, codes of CiA 303-2). Codes as they are used by maxon, Nanotec and Synapticon (B4h, B5h, 47h), by igus and in
HEIG-VD's canopen-stack (01h, 03h): FDB44700h is 0.001 rpm, FD010300h is mm/s.
"""

import math
from dataclasses import dataclass
from enum import Enum
from typing import Literal

Kind = Literal["rotary", "linear"]

PER_MILLE = 1000.0
TOLERANCE = 2e-3  # relative, of two scales that agree; users round counts per rad
LEAST_RESOLUTION = 2.0  # counts per revolution: 1/1 is the default of an object that is not used
COUNTER_BITS = 32
_RANGE = 1 << COUNTER_BITS
_HALF = _RANGE >> 1
_is_finite = math.isfinite
_ROUNDING = 1e-12  # relative error of the conversions


@dataclass(frozen=True, slots=True)
class DriveUnits:
    """Scales of one drive; negative ones invert its direction."""

    counts_per_unit: float  # counts of position per rad (m)
    velocity_per_unit: float  # increments of 606Ch and 60FFh per rad/s (m/s)
    rated_torque: float  # torque at 1000 per mille, N m (N)
    command_sign: float = 1.0  # -1: a torque that is sent acts in the other direction than one that is reported

    def position_counts(self, position: float) -> int:
        """Return the counts of a position, wrapped to 32 bits as drives wrap theirs."""
        counts = position * self.counts_per_unit
        if not _is_finite(counts):
            raise _not_finite(counts)
        return (round(counts) + _HALF) % _RANGE - _HALF

    def velocity_increments(self, velocity: float) -> int:
        """Return the increments of a velocity, saturated at 32 bits."""
        return _saturate(velocity * self.velocity_per_unit, 32)

    def torque_per_mille(self, torque: float) -> int:
        """Return a torque in per mille of rated torque, rounded towards zero and saturated at 16 bits.

        Rounded to the nearest, a torque at its limit would exceed it.
        """
        value = self.command_sign * torque / self.rated_torque * PER_MILLE
        if not _is_finite(value):
            raise _not_finite(value)
        per_mille, nearest = int(value), round(value)
        # 500 per mille and back may come out as 499.9999999999999
        if nearest != per_mille and abs(value - nearest) <= _ROUNDING * abs(value):
            per_mille = nearest
        return per_mille if -0x8000 <= per_mille <= 0x7FFF else _saturate(per_mille, 16)

    def torque(self, per_mille: int) -> float:
        """Return the torque of a per-mille value."""
        return per_mille * self.rated_torque / PER_MILLE


def wrap(counts: int) -> int:
    """Return the 32-bit signed integer that equals ``counts`` modulo 2^32."""
    return (counts + (_RANGE >> 1)) % _RANGE - (_RANGE >> 1)


def _saturate(value: float, bits: int) -> int:
    bound = (1 << (bits - 1)) - 1
    if not _is_finite(value):
        raise _not_finite(value)
    return max(-bound - 1, min(bound, round(value)))


def _not_finite(value: float) -> ValueError:
    return ValueError(f"{value} cannot be sent to a drive")


# SI unit objects


class Measure(Enum):
    """Kind of quantity that a unit measures."""

    COUNTS = "counts"
    ANGLE = "rad"
    LENGTH = "m"


@dataclass(frozen=True, slots=True)
class Unit:
    """A unit of position, or of velocity (then per second)."""

    scale: float  # counts, rad or m (per s) of one increment
    measure: Measure
    text: str  # the unit in words, e.g. ``0.1 rpm``


COUNTS_CODE = 0xB5
_NUMERATORS = {
    0x01: ("m", Measure.LENGTH, 1.0),
    0x10: ("rad", Measure.ANGLE, 1.0),
    0x41: ("deg", Measure.ANGLE, math.pi / 180.0),
    0xB4: ("rev", Measure.ANGLE, 2.0 * math.pi),
    COUNTS_CODE: ("counts", Measure.COUNTS, 1.0),
}
_DENOMINATORS = {0x03: ("s", 1.0), 0x47: ("min", 60.0), 0x48: ("h", 3600.0)}
_NAMES = {
    "rpm": (Measure.ANGLE, 2.0 * math.pi / 60.0),
    **{
        f"{numerator}/{time}": (measure, scale / seconds)
        for numerator, measure, scale in (*_NUMERATORS.values(), ("mm", Measure.LENGTH, 1e-3))
        for time, seconds in _DENOMINATORS.values()
    },
}
VELOCITY_UNITS = tuple(_NAMES)


def decode_position_unit(code: int) -> Unit | None:
    """Decode object 60A8h; None for 0, which says nothing. Raises a `ValueError` for an unknown code."""
    return _decode(code, is_velocity=False)


def decode_velocity_unit(code: int) -> Unit | None:
    """Decode object 60A9h as `decode_position_unit` does 60A8h.

    >>> decode_velocity_unit(0xFFB44700).text
    '0.1 rpm'
    """
    return _decode(code, is_velocity=True)


def _decode(code: int, *, is_velocity: bool) -> Unit | None:
    if not code & 0xFFFFFF00:
        return None
    exponent = int.from_bytes([code >> 24 & 0xFF], "little", signed=True)
    numerator, denominator = _NUMERATORS.get(code >> 16 & 0xFF), _DENOMINATORS.get(code >> 8 & 0xFF)
    if numerator is None or (denominator is None) == is_velocity or (not is_velocity and code >> 8 & 0xFF):
        raise ValueError(f"{code & 0xFFFFFFFF:08X}h is not a unit that is known here")
    name, measure, scale = numerator
    if denominator is not None:
        name, scale = f"{name}/{denominator[0]}", scale / denominator[1]
        name = "rpm" if name == "rev/min" else name
    return Unit(10.0**exponent * scale, measure, name if exponent == 0 else f"{10.0**exponent:g} {name}")


def encode_unit(exponent: int, numerator: int, denominator: int = 0) -> int:
    """Return the value of 60A8h or 60A9h for a power of ten and the codes of numerator and denominator."""
    return (exponent & 0xFF) << 24 | numerator << 16 | denominator << 8


def parse_velocity_unit(text: str) -> Unit:
    """Return the unit of a text like ``0.1 rpm`` or ``counts/s``; a `ValueError` for another one lists the units."""
    number, _, name = text.strip().rpartition(" ")
    try:
        factor = float(number) if number else 1.0
    except ValueError:
        factor = math.nan
    if name not in _NAMES or not 0.0 < factor < math.inf:
        raise ValueError(
            f"{text!r} is not a unit of velocity: a number and a blank, or nothing, before one of "
            f"{', '.join(VELOCITY_UNITS)}; e.g. '0.1 rpm'"
        )
    measure, scale = _NAMES[name]
    return Unit(factor * scale, measure, f"{factor:.6g} {name}" if number else name)
