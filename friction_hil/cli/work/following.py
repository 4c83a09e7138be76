"""Following error without and with compensation, as a table: the same for run, tune and demo."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from friction_hil.cli.work.tables import Column, Table, new_table, number
from friction_hil.numerics.readable import digits, readable

_FIGURES = ("rms", "peak")


class Error(Protocol):
    """Root mean square and largest absolute value of a following error, rad or m."""

    @property
    def rms(self) -> float:
        """Root mean square."""
        ...

    @property
    def peak(self) -> float:
        """Largest absolute value."""
        ...


@dataclass(frozen=True, slots=True)
class Compared:
    """One row of the table.

    Attributes
    ----------
    labels : tuple of str
        Cells before the figures.
    unit : str
        rad or m.
    without, compensated, reduction : Error, optional
        Following error without and with compensation, and their ratio; None if it is not known.
    """

    labels: tuple[str, ...]
    unit: str
    without: Error | None
    compensated: Error | None
    reduction: Error | None


def following_table(headings: Sequence[str | Column], rows: Sequence[Compared]) -> Table:
    """Return the table; a condition that no row has gets no column.

    Parameters
    ----------
    headings : sequence of str or Column
        Headings of the labels.
    rows : sequence of Compared
    """
    columns: list[tuple[str, str]] = [
        (name, heading)
        for name, heading in (("without", "without\ncompensation"), ("compensated", "with\ncompensation"))
        if any(getattr(row, name) is not None for row in rows)
    ]
    is_compared = any(row.reduction is not None for row in rows)
    last = [number("times\nlower")] if is_compared else []
    keys = len(headings) + 1
    table = new_table(*headings, "following\nerror", *(number(heading) for _, heading in columns), *last, keys=keys)
    for row in rows:
        known = [error for error in (row.without, row.compensated) if error is not None]
        factor, unit = readable(row.unit, [error.rms for error in known])
        cells = ["\n".join(f"{name} [{unit}]" for name in _FIGURES)]
        cells += [_cell(getattr(row, name), factor, 3) for name, _ in columns]
        table.add_row(*row.labels, *cells, *([_cell(row.reduction, 1.0, 2)] if is_compared else []))
    return table


def _cell(error: Error | None, factor: float, significant: int) -> str:
    """Return RMS above peak."""
    if error is None:
        return "-\n-"
    return "\n".join(digits(getattr(error, name) * factor, significant) for name in _FIGURES)
