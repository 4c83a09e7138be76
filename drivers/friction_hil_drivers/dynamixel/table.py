"""Items of a servo's control table, and blocks of consecutive items. Pure."""

from collections.abc import Iterable
from dataclasses import dataclass

from friction_hil_drivers.serial_line.blocks import merge, nearest_integer, representable_numbers


@dataclass(frozen=True, slots=True)
class Item:
    """Item of the control table that holds a signal."""

    name: str
    address: int  # of the first byte, the least significant one
    size: int  # bytes
    is_signed: bool  # two's complement
    limit: int | None = None  # greatest magnitude that the servo accepts

    @property
    def end(self) -> int:
        """Address after the last byte."""
        return self.address + self.size

    def representable(self, number: float) -> int:
        """Return the number nearest to ``number`` that the servo accepts.

        The number is rounded, and limited to ``limit`` and to the range of the item's size. A position wraps in that
        range instead, as the servo's counter does. Raises `ValueError`: the number is not finite.
        """
        count = 1 << 8 * self.size
        low = -count // 2 if self.is_signed else 0
        high = low + count - 1
        bounds = (low, high) if self.limit is None else (max(low, -self.limit), min(high, self.limit))
        return nearest_integer(self.name, number, bounds, (low, high))

    def pack(self, number: float) -> bytes:
        """Return the bytes for a number; see `representable`. Raises `ValueError`: the number is not finite."""
        return self.representable(number).to_bytes(self.size, "little", signed=self.is_signed)

    def number(self, data: bytes) -> float:
        """Return the number that the bytes hold."""
        return float(int.from_bytes(data, "little", signed=self.is_signed))


@dataclass(frozen=True, slots=True)
class ItemBlock:
    """Consecutive bytes that one request reads or writes, and the items in them."""

    address: int
    size: int
    items: tuple[Item, ...]

    def pack(self, values: dict[str, float]) -> bytes:
        """Return the bytes for the numbers of the block's signals.

        Raises `ValueError`: a number is not finite; the message names its signal.
        """
        numbers = representable_numbers(self.items, values)
        return b"".join(
            int(number).to_bytes(item.size, "little", signed=item.is_signed)
            for item, number in zip(self.items, numbers, strict=True)
        )

    def __str__(self) -> str:
        return f"{self.size} byte{'s' * (self.size > 1)} at {self.address}"


def side_by_side(items: Iterable[Item]) -> list[ItemBlock]:
    """Cover items with as few blocks as possible, without bytes that belong to no item.

    No gap is read over: a servo refuses access to addresses that it does not define.
    """
    return [ItemBlock(*block) for block in merge(items)]
