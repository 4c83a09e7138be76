"""Signals of a drive that transmits numbers as text."""

from typing import Literal

from pydantic import Field

from friction_hil_drivers.serial_line.description import Signal


class AsciiSignal(Signal):
    """Value of the drive, and the format of its number."""

    bits: Literal[8, 16, 32, 64] | None = Field(
        None, description="width of an integer (int, hex); numbers are limited to its range, a position wraps"
    )
    is_signed: bool = Field(True, description="true if an integer has a sign")
    digits: int = Field(6, ge=0, le=12, description="digits of a float that are written after the point")
    whole_digits: int = Field(
        6, ge=1, le=12, description="most digits of a float before the point; larger numbers are limited to that"
    )

    @property
    def counter_bits(self) -> int | None:
        """Width of the drive's number if that is an integer, which wraps; else None."""
        return self.bits

    @property
    def bounds(self) -> tuple[int, int] | None:
        """Least and greatest number of the drive if its numbers are integers; else None."""
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
