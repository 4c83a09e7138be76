"""Items of a servo's control table, and blocks of consecutive items. Pure."""

from collections.abc import Iterable
from dataclasses import dataclass, field

from friction_hil_drivers.serial_line.blocks import Limits, integer_limits, merge, representable_numbers


@dataclass(frozen=True, slots=True)
class Item:
    """Item of the control table that holds a signal."""

    name: str
    address: int  # of the first byte, the least significant one
    size: int  # bytes
    is_signed: bool  # two's complement
    limit: int | None = None  # greatest magnitude that the servo accepts
    end: int = field(init=False, compare=False)  # address after the last byte
    # a number is rounded and limited to these; a position wraps in the range of its size, as the servo's counter does
    limits: Limits = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        low = -(1 << 8 * self.size - 1) if self.is_signed else 0
        high = low + (1 << 8 * self.size) - 1
        object.__setattr__(self, "end", self.address + self.size)
        object.__setattr__(self, "limits", integer_limits(self.name, low, high, self.limit))

    def pack(self, number: float) -> bytes:
        """Return the bytes for a number. Raises `ValueError`: the number is not finite."""
        (nearest,) = representable_numbers((self,), {self.name: number})
        return int(nearest).to_bytes(self.size, "little", signed=self.is_signed)

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
