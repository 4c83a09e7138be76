"""Recordings as users give them: files and patterns of files, recordings, arrays and data frames in memory."""

import glob
import itertools
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from friction_hil.errors import UsageError
from friction_hil.recordings.files import mapped_to, read, read_all
from friction_hil.recordings.mapping import Mapped
from friction_hil.recordings.parts import first_files, without_later_parts
from friction_hil.recordings.recording import Recording
from friction_hil.recordings.table import from_table

if TYPE_CHECKING:
    from friction_hil.config import Configuration
    from friction_hil.recordings.columns import AxisKind

Given = Any
"""A path or pattern, a `Recording`, arrays by the names of columns, a data frame, or several of these."""


def expanded(words: Iterable[str | Path]) -> list[str]:
    """Replace each pattern (``*``, ``?``, ``[..]``, ``**``) by the files that it matches, sorted by name.

    The shell does so unless a pattern is quoted. A file whose name looks like a pattern is taken as it is. A folder
    stands for the recordings of the daemon in it, and that of a data set of LeRobot for its data. Of the files of one
    recording only the first remains: it is read with those that follow.

    Raises `UsageError`: a pattern matches nothing, or a folder has no recording.
    """
    found: list[str] = []
    for word in map(str, words):
        if Path(word).is_dir():
            found += map(str, first_files(Path(word)))
            continue
        if not glob.has_magic(word) or Path(word).exists():
            found.append(word)
            continue
        matches = sorted(path for path in glob.glob(word, recursive=True) if Path(path).is_file())
        if not matches:
            raise UsageError(f"{word}: no file matches")
        found += matches
    return without_later_parts(dict.fromkeys(found)) if len(found) > 1 else found


def read_given(
    given: Given,
    axis: str | None = None,
    *,
    columns: Mapping[str, str] | None = None,  # this and the next three as of `friction_hil.recordings.read`
    scale: Mapping[str, float] | None = None,
    where: str | None = None,
    rate_hz: float | None = None,
    only: Collection[str] | None = None,
    configuration: "Configuration | None" = None,
    is_preview: bool = False,  # time stamps may be missing
    has_all_axes: bool = False,  # without ``axis``, all axes of a file are read, not its only one
) -> list[Recording]:
    """Return the recordings of one axis from whatever a user gives.

    Raises `UsageError`: a pattern matches nothing, there are several axes and none is chosen, or it is no recording;
    `RecordingError`: a file cannot be read, or arrays make no recording.
    """
    mapping: dict[str, Any] = {"columns": columns or {}, "scale": scale or {}, "where": where, "rate_hz": rate_hz}
    found: list[Recording] = []
    for is_path, several in itertools.groupby(_flat(given), lambda each: isinstance(each, str | Path)):
        if is_path:
            options = {**mapping, "only": only, "configuration": configuration, "is_preview": is_preview}
            for file in expanded(several):
                is_whole = has_all_axes and axis is None
                found += read_all(file, **options).values() if is_whole else [read(file, axis, **options)]
            continue
        for each in several:
            if not isinstance(each, Recording):
                name = f"table{len(found) + 1}"
                found.append(replace(from_table(each, axis or name, is_preview=is_preview, **mapping), path=name))
                continue
            if axis not in (None, each.axis):
                raise UsageError(f"{each.path}: the recording is of axis {each.axis!r}, not of {axis!r}")
            if any(mapping.values()):
                copied = replace(each, columns=dict(each.columns), units=dict(each.units), problems=[*each.problems])
                mapped = Mapped(mapping["columns"], mapping["scale"], rate_hz=rate_hz)
                found.append(mapped_to(copied, mapped, where, is_preview=is_preview))
            else:
                found.append(each)
    return found


def _flat(given: Given) -> Iterator[Any]:
    """Yield paths, recordings and tables one by one; of recordings by axis, as `read_all` returns them, all."""
    if isinstance(given, Mapping) and given and all(isinstance(each, Recording) for each in given.values()):
        given = list(given.values())
    if isinstance(given, Sequence) and not isinstance(given, str | Recording):
        for each in given:
            yield from _flat(each)
    else:
        yield given


def kind_of(found: Iterable[Recording], *, is_linear: bool) -> "AxisKind":
    """Return the kind of the axis: as the daemon has recorded it, and by the option where the files do not say.

    Raises `UsageError`: the files say that the axis is rotary, and the option that it is linear; or the files differ.
    """
    kind: AxisKind | None = "linear" if is_linear else None
    by = "--linear"
    for each in found:
        own = each.axis_kind
        if own is not None and kind not in (None, own):
            raise UsageError(f"{each.path}: axis {each.axis!r} is {own} by its configuration, and {kind} by {by}")
        if own is not None:
            kind, by = own, each.path
    return kind or "rotary"
