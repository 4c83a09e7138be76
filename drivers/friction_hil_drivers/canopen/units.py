"""Conversion between a drive's integers and SI units of the axis. Pure functions."""

import math
from dataclasses import dataclass

PER_MILLE = 1000.0
COUNTER_BITS = 32
_RANGE = 1 << COUNTER_BITS
_HALF = _RANGE >> 1
_is_finite = math.isfinite
_ROUNDING = 1e-12  # relative error of the conversions


@dataclass(frozen=True, slots=True)
class CanopenUnits:
    """Scales of one drive; negative ones invert its direction.

    Attributes
    ----------
    counts_per_unit : float
        Position counts per rad (m).
    velocity_per_unit : float
        Increments of 606Ch and 60FFh per rad/s (m/s).
    rated_torque : float
        Torque at 1000 per mille, N m (N).
    command_sign : float
        -1 where a torque that is sent acts in the other direction than the same one that is reported.
    """

    counts_per_unit: float
    velocity_per_unit: float
    rated_torque: float
    command_sign: float = 1.0

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
