"""Description of a servo: its control table, read from a YAML file."""

from collections.abc import Iterable, Iterator
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from friction_hil.checked_yaml.messages import Mistake
from friction_hil_drivers.dynamixel.table import Item, ItemBlock, side_by_side
from friction_hil_drivers.serial_line.description import Description, Signal

DESCRIPTIONS = Path(__file__).parent / "descriptions"
_LAST_ADDRESS = 0xFFFF


class DynamixelSignal(Signal):
    """Value of the servo and the item of its control table that holds it."""

    address: Annotated[int, Field(ge=0, le=_LAST_ADDRESS)] = Field(
        description="address of the first, least significant byte"
    )
    size: Literal[1, 2, 4] = Field(description="size in bytes")
    is_signed: bool = Field(True, description="true if the number has a sign (two's complement)")
    limit: Annotated[int, Field(gt=0)] | None = Field(
        None, description="greatest magnitude that the servo accepts; it would refuse a greater one and keep the last"
    )

    simulated: int | None = Field(
        None, description="number that the simulated servo reports; for signals that the driver does not use"
    )

    @property
    def counter_bits(self) -> int | None:
        """Width of the servo's number, an integer that wraps."""
        return 8 * self.size

    @property
    def bounds(self) -> tuple[int, int] | None:
        """Least and greatest number that the servo accepts."""
        count = 1 << 8 * self.size
        low = -count // 2 if self.is_signed else 0
        high = low + count - 1
        return (low, high) if self.limit is None else (max(low, -self.limit), min(high, self.limit))

    @property
    def has_sign(self) -> bool:
        """True if the servo's number can be negative."""
        return self.is_signed


class DynamixelDescription(Description):
    """Servo that speaks Dynamixel Protocol 2.0."""

    protocol: Literal["dynamixel"]
    signals: dict[str, DynamixelSignal]
    fast_sync_read: bool = Field(
        False, description="the firmware has instruction 8Ah: all servos of a line answer in one packet"
    )

    def units(self) -> dict[str, Signal]:
        """Return the signals by name."""
        return dict(self.signals)

    def blocks(self, names: Iterable[str]) -> list[ItemBlock]:
        """Return the fewest blocks of bytes that hold the signals."""
        return side_by_side(map(self._item, dict.fromkeys(names)))

    def _item(self, name: str) -> Item:
        signal = self.signals[name]
        return Item(name, signal.address, signal.size, signal.is_signed, signal.limit)

    def _mistakes(self) -> Iterator[Mistake]:
        yield from super()._mistakes()
        items = sorted(map(self._item, self.signals), key=lambda item: item.address)
        for first, second in pairwise(items):
            if second.address < first.end:
                text = f"{first.name} ({first.size} bytes at {first.address}) reaches into {second.name}"
                yield ("signals", first.name), text
        for item in items:
            if item.end - 1 > _LAST_ADDRESS:
                yield ("signals", item.name), f"{item.name} does not end before address {_LAST_ADDRESS + 1}"
        yield from self._scattered_steps(self.blocks)
