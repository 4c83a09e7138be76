"""Conversion between a drive's integers and SI units of the axis. Pure."""

import math
from dataclasses import dataclass

from friction_hil.drive.encoder import unwrap

PER_MILLE = 1000.0
_I32 = 1 << 32


@dataclass(frozen=True, slots=True)
class CanopenUnits:
    """Scales of one drive; negative ones turn the direction.

    Attributes
    ----------
    counts_per_unit : float
        Position counts per rad (m).
    velocity_per_unit : float
        Increments of 606Ch and 60FFh per rad/s (m/s).
    rated_torque : float
        Torque at 1000 per mille, N m (N).
    """

    counts_per_unit: float
    velocity_per_unit: float
    rated_torque: float

    def position_counts(self, position: float) -> int:
        """Counts of a position, wrapped to 32 bits as drives wrap theirs."""
        return wrap(round(_finite(position * self.counts_per_unit)))

    def velocity_increments(self, velocity: float) -> int:
        """Increments of a velocity, saturated at 32 bits."""
        return _saturate(velocity * self.velocity_per_unit, 32)

    def torque_per_mille(self, torque: float) -> int:
        """Per mille of rated torque, saturated at 16 bits."""
        return _saturate(torque / self.rated_torque * PER_MILLE, 16)

    def torque(self, per_mille: int) -> float:
        """Torque of a per-mille value."""
        return per_mille * self.rated_torque / PER_MILLE


def wrap(counts: int) -> int:
    """The 32-bit signed integer that equals ``counts`` modulo 2^32."""
    return (counts + (_I32 >> 1)) % _I32 - (_I32 >> 1)


def _saturate(value: float, bits: int) -> int:
    bound = (1 << (bits - 1)) - 1
    return max(-bound - 1, min(bound, round(_finite(value))))


def _finite(value: float) -> float:
    if not math.isfinite(value):
        raise ValueError(f"{value} cannot be sent to a drive")
    return value


class Unwrapper:
    """Follows a 32-bit position counter through its wraps."""

    __slots__ = ("_total",)

    def __init__(self) -> None:
        self._total: int | None = None

    def total(self, counts: int) -> int:
        """Counts without wraps, given that fewer than 2^31 passed since the last call."""
        self._total = counts if self._total is None else unwrap(self._total, counts, 32)
        return self._total
