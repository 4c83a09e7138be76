"""A recording of one axis in memory, and the checks that every format goes through."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from friction_hil.errors import RecordingError, UsageError, choices
from friction_hil.recordings.columns import CYCLE, SPARSE, TIME

Array = NDArray[np.float64]

_NAMED_ROWS = 5


@dataclass(frozen=True, slots=True)
class Event:
    """Something that happened in a cycle: a fault, a change of a setting."""

    cycle: float
    name: str
    text: str


@dataclass(slots=True)
class Recording:
    """The log of one axis.

    Attributes
    ----------
    path : str
        Where it was read from.
    axis : str
        Name of the axis.
    columns : dict of (n,) arrays
        float64, SI, by the names of `friction_hil.recordings.columns`; what was not measured is NaN.
    metadata : dict
        What the file says beside the columns: configuration, model, fingerprint.
    problems : list of str
        What is wrong with the file though it could be read, one sentence each.
    restarts : list of (int, array)
        Rows at which the whole state of the compensator is known, with the state *before* the step of that
        row; ordered.
    events : list of Event
        Faults and changes of settings.
    """

    path: str
    axis: str
    columns: dict[str, Array]
    metadata: dict[str, Any] = field(default_factory=dict)
    problems: list[str] = field(default_factory=list)
    restarts: list[tuple[int, Array]] = field(default_factory=list)
    events: list[Event] = field(default_factory=list)

    def __len__(self) -> int:
        return len(next(iter(self.columns.values()))) if self.columns else 0

    def __getitem__(self, name: str) -> Array:
        self.require(name)
        return self.columns[name]

    def __contains__(self, name: object) -> bool:
        """Whether the column is there and holds at least one value."""
        return name in self.columns and not bool(np.isnan(self.columns[str(name)]).all())

    @property
    def period_s(self) -> float:
        """Median distance of two time stamps, s; NaN with fewer than two rows."""
        return float(np.median(np.diff(self.columns[TIME]))) if len(self) > 1 else float("nan")

    @property
    def duration_s(self) -> float:
        """Time from the first row to the last, s."""
        return float(self.columns[TIME][-1] - self.columns[TIME][0]) if len(self) else 0.0

    def require(self, *names: str) -> None:
        """Raise RecordingError where a column is absent or holds nothing; the message says how to map one."""
        missing = [name for name in names if name not in self]
        if not missing:
            return
        there = ", ".join(name for name in self.columns if name in self) or "none"
        raise RecordingError(
            f"{self.path}: no column {', '.join(missing)}. There are: {there}. "
            f"A column of another name is mapped with {' '.join(f'--column {name}=NAME' for name in missing)}"
        )


def rename(recording: Recording, columns: Mapping[str, str], scale: Mapping[str, float]) -> None:
    """Give columns their names here, ``{'time_s': 't'}``, then multiply by ``scale``, by the new names.

    A column that already has the name is replaced. Several names may come from one column.

    Raises
    ------
    UsageError
        A column to be mapped or scaled is not there, or a factor is not finite, zero or too large.
    """
    there = recording.columns
    for name, source in columns.items():
        if source not in there:
            raise UsageError(f"{recording.path}: --column {name}={source}: {choices(source, there)}")
    sources = set(columns.values())
    kept = {name: values for name, values in there.items() if name not in sources and name not in columns}
    recording.columns = {name: there[source] for name, source in columns.items()} | kept
    for name, factor in scale.items():
        if name not in recording.columns:
            raise UsageError(f"{recording.path}: --scale {name}: {choices(name, recording.columns)}")
        if not np.isfinite(factor) or factor == 0.0:
            raise UsageError(f"--scale {name}={factor:g}: a factor is finite and not zero")
        values = recording.columns[name]
        with np.errstate(over="ignore"):
            scaled = values * factor
        if np.isinf(scaled[np.isfinite(values)]).any():
            raise UsageError(f"{recording.path}: --scale {name}={factor:g}: what results is too large for a number")
        recording.columns[name] = scaled


def check(recording: Recording) -> None:
    """Refuse what cannot be used, and note in ``problems`` what is odd.

    Raises
    ------
    RecordingError
        There are no rows, no time stamps, or a time stamp is not finite.
    """
    if not len(recording):
        raise RecordingError(f"{recording.path}: there are no rows{_because(recording.problems)}")
    recording.require(TIME)
    time = recording.columns[TIME]
    wrong = np.flatnonzero(~np.isfinite(time))
    if wrong.size:
        raise RecordingError(f"{recording.path}: {TIME} is not finite in {_rows(wrong, len(time))}")
    steps = np.diff(time)
    for what, rows in (("goes backward", steps < 0.0), ("stands still", steps == 0.0)):
        if rows.any():
            recording.problems.append(f"{TIME} {what} at {_rows(np.flatnonzero(rows) + 1, len(time))}")
    for name, values in recording.columns.items():
        is_absent = name in SPARSE or bool(np.isnan(values).all())
        wrong = np.flatnonzero(np.isinf(values) if is_absent else ~np.isfinite(values))
        if wrong.size:
            recording.problems.append(f"{name} is not finite in {_rows(wrong, len(values))}")
    if CYCLE in recording:
        _note_gaps(recording)


def _note_gaps(recording: Recording) -> None:
    cycle = recording.columns[CYCLE]
    steps = np.diff(cycle)
    gaps = np.flatnonzero(steps > 1.0)
    if gaps.size:
        missing = int(np.sum(steps[gaps] - 1.0))
        recording.problems.append(
            f"{missing} cycles are missing in {gaps.size} gap{'s' * (gaps.size > 1)}, "
            f"the first after cycle {cycle[gaps[0]]:.0f}"
        )


def _rows(rows: NDArray[np.intp], total: int) -> str:
    named = ", ".join(str(row) for row in rows[:_NAMED_ROWS])
    return f"{rows.size} of {total} rows (row {named}{', ...' if rows.size > _NAMED_ROWS else ''})"


def _because(problems: Iterable[str]) -> str:
    text = "; ".join(problems)
    return f": {text}" if text else ""
