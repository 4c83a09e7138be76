"""Read and write CSV: a header of column names, then numbers."""

import csv
import io
from pathlib import Path

import numpy as np

from friction_hil.errors import RecordingError
from friction_hil.recordings.recording import Array, Recording

_DELIMITERS = ",;\t"
_ROWS_AT_ONCE = 10_000


def read_csv(path: Path, axis: str) -> Recording:
    """Read a CSV file: comma, semicolon or tab; a first line of names; ``#`` starts a comment line.

    An empty field is NaN.

    Raises
    ------
    RecordingError
        The file is not text, has no header or a header with a name twice, or a field is not a number; the
        message has the line.
    OSError
        It cannot be opened.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise RecordingError(f"{path} is not a UTF-8 text file (byte {error.start})") from None
    lines = text.splitlines()
    header = next((i for i, line in enumerate(lines) if line.strip() and not line.startswith("#")), None)
    if header is None:
        raise RecordingError(f"{path} is empty: a line of column names and rows of numbers belong here")
    delimiter = max(_DELIMITERS, key=lines[header].count)
    names = _names(path, header + 1, lines[header], delimiter)
    values = _numbers(path, lines, header + 1, names, delimiter)
    return Recording(str(path), axis, {name: values[i].copy() for i, name in enumerate(names)})


def write_csv(path: Path, recording: Recording, *, overwrite: bool) -> None:
    """Write the columns with as many digits as give back the same float64.

    Raises
    ------
    OSError
        The file exists, unless ``overwrite``, or cannot be written.
    """
    values = np.stack(list(recording.columns.values()), axis=1)
    with path.open("w" if overwrite else "x", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(recording.columns)
        for start in range(0, len(values), _ROWS_AT_ONCE):
            writer.writerows(values[start : start + _ROWS_AT_ONCE].tolist())


def _names(path: Path, number: int, line: str, delimiter: str) -> list[str]:
    names = [name.strip() for name in next(csv.reader([line], delimiter=delimiter))]
    if all(_is_number(name) for name in names):
        raise RecordingError(f"{path}:{number}: the first line must name the columns; it holds numbers")
    for name in names:
        if not name:
            raise RecordingError(f"{path}:{number}: column {names.index(name) + 1} has no name")
        if names.count(name) > 1:
            raise RecordingError(f"{path}:{number}: column {name!r} is there {names.count(name)} times")
    return names


def _numbers(path: Path, lines: list[str], start: int, names: list[str], delimiter: str) -> Array:
    """Shape (columns, rows). numpy's parser is fast; what it refuses, the careful one reads or names."""
    rows = lines[start:]
    if not any(rows):
        return np.empty((len(names), 0))
    try:
        values = np.loadtxt(io.StringIO("\n".join(rows)), delimiter=delimiter, comments="#", ndmin=2, unpack=True)
    except ValueError:
        return _carefully(path, rows, start, names, delimiter)
    if len(values) != len(names):
        return _carefully(path, rows, start, names, delimiter)
    return np.asarray(values, dtype=np.float64)


def _carefully(path: Path, rows: list[str], start: int, names: list[str], delimiter: str) -> Array:
    values = []
    for number, line in enumerate(rows, start + 1):
        if not line.strip() or line.startswith("#"):
            continue
        fields = next(csv.reader([line], delimiter=delimiter))
        if len(fields) != len(names):
            raise RecordingError(f"{path}:{number}: {len(fields)} fields, but the header names {len(names)}")
        for name, text in zip(names, fields, strict=True):
            if text.strip() and not _is_number(text):
                raise RecordingError(f"{path}:{number}: {name}: {text!r} is not a number{_hint(text)}")
        values.append([float(text) if text.strip() else np.nan for text in fields])
    return np.array(values, dtype=np.float64).reshape(-1, len(names)).T


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return "_" not in text


def _hint(text: str) -> str:
    return "; write the decimal comma as a point" if _is_number(text.replace(",", ".")) else ""
