"""Numbers as people read them: with unit prefixes, few digits, and no minus before a zero. Pure."""

import math
from collections.abc import Iterable
from types import ModuleType
from typing import Any, Protocol

POSITION_UNITS = {"rotary": "rad", "linear": "m"}
FORCE_UNITS = {"rotary": "N m", "linear": "N"}

_PREFIXES = ((1.0, ""), (1e3, "m"), (1e6, "µ"))
_SMALLEST = (1e9, "n")
_LARGEST_PLAIN = 1e7  # larger numbers have an exponent


def readable(unit: str, values: Iterable[float]) -> tuple[float, str]:
    """Return factor and unit in which the smallest of ``values`` is at least 1: ``(1e6, "µrad")``.

    ``unit``: SI unit of the values: rad, m, N m, ...; ``rad or m`` if it is not known exactly. Zeros and values that
    are not finite do not count; without any other the unit has no prefix.
    """
    sizes = [abs(value) for value in values if math.isfinite(value) and value]
    if not sizes:
        return 1.0, unit
    smallest = min(sizes)
    factor, prefix = next((each for each in _PREFIXES if smallest * each[0] >= 1.0), _SMALLEST)
    return factor, " or ".join(prefix + each for each in unit.split(" or "))


def digits(value: float, significant: int = 3) -> str:
    """Format a number with at least ``significant`` digits and no exponent; ``-`` for one that is not finite."""
    if not math.isfinite(value):
        return "-"
    decimals = max(significant - 1 - math.floor(math.log10(abs(value))), 0) if value else 0
    return without_negative_zero(f"{value:.{decimals}f}")


def quantity(value: float, unit: str) -> str:
    """Format a value with prefix and unit, 3 digits: ``12.3 µrad``; ``-`` for one that is not finite."""
    if not math.isfinite(value):
        return "-"
    factor, shown = readable(unit, [value])
    return f"{digits(value * factor)} {shown}"


def brief(value: float, significant: int = 5) -> str:
    """Format a number of any size for a table: whole where it is large, with an exponent only if it must be.

    ``-`` for one that is not finite.
    """
    if not math.isfinite(value):
        return "-"
    size = abs(value)
    if 10.0 ** (significant - 1) <= size < _LARGEST_PLAIN:
        return f"{value:.0f}"
    return without_negative_zero(f"{value:.{significant}g}")


class FollowingError(Protocol):
    """Root mean square and largest absolute value of a following error, rad or m, or their ratios to others."""

    @property
    def rms(self) -> float:
        """Root mean square."""
        ...

    @property
    def peak(self) -> float:
        """Largest absolute value."""
        ...


def comparison(
    unit: str,
    without: FollowingError | None,
    compensated: FollowingError | None,
    reduction: FollowingError | None,
) -> list[tuple[str, str, str, str]]:
    """Return RMS and peak of the following error: name with unit, without, with compensation, times lower.

    ``unit``: of the position: rad or m. ``reduction``: ratio of the first error to the second. ``-`` stands for one
    that is None.
    """
    factor, shown = readable(unit, [each.rms for each in (without, compensated) if each is not None])
    columns = ((without, factor, 3), (compensated, factor, 3), (reduction, 1.0, 2))

    def cells(name: str) -> list[str]:
        return ["-" if each is None else digits(getattr(each, name) * by, kept) for each, by, kept in columns]

    return [(f"{name} [{shown}]", *cells(name)) for name in ("rms", "peak")]  # type: ignore[misc]


def shortened(text: str, width: int) -> str:
    """Return a text of at most ``width`` characters; its end is replaced by … if it is longer."""
    return text if len(text) <= width else text[: max(width - 1, 0)] + "…"[:width]


def without_negative_zero(text: str) -> str:
    """Return a formatted number, and for a zero with a sign the same without: ``-0.00`` becomes ``0.00``."""
    is_zero = text.startswith("-") and not any(digit in text for digit in "123456789")
    return text.removeprefix("-") if is_zero else text


def named_constants(module: ModuleType) -> dict[str, Any]:
    """Return the constants of a module of thresholds, by their names in small letters, for results."""
    return {name.lower(): value for name, value in vars(module).items() if name.isupper()}
