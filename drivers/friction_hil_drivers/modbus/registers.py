"""Numbers in Modbus registers and coils, and blocks of consecutive registers. Pure."""

import functools
import operator
import struct
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

from friction_hil_drivers.serial_line.blocks import Limits, integer_limits, merge, representable_numbers

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


@dataclass(frozen=True, slots=True)
class RegisterField:
    """Registers (or the coil) that hold a signal, and the format of its number."""

    name: str
    table: Table  # holding or input registers, coils or discrete inputs
    address: int  # of the first register, as on the wire: from 0
    kind: Kind
    word_order: Order = "big"  # word of 32 bits at the lower address: the high one (big) or the low one
    # byte of a register that is sent first: the high one (big), as Modbus requires, or the low one
    byte_order: Order = "big"
    # a number is rounded and limited to the range of its type; a position wraps in it, as the drive's counter does
    limits: Limits = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        is_float = self.kind == "float32"
        limits = Limits(-_FLOAT32_MAX, _FLOAT32_MAX, is_integer=False) if is_float else None
        object.__setattr__(self, "limits", limits or integer_limits(self.name, *BOUNDS[self.kind]))

    @property
    def end(self) -> int:
        """Address after the last register."""
        return self.address + WIDTHS[self.kind]

    def words(self, number: float) -> list[int]:
        """Return the registers (or the coil) for a number. Raises `ValueError`: the number is not finite."""
        if self.kind == "bool":
            return [int(each) for each in representable_numbers((self,), {self.name: number})]
        data = _layout_of(self).pack({self.name: number})
        return list(struct.unpack(f">{len(data) // 2}H", data))

    def number(self, words: Sequence[int]) -> float:
        """Return the number that the registers (or the bit) hold."""
        if self.kind == "bool":
            return float(words[0])
        return float(_layout_of(self).unpack(struct.pack(f">{len(words)}H", *words))[0])


@dataclass(frozen=True, slots=True)
class RegisterBlock:
    """Consecutive registers that one request reads or writes, and the signals in them."""

    table: Table
    address: int
    count: int
    fields: tuple[RegisterField, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the signals in the block."""
        return tuple(field.name for field in self.fields)

    def __str__(self) -> str:
        if self.table in BIT_TABLES:
            noun = {"coil": "coil", "discrete": "discrete input"}[self.table]
        else:
            noun = {"holding": "register", "input": "input register"}[self.table]
        return f"{self.count} {noun}{'s' * (self.count > 1)} at {self.address:04X}h"


class Layout:
    """Conversion between the numbers in a block of holding or input registers and its bytes on the wire."""

    def __init__(self, block: RegisterBlock) -> None:
        self.size = 2 * block.count  # bytes
        self._fields = block.fields
        self._numbers = struct.Struct(">" + "".join(_FORMATS[field.kind] for field in block.fields))
        order = [at for field in block.fields for at in _byte_offsets(field, block.address)]
        self._is_plain = order == list(range(self.size))
        self._out_of = operator.itemgetter(*order)
        # bytes that belong to no signal are taken from one more byte at the end, which is zero
        into = [order.index(at) if at in order else len(order) for at in range(self.size)]
        self._into = operator.itemgetter(*into)

    def unpack(self, data: bytes) -> tuple[float, ...]:
        """Return the numbers of the block, in the order of its fields, from its ``size`` bytes."""
        return self._numbers.unpack(data if self._is_plain else bytes(self._out_of(data)))

    def pack(self, values: Mapping[str, float]) -> bytes:
        """Return the bytes of the block for numbers by signal. Raises `ValueError`: a number is not finite."""
        data = self._numbers.pack(*representable_numbers(self._fields, values))
        return data if self._is_plain else bytes(self._into(data + b"\0"))


def _byte_offsets(field: RegisterField, start: int) -> list[int]:
    """Return the byte offsets of a number from the register ``start``, the most significant byte first."""
    words = range(field.address, field.end)
    halves = (0, 1) if field.byte_order == "big" else (1, 0)
    return [
        2 * (word - start) + half for word in (words if field.word_order == "big" else words[::-1]) for half in halves
    ]


@functools.lru_cache(maxsize=1024)
def _layout_of(field: RegisterField) -> Layout:
    return Layout(RegisterBlock(field.table, field.address, field.end - field.address, (field,)))


def merged(fields: Iterable[RegisterField], *, max_gap: int, max_count: int, alignment: int = 1) -> list[RegisterBlock]:
    """Cover signals with as few blocks as possible.

    ``max_gap``: most registers in a row without a signal in a block; ``max_count``: most registers in a block;
    ``alignment``: blocks begin and end at its multiples.
    """
    tables: dict[Table, list[RegisterField]] = {}
    for each in fields:
        tables.setdefault(each.table, []).append(each)
    return [
        RegisterBlock(table, *block)
        for table, of_table in sorted(tables.items())
        for block in merge(of_table, max_gap=max_gap, max_size=max_count, alignment=alignment)
    ]
