"""Read and write JSON: a list of rows, each an object, or an object with such a list and metadata."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from friction_hil.errors import RecordingError
from friction_hil.recordings.recording import Recording
from friction_hil.recordings.source import Source, open_new

_CLOSINGS = ("]", "]}")
_ROWS_AT_ONCE = 10_000


def read(source: Source) -> list[Recording]:
    """Read the longest list of objects in the file; the other top-level entries become the metadata.

    A missing field and null are NaN; true and false are 1 and 0. A file that was cut off is read up to its last whole
    row.

    Raises
    ------
    RecordingError
        The file is not JSON, or has no list of rows.
    OSError
        The file cannot be opened.
    """
    path, problems = source.path, list[str]()
    content = _parse(path, problems)
    metadata: dict[str, Any] = {}
    rows = content
    if isinstance(content, dict):
        lists = [key for key, value in content.items() if _is_rows(value)]
        if not lists:
            raise RecordingError(f"{path}: {_EXPECTED}; this object has {', '.join(map(repr, content)) or 'nothing'}")
        key = max(lists, key=lambda each: len(content[each]))
        problems += [f"the list {other!r} is shorter than {key!r}: left out" for other in lists if other != key]
        metadata, rows = {name: value for name, value in content.items() if name not in lists}, content[key]
    if not _is_rows(rows):
        raise RecordingError(f"{path}: {_EXPECTED}")
    recording = Recording(str(path), source.name, {}, metadata, problems)
    for number, row in enumerate(rows):
        if not isinstance(row, dict):
            raise RecordingError(f"{path}: row {number} is not an object of fields but {_brief(row)}")
    names, recording.others = source.split(dict.fromkeys(name for row in rows for name in row))
    for name in names:
        _take(recording, rows, name)
    return [recording]


def write(path: Path, recording: Recording, *, overwrite: bool) -> None:
    """Write a list of rows with enough digits to read back the same float64; NaN is null.

    Raises
    ------
    RecordingError
        A value is infinite, which JSON cannot hold.
    OSError
        The file exists, unless ``overwrite``, or cannot be written.
    """
    for name, values in recording.columns.items():
        if np.isinf(values).any():
            raise RecordingError(f"{path}: {name} is infinite in row {int(np.argmax(np.isinf(values)))}: not in JSON")
    names = list(recording.columns)
    values = np.stack(list(recording.columns.values()), axis=1)
    with open_new(path, overwrite=overwrite) as file:
        separator = b"[\n"
        for start in range(0, len(values), _ROWS_AT_ONCE):
            for row in values[start : start + _ROWS_AT_ONCE].tolist():
                fields = {name: None if value != value else value for name, value in zip(names, row, strict=True)}
                file.write(separator + json.dumps(fields).encode())
                separator = b",\n"
        file.write(b"\n]\n" if len(values) else b"[]\n")


_EXPECTED = 'a list of rows belongs here, [{"time_s": 0.0, "torque": 1.5}, ...], or an object with such a list in it'


def _is_rows(value: Any) -> bool:
    return isinstance(value, list) and bool(value) and isinstance(value[0], dict)


def _parse(path: Path, problems: list[str]) -> Any:
    data = path.read_bytes()
    if not data:
        raise RecordingError(f"{path} is empty")
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        if error.start < len(data) - 3:
            raise RecordingError(f"{path} is not a UTF-8 text file (byte {error.start})") from None
        text = data[: error.start].decode("utf-8-sig")  # cut within a character
    try:
        return json.loads(text)
    except json.JSONDecodeError as error:
        repaired = _repaired(text)
        if repaired is None or error.pos < text.rstrip().rfind("}"):
            raise RecordingError(f"{path}:{error.lineno}: is no JSON: {error.msg} (column {error.colno})") from None
        problems.append(f"the file was cut off at byte {len(data)}: the rows after its last whole one are lost")
        return repaired
    except RecursionError:
        raise RecordingError(f"{path}: its lists and objects are nested too deeply") from None


def _repaired(text: str) -> Any:
    """Parse a text that was cut off up to its last whole row; return None if it has none."""
    end = len(text)
    for _ in range(3):  # a brace may be part of a string or of an inner object
        end = text.rfind("}", 0, end)
        if end < 0:
            return None
        for closing in _CLOSINGS:
            try:
                return json.loads(text[: end + 1] + closing)
            except (json.JSONDecodeError, RecursionError):
                continue
    return None


def _take(recording: Recording, rows: list[Mapping[str, Any]], name: str) -> None:
    """Add one column; report a field that is not a number."""
    values = [row.get(name) for row in rows]
    try:
        recording.columns[name] = np.array(values, dtype=np.float64)
        if not any(isinstance(value, str) for value in values):
            return
    except (TypeError, ValueError, OverflowError):
        pass
    recording.columns.pop(name, None)
    number, value = next((i, v) for i, v in enumerate(values) if not (v is None or isinstance(v, int | float)))
    recording.problems.append(f"{name} is no number in row {number} but {_brief(value)}: left out")


def _brief(value: Any) -> str:
    text = json.dumps(value)
    return text if len(text) <= 40 else text[:37] + "..."
