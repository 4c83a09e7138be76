"""Following error without and with compensation, as a table: the same for run, tune, demo and plot."""

from collections.abc import Sequence
from dataclasses import dataclass

from friction_hil.cli.work.tables import Column, Table, new_table, number
from friction_hil.numerics.readable import FollowingError, comparison


@dataclass(frozen=True, slots=True)
class Compared:
    """One row of the table."""

    labels: tuple[str, ...]  # cells before the figures
    unit: str  # rad or m
    without: FollowingError | None  # following error without compensation; each of the three is None if not known
    compensated: FollowingError | None  # the same with compensation
    reduction: FollowingError | None  # their ratio


def following_table(headings: Sequence[str | Column], rows: Sequence[Compared]) -> Table:
    """Return the table, with the headings of the labels; a condition that no row has gets no column."""
    conditions = ("without", "compensated", "reduction")
    shown = [k for k, name in enumerate(conditions) if any(getattr(row, name) is not None for row in rows)]
    titles = ("without\ncompensation", "with\ncompensation", "times\nlower")
    table = new_table(*headings, "following\nerror", *(number(titles[k]) for k in shown), keys=len(headings) + 1)
    for row in rows:
        names, *figures = zip(*comparison(row.unit, row.without, row.compensated, row.reduction), strict=True)
        table.add_row(*row.labels, *("\n".join(cells) for cells in (names, *(figures[k] for k in shown))))
    return table
