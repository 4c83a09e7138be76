"""Numbers in a control table, and items side by side. Pure."""

from collections.abc import Iterable
from dataclasses import dataclass

from friction_hil_drivers.serial_line.units import saturated

_CYCLIC = ("position", "position_command")


@dataclass(frozen=True, slots=True)
class Place:
    """Where a signal is found in the control table.

    Attributes
    ----------
    name : str
        Of the signal.
    address : int
        Of its first, lowest byte.
    size : int
        In bytes.
    is_signed : bool
        Negative numbers are two's complements.
    limit : int or None
        Greatest magnitude that the servo takes.
    """

    name: str
    address: int
    size: int
    is_signed: bool
    limit: int | None = None

    @property
    def end(self) -> int:
        """Address after its last byte."""
        return self.address + self.size

    def pack(self, number: float) -> bytes:
        """Bytes for a number.

        It is rounded and kept within the limit and the range of its size; a position wraps in the latter instead, as
        the servo's counter does.

        Raises
        ------
        ValueError
            The number is not finite.
        """
        count = 1 << 8 * self.size
        low = -count // 2 if self.is_signed else 0
        high = low + count - 1
        if self.limit is not None:
            low, high = max(low, -self.limit), min(high, self.limit)
        whole = round(saturated(number, low, high))
        if self.name in _CYCLIC:
            whole = (round(number) - low) % count + low
        return whole.to_bytes(self.size, "little", signed=self.is_signed)

    def number(self, data: bytes) -> float:
        """Number that the bytes hold."""
        return float(int.from_bytes(data, "little", signed=self.is_signed))


@dataclass(frozen=True, slots=True)
class Block:
    """Bytes side by side that one request reads or writes, and the signals in them."""

    address: int
    size: int
    places: tuple[Place, ...]

    def pack(self, values: dict[str, float]) -> bytes:
        """Bytes for the numbers of its signals.

        Raises
        ------
        ValueError
            A number is not finite; the message names its signal.
        """
        parts = []
        for place in self.places:
            try:
                parts.append(place.pack(values[place.name]))
            except ValueError as error:
                raise ValueError(f"{place.name}: {error}") from None
        return b"".join(parts)

    def __str__(self) -> str:
        return f"{self.size} byte{'s' * (self.size > 1)} at {self.address}"


def side_by_side(places: Iterable[Place]) -> list[Block]:
    """Cover signals with as few blocks as there can be without bytes that belong to none of them.

    Nothing is read over: a servo refuses access to addresses that it does not define.
    """
    blocks: list[Block] = []
    for place in sorted(places, key=lambda place: place.address):
        if blocks and blocks[-1].address + blocks[-1].size == place.address:
            last = blocks[-1]
            blocks[-1] = Block(last.address, last.size + place.size, (*last.places, place))
        else:
            blocks.append(Block(place.address, place.size, (place,)))
    return blocks
