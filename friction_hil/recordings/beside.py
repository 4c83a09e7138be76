"""Columns from other files: ``torque.csv:tau`` is the column ``tau`` of a file beside the recording."""

import re
from collections.abc import Callable, Collection, Iterable
from pathlib import Path

import numpy as np

from friction_hil.errors import RecordingError, UsageError, choices
from friction_hil.recordings.product import columns_of
from friction_hil.recordings.recording import Array, Recording

_LONGEST_SUFFIX = 8
_LONGEST_GAP = 10  # periods: beyond, values between two rows of the other file are unknown


def add_columns_beside(
    recording: Recording,  # with the names of its file
    sources: Iterable[str],  # of columns, such as `torque.csv:tau*0.5`
    time_source: str,  # of the time stamps in both files; if it is empty, or in another file, rows are counted
    suffixes: Collection[str],  # of files that can be read
    read: Callable[[Path], list[Recording]],  # the axes of a file, with the names of the file
) -> None:
    """Add each column of another file that a source refers to, under the name by which it does.

    If both files have a column of time stamps, values are interpolated at the times of the recording. Otherwise the
    files are joined row by row. Raises `RecordingError`: a file cannot be read, or the times or the numbers of rows do
    not match; `UsageError`: there is no such file, or no such column in it.
    """
    if is_beside(time_source, suffixes):
        time_source = ""
    files: dict[Path, Recording] = {}
    for name in dict.fromkeys(each for source in sources for each in columns_of(source)):
        if name in recording.columns or name in recording.others:
            continue
        file, column = _file_and_column(name, suffixes)
        if not file:
            continue
        path = _found(Path(recording.path), file, name)
        if path not in files:
            files[path] = _only_axis(path, read(path))
        other = files[path]
        if column not in other.columns:
            raise UsageError(f"{path}: there is no column {column!r}; {choices(column, other.columns)}")
        recording.columns[name] = _joined(recording, other, column, time_source)
        if column in other.units:
            recording.units[name] = other.units[column]
    for path, other in files.items():
        recording.problems += [f"{path.name}: {problem}" for problem in other.problems]


def is_beside(name: str, suffixes: Collection[str]) -> bool:
    """True if the name of a column refers to another file."""
    return bool(_file_and_column(name, suffixes)[0])


def _file_and_column(name: str, suffixes: Collection[str]) -> tuple[str, str]:
    """Split ``torque.csv:tau``; both are empty if there is no file in the name."""
    found = re.match(rf"(?P<file>.*(?P<suffix>\.\w{{1,{_LONGEST_SUFFIX}}}))\s*:\s*(?P<column>.+)", name)
    if found is None or found["suffix"].lower() not in suffixes:
        return "", ""
    return found["file"].strip(), found["column"].strip()


def _found(recording: Path, file: str, name: str) -> Path:
    for path in (recording.parent / file, Path(file)):
        if path.is_file():
            return path
    raise UsageError(f"{recording}: {name}: there is no file {file} beside the recording or in the current folder")


def _only_axis(path: Path, axes: list[Recording]) -> Recording:
    if len(axes) != 1:
        raise UsageError(
            f"{path} has the axes {', '.join(each.axis for each in axes)}; a file beside a recording has one"
        )
    return axes[0]


def _joined(recording: Recording, other: Recording, column: str, time_source: str) -> Array:
    """Return a column of another file (n,) for the rows of a recording; NaN at times that the other does not cover."""
    values = other.columns[column]
    if not time_source or time_source not in other.columns or time_source not in recording.columns:
        if len(values) != len(recording):
            named = f" {time_source}" if time_source else ""
            raise RecordingError(
                f"{other.path} has {len(values)} rows and {recording.path} has {len(recording)}: without a column of "
                f"time stamps{named} in both they are joined row by row, which takes equal numbers of rows"
            )
        return values
    time, own = recording.columns[time_source], other.columns[time_source]
    if np.array_equal(time, own):
        return values
    known = np.flatnonzero(np.isfinite(own) & np.isfinite(values))
    order = known[np.argsort(own[known], kind="stable")]
    found: Array = np.full(len(time), np.nan)
    if len(order):
        found = np.interp(time, own[order], values[order], left=np.nan, right=np.nan)
        steps = np.diff(own[order])
        at = np.clip(np.searchsorted(own[order], time), 1, max(len(steps), 1))
        if len(steps):
            is_between = (time > own[order][at - 1]) & (time < own[order][at])
            found[is_between & (steps[at - 1] > _LONGEST_GAP * np.median(steps))] = np.nan
    if not np.isfinite(found).any():
        raise RecordingError(
            f"{other.path}: its times do not overlap with those of {recording.path}: {time_source} is "
            f"{np.nanmin(own):.6g} to {np.nanmax(own):.6g} there, {np.nanmin(time):.6g} to {np.nanmax(time):.6g} here"
        )
    recording.problems.append(f"{Path(other.path).name}:{column} is interpolated at the times of {time_source}")
    return found
