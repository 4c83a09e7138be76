"""Numbers in registers, and registers side by side. Pure."""

import struct
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

from friction_hil_drivers.serial_line.units import saturated

Table = Literal["holding", "input", "coil", "discrete"]
Kind = Literal["int16", "uint16", "int32", "uint32", "float32", "bool"]
Order = Literal["big", "little"]

BIT_TABLES = ("coil", "discrete")
WRITABLE_TABLES = ("holding", "coil")
WIDTHS: dict[Kind, int] = {"int16": 1, "uint16": 1, "int32": 2, "uint32": 2, "float32": 2, "bool": 1}
_FORMATS: dict[Kind, str] = {"int16": ">h", "uint16": ">H", "int32": ">i", "uint32": ">I", "float32": ">f"}
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

    def words(self, number: float) -> list[int]:
        """Registers (or the coil) for a number.

        It is rounded and kept within the range of its type; a position wraps in it instead, as the drive's counter
        does.

        Raises
        ------
        ValueError
            The number is not finite.
        """
        if self.kind == "float32":
            return self._split(saturated(number, -_FLOAT32_MAX, _FLOAT32_MAX))
        low, high = BOUNDS[self.kind]
        if self.name in _CYCLIC:
            saturated(number, low, high)  # refuses what is not finite
            whole = (round(number) - low) % (high - low + 1) + low
        else:
            whole = round(saturated(number, low, high))
        return [whole] if self.kind == "bool" else self._split(whole)

    def number(self, words: Sequence[int]) -> float:
        """Number that the registers (or the bit) hold."""
        if self.kind == "bool":
            return float(words[0])
        if self.word_order == "little":
            words = words[::-1]
        raw = struct.pack(f"{_mark(self.byte_order)}{len(words)}H", *words)
        return float(struct.unpack(_FORMATS[self.kind], raw)[0])

    def _split(self, number: float) -> list[int]:
        raw = struct.pack(_FORMATS[self.kind], number)
        words = list(struct.unpack(f"{_mark(self.byte_order)}{len(raw) // 2}H", raw))
        return words[::-1] if self.word_order == "little" else words


def _mark(order: Order) -> str:
    return ">" if order == "big" else "<"


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

    def words_of(self, place: Place, words: Sequence[int]) -> Sequence[int]:
        """Registers of one signal among those of the block."""
        return words[place.address - self.address : place.end - self.address]

    def __str__(self) -> str:
        if self.table in BIT_TABLES:
            noun = {"coil": "coil", "discrete": "discrete input"}[self.table]
        else:
            noun = {"holding": "register", "input": "input register"}[self.table]
        return f"{self.count} {noun}{'s' * (self.count > 1)} at {self.address:04X}h"


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
