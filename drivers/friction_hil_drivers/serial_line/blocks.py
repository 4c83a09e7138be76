"""Blocks of consecutive signals in the memory of a drive, each read or written by one request. Pure."""

import math
from collections.abc import Iterable, Mapping
from typing import NamedTuple, Protocol, TypeVar

_WRAPPING = ("position", "position_command")


class Limits(NamedTuple):
    """Numbers that a drive can hold for a signal."""

    low: float
    high: float
    is_integer: bool
    turn: int | None = None  # number of integers from `low` on in which a position wraps, as a counter does


class MemoryField(Protocol):
    """Signal in the memory of a drive."""

    @property
    def name(self) -> str:
        """Name of the signal."""
        ...

    @property
    def address(self) -> int:
        """First address of the signal."""
        ...

    @property
    def end(self) -> int:
        """Address after the last one of the signal."""
        ...

    @property
    def limits(self) -> Limits:
        """Numbers that the drive can hold."""
        ...


AnyField = TypeVar("AnyField", bound=MemoryField)


def integer_limits(name: str, low: int, high: int, greatest: int | None = None) -> Limits:
    """Return the limits of an integer from ``low`` to ``high``; ``greatest``: magnitude that the drive accepts."""
    if name in _WRAPPING:
        return Limits(low, high, is_integer=True, turn=high - low + 1)
    if greatest is not None:
        low, high = max(low, -greatest), min(high, greatest)
    return Limits(low, high, is_integer=True)


def representable_numbers(fields: Iterable[MemoryField], values: Mapping[str, float]) -> list[float]:
    """Return the numbers nearest to the values of some signals that the drive can hold, in the order of the signals.

    Raises `ValueError`: a value is not finite; the message names its signal.
    """
    numbers: list[float] = []
    for field in fields:
        number, (low, high, is_integer, turn) = values[field.name], field.limits
        if not math.isfinite(number):
            raise ValueError(f"{field.name}: {number} cannot be sent to a drive")
        number = min(max(number, low), high) if turn is None else (round(number) - low) % turn + low
        numbers.append(round(number) if is_integer else number)
    return numbers


def merge(
    fields: Iterable[AnyField], *, max_gap: int = 0, max_size: int | None = None, alignment: int = 1
) -> list[tuple[int, int, tuple[AnyField, ...]]]:
    """Cover signals with as few blocks as possible; return first address, size and signals of each.

    Extending each block as far as possible, in the order of the addresses, gives the smallest number of blocks.

    ``max_gap``: most addresses in a row without a signal in a block; ``alignment``: blocks begin and end at its
    multiples.
    """
    blocks: list[tuple[int, int, tuple[AnyField, ...]]] = []
    for field in sorted(fields, key=lambda each: (each.address, each.end)):
        start = field.address - field.address % alignment
        end = field.end + -field.end % alignment
        if blocks:
            address, size, before = blocks[-1]
            joined = max(size, end - address)
            if start - address - size <= max_gap and (max_size is None or joined <= max_size):
                blocks[-1] = address, joined, (*before, field)
                continue
        blocks.append((start, end - start, (field,)))
    return blocks
