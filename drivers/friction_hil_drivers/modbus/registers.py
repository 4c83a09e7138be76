"""Numbers in registers, and registers side by side. Pure."""

import functools
import operator
import struct
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from friction_hil_drivers.serial_line.units import saturated

Table = Literal["holding", "input", "coil", "discrete"]
Kind = Literal["int16", "uint16", "int32", "uint32", "float32", "bool"]
Order = Literal["big", "little"]

BIT_TABLES = ("coil", "discrete")
WRITABLE_TABLES = ("holding", "coil")
WIDTHS: dict[Kind, int] = {"int16": 1, "uint16": 1, "int32": 2, "uint32": 2, "float32": 2, "bool": 1}
_FORMATS: dict[Kind, str] = {"int16": "h", "uint16": "H", "int32": "i", "uint32": "I", "float32": "f"}
BOUNDS: dict[Kind, tuple[int, int]] = {
    "int16": (-(1 << 15), (1 << 15) - 1),
    "uint16": (0, (1 << 16) - 1),
    "int32": (-(1 << 31), (1 << 31) - 1),
    "uint32": (0, (1 << 32) - 1),
    "bool": (0, 1),
}
_FLOAT32_MAX = 3.4028234663852886e38
_CYCLIC = ("position", "position_command")


@dataclass(frozen=True, slots=True)
class Place:
    """Where a signal is found, and how its number is written there.

    Attributes
    ----------
    name : str
        Of the signal.
    table : str
        Holding or input registers, coils or discrete inputs.
    address : int
        Of its first register, as on the wire: from 0.
    kind : str
        Type of the number.
    word_order : str
        Whether the high (big) or the low word of 32 bits has the lower address.
    byte_order : str
        Whether the high (big) or the low byte of a register goes first on the wire; big is Modbus.
    """

    name: str
    table: Table
    address: int
    kind: Kind
    word_order: Order = "big"
    byte_order: Order = "big"

    @property
    def end(self) -> int:
        """Address after its last register."""
        return self.address + WIDTHS[self.kind]

    def representable(self, number: float) -> float:
        """What of a number can be written: rounded and kept within the range of its type.

        A position wraps in it instead, as the drive's counter does.

        Raises
        ------
        ValueError
            The number is not finite.
        """
        if self.kind == "float32":
            return saturated(number, -_FLOAT32_MAX, _FLOAT32_MAX)
        low, high = BOUNDS[self.kind]
        kept = saturated(number, low, high)
        if self.name in _CYCLIC:
            return (round(number) - low) % (high - low + 1) + low
        return round(kept)

    def words(self, number: float) -> list[int]:
        """Registers (or the coil) for a number; see `representable`.

        Raises
        ------
        ValueError
            The number is not finite.
        """
        if self.kind == "bool":
            return [int(self.representable(number))]
        data = _layout_of(self).pack({self.name: number})
        return list(struct.unpack(f">{len(data) // 2}H", data))

    def number(self, words: Sequence[int]) -> float:
        """Number that the registers (or the bit) hold."""
        if self.kind == "bool":
            return float(words[0])
        return float(_layout_of(self).unpack(struct.pack(f">{len(words)}H", *words))[0])


@dataclass(frozen=True, slots=True)
class Block:
    """Registers side by side that one request reads or writes, and the signals in them."""

    table: Table
    address: int
    count: int
    places: tuple[Place, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Signals in it."""
        return tuple(place.name for place in self.places)

    def __str__(self) -> str:
        if self.table in BIT_TABLES:
            noun = {"coil": "coil", "discrete": "discrete input"}[self.table]
        else:
            noun = {"holding": "register", "input": "input register"}[self.table]
        return f"{self.count} {noun}{'s' * (self.count > 1)} at {self.address:04X}h"


class Layout:
    """How the numbers of a block of registers lie in its bytes, as they are on the wire.

    Parameters
    ----------
    block : Block
        Not of bits.

    Attributes
    ----------
    size : int
        Bytes of the block.
    """

    def __init__(self, block: Block) -> None:
        self.size = 2 * block.count
        self._places = block.places
        self._numbers = struct.Struct(">" + "".join(_FORMATS[place.kind] for place in block.places))
        order = [at for place in block.places for at in _byte_places(place, block.address)]
        self._is_plain = order == list(range(self.size))
        self._out_of = operator.itemgetter(*order)
        # bytes that belong to no signal are zero: one more byte stands for them
        into = [order.index(at) if at in order else len(order) for at in range(self.size)]
        self._into = operator.itemgetter(*into)

    def unpack(self, data: bytes) -> tuple[float, ...]:
        """Numbers of the block, in the order of its places, from as many bytes as it has."""
        return self._numbers.unpack(data if self._is_plain else bytes(self._out_of(data)))

    def pack(self, values: Mapping[str, float]) -> bytes:
        """Bytes of the block for numbers by signal; see `Place.representable`.

        Raises
        ------
        ValueError
            A number is not finite.
        """
        numbers = []
        for place in self._places:
            try:
                numbers.append(place.representable(values[place.name]))
            except ValueError as error:
                raise ValueError(f"{place.name}: {error}") from None
        data = self._numbers.pack(*numbers)
        return data if self._is_plain else bytes(self._into(data + b"\0"))


def _byte_places(place: Place, start: int) -> list[int]:
    """Where the bytes of a number lie behind the register ``start``, the most significant first."""
    words = range(place.address, place.end)
    halves = (0, 1) if place.byte_order == "big" else (1, 0)
    return [
        2 * (word - start) + half for word in (words if place.word_order == "big" else words[::-1]) for half in halves
    ]


@functools.lru_cache(maxsize=1024)
def _layout_of(place: Place) -> Layout:
    return Layout(Block(place.table, place.address, place.end - place.address, (place,)))


def merged(places: Iterable[Place], *, max_gap: int, max_count: int, alignment: int = 1) -> list[Block]:
    """Cover signals with as few blocks as there can be.

    Taking the signals in the order of their addresses, and each block as far as it goes, needs the fewest.

    Parameters
    ----------
    places : iterable of Place
    max_gap : int
        How many registers that belong to no signal may lie in a block, in a row.
    max_count : int
        How many registers a block may have.
    alignment : int
        Blocks begin and end at multiples of it.
    """
    blocks: list[Block] = []
    for place in sorted(places, key=lambda p: (p.table, p.address, p.end)):
        start = place.address - place.address % alignment
        end = place.end + -place.end % alignment
        if blocks:
            last = blocks[-1]
            count = max(last.count, end - last.address)
            if last.table == place.table and start - last.address - last.count <= max_gap and count <= max_count:
                blocks[-1] = Block(last.table, last.address, count, (*last.places, place))
                continue
        blocks.append(Block(place.table, start, end - start, (place,)))
    return blocks
