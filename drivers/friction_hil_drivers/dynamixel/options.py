"""Options of the Dynamixel driver: the keys that it adds to an axis."""

from typing import Annotated

from pydantic import Field

from friction_hil_drivers.serial_line.options import LineOptions, SerialOptions


class DynamixelLineOptions(LineOptions):
    """Serial line with Dynamixel servos."""

    baud: int = Field(
        57_600,
        ge=9_600,
        le=4_500_000,
        description="bits per second; servos are delivered with 57600, 1000000 is recommended",
    )


class DynamixelOptions(SerialOptions):
    """Options of an axis with ``driver: dynamixel``."""

    line: DynamixelLineOptions
    id: int = Field(ge=0, le=252, description="ID of the servo; 1 when delivered")
    # the servo counts 1 to 127 steps of 20 ms; a shorter time would be rounded to 0, which switches the watchdog off
    watchdog_s: Annotated[float, Field(ge=0.02, le=2.54, allow_inf_nan=False)] | None = Field(
        None, description="time without any request after which the servo stops, in steps of 20 ms"
    )

    @property
    def address(self) -> str:
        """Address of this axis on its line."""
        return f"id {self.id}"
