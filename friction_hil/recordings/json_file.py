"""Read and write JSON: a list of rows, each an object, or an object with such a list and metadata."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from friction_hil.errors import RecordingError
from friction_hil.recordings import json_text
from friction_hil.recordings.bounds import check_columns
from friction_hil.recordings.json_text import brief
from friction_hil.recordings.matrices import MOST_WIDE
from friction_hil.recordings.recording import Recording
from friction_hil.recordings.source import Source, open_new

_CLOSINGS = ("]", "]}")
_NUMBERS = {int, float, bool, type(None)}
_ROWS_AT_ONCE = 10_000
_OBJECTS = 10  # bytes that the objects of typical rows take for each byte of text
_NAMED = 20  # keys that a message lists


def read(source: Source) -> list[Recording]:
    """Read the longest list of objects in the file; the other top-level entries become the metadata.

    A missing field and null are NaN; true and false are 1 and 0. A file that was cut off is read up to its last whole
    row. Raises `RecordingError`: the file is not JSON, or has no list of rows; `OSError`: the file cannot be opened.
    """
    path, problems = source.path, list[str]()
    content = _parse(source, problems)
    metadata: dict[str, Any] = {}
    rows = content
    if isinstance(content, dict):
        lists = [key for key, value in content.items() if _is_rows(value)]
        if not lists:
            there = ", ".join(map(repr, list(content)[:_NAMED])) + ", ..." * (len(content) > _NAMED)
            raise RecordingError(f"{path}: {_EXPECTED}; this object has {there or 'nothing'}")
        key = max(lists, key=lambda each: len(content[each]))
        others = [repr(other) for other in lists if other != key]
        problems += [f"the list {other} is shorter than {key!r}: left out" for other in others[:_NAMED]]
        problems += [f"{len(others) - _NAMED} more lists are left out"] if len(others) > _NAMED else []
        metadata, rows = {name: value for name, value in content.items() if name not in lists}, content[key]
    if not _is_rows(rows):
        raise RecordingError(f"{path}: {_EXPECTED}")
    recording = Recording(str(path), source.name, {}, metadata, problems)
    for number, row in enumerate(rows):
        if not isinstance(row, dict):
            raise RecordingError(f"{path}: row {number} is not an object of fields but {brief(row)}")
    fields = dict.fromkeys(name for row in rows for name in row)
    check_columns(path, fields)
    names = [name for name in fields if source.wants_part_of(name)]
    recording.others = tuple(name for name in fields if name not in names)
    source.memory.take(len(rows) * len(names) * 8)
    for name, values, numbers in (_sparse if _is_sparse(rows, names) else _dense)(rows, names):
        if set(map(type, values)) == {list}:
            _take_matrix(source, recording, len(rows), name, values, numbers)
        else:
            _take(recording, len(rows), name, values, numbers)
    return [recording]


def write(path: Path, recording: Recording, *, overwrite: bool) -> None:
    """Write a list of rows with enough digits to read back the same float64; NaN is null.

    Raises `RecordingError`: a value is infinite, which JSON cannot hold; `OSError`: the file exists, unless
    ``overwrite``, or cannot be written.
    """
    for name, values in recording.columns.items():
        if np.isinf(values).any():
            raise RecordingError(f"{path}: {name} is infinite in row {int(np.argmax(np.isinf(values)))}: not in JSON")
    names = list(recording.columns)
    with open_new(path, overwrite=overwrite) as file:
        separator = b"[\n"
        for start in range(0, len(recording), _ROWS_AT_ONCE):
            block = [values[start : start + _ROWS_AT_ONCE] for values in recording.columns.values()]
            for row in np.stack(block, axis=1).tolist():
                fields = {name: None if value != value else value for name, value in zip(names, row, strict=True)}
                file.write(separator + json.dumps(fields).encode())
                separator = b",\n"
        file.write(b"\n]\n" if len(recording) else b"[]\n")


_EXPECTED = 'a list of rows belongs here, [{"time_s": 0.0, "torque": 1.5}, ...], or an object with such a list in it'


def _is_rows(value: Any) -> bool:
    return isinstance(value, list) and bool(value) and isinstance(value[0], dict)


def _parse(source: Source, problems: list[str]) -> Any:
    path = source.path
    data = path.read_bytes()
    source.memory.take(_OBJECTS * len(data))
    if not data:
        raise RecordingError(f"{path} is empty")
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        if error.start < len(data) - 3:
            raise RecordingError(f"{path} is not a UTF-8 text file (byte {error.start})") from None
        text = data[: error.start].decode("utf-8-sig")  # cut within a character
    try:
        return json_text.parse(text)
    except json.JSONDecodeError as error:
        repaired = _repaired(text)
        if repaired is None or error.pos < text.rstrip().rfind("}"):
            raise RecordingError(f"{path}:{error.lineno}: is no JSON: {error.msg} (column {error.colno})") from None
        problems.append(f"the file was cut off at byte {len(data)}: the rows after its last whole one are lost")
        return repaired
    except ValueError as error:
        raise RecordingError(f"{path}: {error}") from None


def _repaired(text: str) -> Any:
    """Parse a text that was cut off up to its last whole row; return None if it has none."""
    end = len(text)
    for _ in range(3):  # a brace may be part of a string or of an inner object
        end = text.rfind("}", 0, end)
        if end < 0:
            return None
        for closing in _CLOSINGS:
            try:
                return json_text.parse(text[: end + 1] + closing)
            except ValueError:
                continue
    return None


def _is_sparse(rows: list[dict[str, Any]], names: list[str]) -> bool:
    """True if most fields are missing."""
    return 4 * sum(map(len, rows)) < len(rows) * len(names)


def _dense(rows: list[dict[str, Any]], names: list[str]) -> Iterator[tuple[str, list[Any], None]]:
    """Yield name and values of each column."""
    for name in names:
        yield name, [row.get(name) for row in rows], None


def _sparse(rows: list[dict[str, Any]], names: list[str]) -> Iterator[tuple[str, list[Any], list[int]]]:
    """Yield name, values and their rows of each column, in a time proportional to the number of values."""
    found: dict[str, tuple[list[Any], list[int]]] = {name: ([], []) for name in names}
    for number, row in enumerate(rows):
        for name, value in row.items():
            if name in found:
                found[name][0].append(value)
                found[name][1].append(number)
    for name, (values, numbers) in found.items():
        yield name, values, numbers


def _take_matrix(
    source: Source, recording: Recording, length: int, name: str, values: list[list[Any]], numbers: list[int] | None
) -> None:
    """Add the columns of a field that is a list of numbers in each row; a row without it is NaN."""
    width = len(values[0])
    wrong = next((i for i, each in enumerate(values) if len(each) != width), None)
    if wrong is not None or not 0 < width <= MOST_WIDE:
        count = width if wrong is None else f"{width} and {len(values[wrong])}"
        recording.problems.append(f"{name} is a list of {count} values, not of 1 to {MOST_WIDE} in each row: left out")
        return
    for i in range(width):
        column = f"{name}[:,{i}]"
        if source.wants(column):
            _take(recording, length, column, [each[i] for each in values], numbers)
        else:
            recording.others += (column,)


def _take(recording: Recording, length: int, name: str, values: list[Any], numbers: list[int] | None) -> None:
    """Add one column of ``length`` rows; report a field that is not a number."""
    if not set(map(type, values)) <= _NUMBERS:
        place = next(i for i, value in enumerate(values) if type(value) not in _NUMBERS)
        row = place if numbers is None else numbers[place]
        recording.problems.append(f"{name} is no number in row {row} but {brief(values[place])}: left out")
        return
    known = np.array(values, dtype=np.float64)
    if numbers is None:
        recording.columns[name] = known
    else:
        recording.columns[name] = np.full(length, np.nan)
        recording.columns[name][numbers] = known
