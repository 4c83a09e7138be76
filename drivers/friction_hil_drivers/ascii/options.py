"""The keys of an axis on a line of text."""

from typing import Annotated

from pydantic import BeforeValidator, Field

from friction_hil_drivers.serial_line.options import SerialOptions


def _as_text(value: object) -> object:
    return str(value) if isinstance(value, int) and not isinstance(value, bool) else value


class AsciiOptions(SerialOptions):
    """Options of an axis on a line of text."""

    axis: Annotated[str, BeforeValidator(_as_text)] | None = Field(
        None,
        pattern=r"^[!-\[\]^-z|~]{0,16}$",
        description="stands for {axis} in the description, which says what it is when not given",
    )

    @property
    def address(self) -> str:
        """What tells this axis from the others on its line."""
        return f"axis {self.axis}" if self.axis else "the only drive"
