"""Recordings that the daemon has divided into several files: which belong together, and how they are joined.

Each file is a recording of its own, with configuration, models and states. Its metadata has its number, and the time of
the start that all files of a run have in common.
"""

import io
import itertools
import os
import re
import stat
import struct
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Metadata
from mcap.writer import MCAP0_MAGIC

from friction_hil.errors import RecordingError, UsageError
from friction_hil.recordings import json_text
from friction_hil.recordings.columns import CYCLE, TIME
from friction_hil.recordings.lerobot import data_files
from friction_hil.recordings.mcap_format import IS_OF_FAULT, JSON_KEY, PART, RECORDING_METADATA, SERIES
from friction_hil.recordings.recording import Recording

SUFFIX = ".mcap"
_RECORD = struct.Struct("<BQ")
_LONGEST = 1 << 20  # bytes of a record before that metadata
_FIRST_RECORDS = 3
_NAMED = 20  # files in a message
_NO_WAIT = getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)


def part_of(path: Path) -> tuple[int, int] | None:
    """Return start of the run, ns since 1970, and number of a file that is part of a recording; None for any other."""
    return _part_of(_about(path))


def series_of(path: Path) -> tuple[str | None, tuple[int, int] | None]:
    """Return by which daemon, for which path, a file was recorded, None if it does not say so, and its `part_of`."""
    about = _about(path)
    series = about.get(SERIES)
    return series if isinstance(series, str) else None, _part_of(about)


def _part_of(about: dict[str, Any]) -> tuple[int, int] | None:
    started, part = about.get("started_unix_ns"), about.get(PART)
    return (started, part) if isinstance(started, int) and isinstance(part, int) else None


def started_s(path: Path) -> tuple[float, bool]:
    """Return the time of ``time_s`` 0, s since 1970, and True if the recording states it: else its last change."""
    own = part_of(path)
    if own is not None and own[0] > 0:  # a run in simulated time has the start 0
        return own[0] * 1e-9, True
    return path.stat().st_mtime, False


def is_of_fault(path: Path) -> bool:
    """True if a file is the copy of the rows around a fault."""
    return bool(_about(path).get(IS_OF_FAULT))


def parts_of(path: Path) -> list[Path]:
    """Return the files of the recording whose first file is ``path``, in order; only ``path`` for any other file.

    If the first ones have been removed, the first of the others takes their place.
    """
    own = _place(path)
    if own is None:
        return [path]
    (folder, stem, started), _ = own
    pattern = re.compile(rf"{re.escape(stem)}(?:-(\d+))?{re.escape(path.suffix)}")
    found = {}
    for each in _entries(folder):
        name = pattern.fullmatch(each.name)
        if name and part_of(each) == (started, int(name[1] or 1)):
            found[int(name[1] or 1)] = each
    files = [found[key] for key in sorted(found)]
    return files if files[:1] == [path] else [path]


def _entries(folder: Path) -> list[Path]:
    try:
        return list(folder.iterdir())
    except PermissionError:  # the folder of a file that the user may read nevertheless
        return []


def _place(path: Path) -> tuple[tuple[Path, str, int], int] | None:
    """Return what all files of a recording have in common, and the number of this one; None for any other file."""
    own = part_of(path) if path.suffix.lower() == SUFFIX else None
    if own is None:
        return None
    started, number = own
    stem = path.stem if number == 1 else path.stem.removesuffix(f"-{number}")
    is_renamed = number != 1 and stem == path.stem
    return None if is_renamed else ((path.parent, stem, started), number)


def first_files(folder: Path) -> list[Path]:
    """Return the first file of each recording in a folder, by name; without those of faults.

    The folder may be a data set of LeRobot too. Raises `UsageError`: there is none.
    """
    if data := data_files(folder):
        return data
    files = sorted(path for path in folder.iterdir() if path.suffix.lower() == SUFFIX and path.is_file())
    found = [Path(each) for each in without_later_parts(str(path) for path in files if not is_of_fault(path))]
    if not found:
        faults = "; the files of faults in it are read by name" if files else ""
        raise UsageError(f"{folder}: no recording ({SUFFIX}) is in this folder{faults}")
    return found


