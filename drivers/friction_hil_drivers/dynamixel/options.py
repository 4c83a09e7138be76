"""Options of the Dynamixel driver: its own keys of an axis."""

from typing import Annotated

from pydantic import Field

from friction_hil_drivers.serial_line.options import LineOptions, SerialOptions


class DynamixelLineOptions(LineOptions):
    """A line of Dynamixel servos."""

    baud: int = Field(
        57_600, ge=9_600, le=4_500_000, description="bits per second; 57600 as delivered, 1000000 makes sense"
    )


class DynamixelOptions(SerialOptions):
    """Options of an axis with ``driver: dynamixel``."""

    line: DynamixelLineOptions
    id: int = Field(ge=0, le=252, description="ID of the servo; 1 as delivered")
    # a shorter time would be rounded to 0, which switches the watchdog off, and 127 times 20 ms are the most it counts
    watchdog_s: Annotated[float, Field(ge=0.02, le=2.54, allow_inf_nan=False)] | None = Field(
        None, description="time without any request after which the servo stops, in steps of 20 ms"
    )

    @property
    def address(self) -> str:
        """Address of this axis on its line."""
        return f"id {self.id}"
