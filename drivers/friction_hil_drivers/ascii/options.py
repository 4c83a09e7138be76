"""Options of the driver for lines of text: the keys that it adds to an axis."""

from typing import Annotated

from pydantic import BeforeValidator, Field

from friction_hil_drivers.serial_line.options import SerialOptions


def _as_text(value: object) -> object:
    return str(value) if isinstance(value, int) and not isinstance(value, bool) else value


class AsciiOptions(SerialOptions):
    """Options of an axis with ``driver: ascii``."""

    axis: Annotated[str, BeforeValidator(_as_text)] | None = Field(
        None,
        pattern=r"^[!-\[\]^-z|~]{0,16}$",
        description="text for {axis} in the messages of the description; the description's own `axis` when not given",
    )

    @property
    def address(self) -> str:
        """Address of this axis on its line."""
        return f"axis {self.axis}" if self.axis else "the only drive"