def only_recording(path: Path) -> Path:
    """Return ``path``, or the first file of the only recording in it if it is a folder.

    Raises `UsageError`: the folder has no recording, or several.
    """
    if not path.is_dir():
        return path
    found = first_files(path)
    if len(found) > 1:
        names = ", ".join(each.name for each in found[:_NAMED]) + (", ..." if len(found) > _NAMED else "")
        raise UsageError(f"{path} has {len(found)} recordings; name one of them: {names}")
    return found[0]


def without_later_parts(paths: Iterable[str]) -> list[str]:
    """Return the paths without those files that are read together with another one of them."""
    paths = list(paths)
    groups: dict[tuple[Path, str, int], list[tuple[int, Path]]] = {}
    for path in map(Path, paths):
        if (place := _place(path)) is not None:
            groups.setdefault(place[0], []).append((place[1], path))
    later = {each for group in groups.values() for each in parts_of(min(group)[1])[1:]}
    return [path for path in paths if Path(path) not in later]


def read_as_one(files: Sequence[Path], read: Callable[[Path], list[Recording]]) -> list[Recording]:
    """Return the axes of a recording with the rows of all its files.

    Rows that two files have, because the process that wrote the first one was killed, are taken once. Files without
    rows, because it was killed at once, are left out and reported.

    ``read`` reads one file. Raises `RecordingError`: no file can be read, or they do not have the same axes and
    columns.
    """
    parts, problems = [], []
    for path in files:
        try:
            parts.append((path, read(path)))
        except RecordingError as error:
            if path == files[-1] and not parts:
                raise
            problems.append(f"left out: {error}")
    joined = _join(parts)
    for each in joined:
        each.problems += problems
    return joined


def _join(parts: Sequence[tuple[Path, list[Recording]]]) -> list[Recording]:
    (first_path, first), *others = parts
    columns = {each.axis: list(each.columns) for each in first}
    for path, recordings in others:
        if {each.axis: list(each.columns) for each in recordings} != columns:
            raise RecordingError(f"{path} has other axes or columns than {first_path}, whose part it is")
    by_axis = zip(*(recordings for _, recordings in parts), strict=True)
    return [_joined([path.name for path, _ in parts], each) for each in by_axis]


def _joined(names: Sequence[str], parts: Sequence[Recording]) -> Recording:
    whole = parts[0]
    whole.problems = [f"{name}: {text}" for name, part in zip(names, parts, strict=True) for text in part.problems]
    if len(names) > 1:
        further = "1 file that follows it" if len(names) == 2 else f"{len(names) - 1} files that follow it"
        whole.problems.insert(0, f"{names[0]} is read with the {further}, up to {names[-1]}")
    whole.events = _without_repeats([event for part in parts for event in part.events])
    order = CYCLE if CYCLE in whole.columns else TIME
    skipped, restarts, count, latest = [], [], 0, -np.inf
    for part in parts:
        values = part.columns.get(order, np.empty(0))
        skip = int(np.searchsorted(values, latest, side="right"))
        restarts += [(count + row - skip, state) for row, state in part.restarts if row >= skip]
        skipped.append(skip)
        count += len(part) - skip
        latest = float(values[-1]) if len(values) > skip else latest
    whole.restarts = restarts
    whole.columns = {  # taken from the parts one by one: two copies of all might not fit into the memory
        name: np.concatenate([part.columns.pop(name)[skip:] for part, skip in zip(parts, skipped, strict=True)])
        for name in list(whole.columns)
    }
    return whole


def _without_repeats(events: list[Any]) -> list[Any]:
    return [event for event, _ in itertools.groupby(events)]


def _about(path: Path) -> dict[str, Any]:
    """Return the metadata record about the file itself; empty if there is none."""
    try:
        # a pipe without a writer would be waited for, and what is no file has no header
        with open(os.open(path, os.O_RDONLY | _NO_WAIT), "rb") as file:
            if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
                return {}
            if file.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC:
                return {}
            for _ in range(_FIRST_RECORDS):
                opcode, length = _RECORD.unpack(file.read(_RECORD.size))
                body = file.read(min(length, _LONGEST))
                if opcode == Opcode.METADATA:
                    return _content(body)
    except (OSError, struct.error):
        pass  # whoever reads the file reports it
    return {}


def _content(body: bytes) -> dict[str, Any]:
    try:
        record = Metadata.read(ReadDataStream(io.BytesIO(body)))
        content = json_text.parse(record.metadata[JSON_KEY]) if record.name == RECORDING_METADATA else None
    except (McapError, ValueError, KeyError, struct.error):
        return {}
    return content if isinstance(content, dict) else {}
