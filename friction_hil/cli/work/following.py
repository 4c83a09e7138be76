"""Following error without and with compensation, as a table: the same for run, tune, demo and plot."""

from collections.abc import Sequence
from dataclasses import dataclass

from friction_hil.cli.work.tables import Column, Table, new_table, number
from friction_hil.numerics.readable import FollowingError, comparison


@dataclass(frozen=True, slots=True)
class Compared:
    """One row of the table.

    Attributes
    ----------
    labels : tuple of str
        Cells before the figures.
    unit : str
        rad or m.
    without, compensated, reduction : FollowingError or None
        Following error without and with compensation, and their ratio; None if it is not known.
    """

    labels: tuple[str, ...]
    unit: str
    without: FollowingError | None
    compensated: FollowingError | None
    reduction: FollowingError | None


def following_table(headings: Sequence[str | Column], rows: Sequence[Compared]) -> Table:
    """Return the table; a condition that no row has gets no column.

    Parameters
    ----------
    headings : sequence of str or Column
        Headings of the labels.
    rows : sequence of Compared
    """
    conditions = ("without", "compensated", "reduction")
    shown = [k for k, name in enumerate(conditions) if any(getattr(row, name) is not None for row in rows)]
    titles = ("without\ncompensation", "with\ncompensation", "times\nlower")
    table = new_table(*headings, "following\nerror", *(number(titles[k]) for k in shown), keys=len(headings) + 1)
    for row in rows:
        names, *figures = zip(*comparison(row.unit, row.without, row.compensated, row.reduction), strict=True)
        table.add_row(*row.labels, *("\n".join(cells) for cells in (names, *(figures[k] for k in shown))))
    return table
