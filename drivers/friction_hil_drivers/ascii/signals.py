"""Signals of a drive whose numbers are text."""

from typing import Literal

from pydantic import Field

from friction_hil_drivers.serial_line.description import Signal


class AsciiSignal(Signal):
    """A value of the drive, and the format of its number."""

    bits: Literal[8, 16, 32, 64] | None = Field(
        None, description="width of an integer (int, hex): bounds it; a position wraps there"
    )
    is_signed: bool = Field(True, description="of an integer")
    digits: int = Field(6, ge=0, le=12, description="of a float: digits after the point that are written")
    whole_digits: int = Field(
        6, ge=1, le=12, description="of a float: digits before the point at most; larger numbers are not written"
    )

    @property
    def counter_bits(self) -> int | None:
        """Width of the drive's number where that is an integer that wraps."""
        return self.bits

    @property
    def bounds(self) -> tuple[int, int] | None:
        """Least and greatest of the drive's numbers, where these are integers."""
        if self.bits is None:
            return None
        half = 1 << self.bits - 1
        return (-half, half - 1) if self.is_signed else (0, 2 * half - 1)

    @property
    def has_sign(self) -> bool:
        """True if the drive's number can be negative."""
        return self.bits is None or self.is_signed

    @property
    def step(self) -> float:
        """Smallest step of the drive's number."""
        return self.resolution or (1.0 if self.bits is not None else 10.0**-self.digits)
