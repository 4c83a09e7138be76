"""Options of the Modbus driver: the keys that it adds to an axis."""

from typing import Self

from pydantic import Field, model_validator

from friction_hil_drivers.serial_line.options import SerialOptions

_LAST_UNIT_ON_SERIAL_LINE = 247


class ModbusOptions(SerialOptions):
    """Options of an axis with ``driver: modbus``."""

    unit: int = Field(ge=1, le=255, description="address of the drive: 1 to 247, on TCP also 255 (the device itself)")

    @model_validator(mode="after")
    def _is_an_address(self) -> Self:
        if self.unit > _LAST_UNIT_ON_SERIAL_LINE and not self.line.is_tcp:
            raise ValueError(
                f"unit {self.unit} does not exist on a serial line; addresses are 1 to {_LAST_UNIT_ON_SERIAL_LINE}"
            )
        return self

    @property
    def address(self) -> str:
        """Address of this axis on its line."""
        return f"unit {self.unit}"
