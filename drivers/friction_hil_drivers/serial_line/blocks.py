"""Blocks of consecutive signals in the memory of a drive, each read or written by one request. Pure."""

from collections.abc import Iterable, Mapping
from typing import Protocol, TypeVar

from friction_hil_drivers.serial_line.units import saturated

_WRAPPING = ("position", "position_command")


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

    def representable(self, number: float) -> float:
        """Return the number nearest to ``number`` that the drive can hold.

        Raises `ValueError`: the number is not finite.
        """
        ...


AnyField = TypeVar("AnyField", bound=MemoryField)


def nearest_integer(name: str, number: float, bounds: tuple[int, int], type_bounds: tuple[int, int]) -> int:
    """Round a number and limit it to bounds; a position wraps within the bounds of its type, as a counter does.

    ``bounds``: least and greatest number that the drive accepts; ``type_bounds``: of the type. Raises `ValueError`: the
    number is not finite.
    """
    kept = saturated(number, *bounds)
    if name in _WRAPPING:
        low, high = type_bounds
        return (round(number) - low) % (high - low + 1) + low
    return round(kept)


def representable_numbers(fields: Iterable[MemoryField], values: Mapping[str, float]) -> list[float]:
    """Return the numbers nearest to the values of some signals that the drive can hold, in the order of the signals.

    Raises `ValueError`: a value is not finite; the message names its signal.
    """
    numbers = []
    for field in fields:
        try:
            numbers.append(field.representable(values[field.name]))
        except ValueError as error:
            raise ValueError(f"{field.name}: {error}") from None
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
