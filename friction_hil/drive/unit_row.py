"""Rows of the table of units and watchdog that a driver shows before anything is enabled."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class UnitRow:
    """Unit of one quantity of a drive, in words for the user."""

    quantity: str  # ``position``, ``velocity`` or ``torque``; ``watchdog`` for what takes the torque if the daemon dies
    value: str  # scale, e.g. ``651.9 counts per rad``
    source: str  # where the scale comes from, e.g. ``608Fh 4096/1``
    confirmation: str  # what agrees with it, or ``not cross-checked``
    limit: str  # of the configuration, in increments of the drive


def unit_table(name: str, rows: Iterable[UnitRow]) -> Iterator[str]:
    """Yield the lines of the table of one axis.

    >>> row = UnitRow("torque", "0.64 N m at 1000 per mille", "6076h", "not cross-checked", "0.3 N m = 468 per mille")
    >>> print(*unit_table("x", [row]), sep="\\n")
    x: torque: 0.64 N m at 1000 per mille from 6076h; not cross-checked; limit 0.3 N m = 468 per mille
    """
    for row in rows:
        yield f"{name}: {row.quantity}: {row.value} from {row.source}; {row.confirmation}; limit {row.limit}"
