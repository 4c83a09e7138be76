"""Read and write CSV: a header of column names, then numbers."""

import csv
import io
from pathlib import Path

import numpy as np

from friction_hil.errors import RecordingError
from friction_hil.recordings.recording import Array, Recording
from friction_hil.recordings.source import Source, as_column

_DELIMITERS = ",;\t"
_ROWS_AT_ONCE = 10_000
_BOM = b"\xef\xbb\xbf"
_MISSING = ["", "nan", "NaN", "NAN", "-nan"]


def read(source: Source) -> list[Recording]:
    """Read a CSV file: comma, semicolon or tab; a first line of names; ``#`` starts a comment line.

    An empty field is NaN. A last line without a line end may have been cut off and is left out.

    Raises
    ------
    RecordingError
        The file is not text, has no header, its header has a name twice, or a field is not a number; the message
        names the line.
    OSError
        It cannot be opened.
    """
    path, problems = source.path, list[str]()
    data = path.read_bytes()
    start, number, header = _header(path, data)
    rows = memoryview(data)[start : _end(data, start, problems)]
    delimiter = max(_DELIMITERS, key=header.count)
    names = _names(path, number, header, delimiter)
    wanted, others = source.split(names)
    recording = Recording(str(path), source.name, {}, problems=problems, others=others)
    values = _by_arrow(rows, names, wanted, delimiter) or _by_numpy(rows, names, wanted, delimiter)
    recording.columns = values or _by_field(path, rows, number, names, wanted, delimiter)
    return [recording]


def write(path: Path, recording: Recording, *, overwrite: bool) -> None:
    """Write the columns with enough digits to read back the same float64.

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


def _header(path: Path, data: bytes) -> tuple[int, int, str]:
    """Return the offset of the first row, the line number of the header, and the header."""
    offset, number = len(_BOM) if data.startswith(_BOM) else 0, 0
    while offset < len(data):
        end = data.find(b"\n", offset) + 1 or len(data)
        number += 1
        try:
            line = data[offset:end].decode("utf-8")
        except UnicodeDecodeError as error:
            raise _not_text(path, offset + error.start) from None
        offset = end
        if line.strip("\0 \t\r\n") and not line.startswith("#"):
            return offset, number, line.rstrip("\r\n")
    raise RecordingError(f"{path} is empty: a line of column names and rows of numbers belong here")


def _end(data: bytes, start: int, problems: list[str]) -> int:
    """Return the offset at which the last whole row ends; report what follows it."""
    end = len(data)
    while end > start and data[end - 1] == 0:
        end -= 1
    if end < len(data):
        problems.append(f"the file ends in {len(data) - end} zero bytes, as a crash leaves them: left out")
    if end > start and data[end - 1 : end] not in (b"\n", b"\r"):
        end = max(start, data.rfind(b"\n", start, end) + 1)
        line = data.count(b"\n", 0, end) + 1
        problems.append(f"line {line} has no line end, so the file may have been cut off in it: that row is left out")
    return end


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


def _by_arrow(rows: memoryview, names: list[str], wanted: list[str], delimiter: str) -> dict[str, Array] | None:
    """Read with pyarrow, ten times as fast as numpy; None if it is not installed or refuses the file."""
    try:  # imported here: an optional package
        import pyarrow
        from pyarrow import csv as arrow_csv
    except ImportError:
        return None
    if not len(rows):
        return None
    try:
        table = arrow_csv.read_csv(
            pyarrow.BufferReader(pyarrow.py_buffer(rows)),
            read_options=arrow_csv.ReadOptions(column_names=names),
            parse_options=arrow_csv.ParseOptions(delimiter=delimiter, quote_char=False),
            convert_options=arrow_csv.ConvertOptions(
                column_types=dict.fromkeys(names, pyarrow.float64()), null_values=_MISSING, include_columns=wanted
            ),
        )
    except pyarrow.ArrowException:
        return None
    return {name: as_column(table.column(name).to_numpy()) for name in wanted}


def _by_numpy(rows: memoryview, names: list[str], wanted: list[str], delimiter: str) -> dict[str, Array] | None:
    """Read with numpy; None if it refuses the file."""
    if not bytes(rows[:64]).strip() and not bytes(rows).strip():
        return None  # numpy would warn about an empty file
    try:
        values = np.loadtxt(
            io.TextIOWrapper(io.BytesIO(rows), encoding="utf-8"),
            delimiter=delimiter,
            comments="#",
            ndmin=2,
            unpack=True,
        )
    except ValueError:
        return None
    if len(values) != len(names) or not values.size:
        return None
    return {name: as_column(values[names.index(name)]) for name in wanted}


def _by_field(
    path: Path, rows: memoryview, header: int, names: list[str], wanted: list[str], delimiter: str
) -> dict[str, Array]:
    """Read field by field, in order to report the first one that cannot be read."""
    try:
        lines = bytes(rows).decode("utf-8").splitlines()
    except UnicodeDecodeError as error:
        raise _not_text(path, len(path.read_bytes()) - len(rows) + error.start) from None
    values = []
    for number, line in enumerate(lines, header + 1):
        if not line.strip() or line.startswith("#"):
            continue
        fields = next(csv.reader([line], delimiter=delimiter))
        if len(fields) != len(names):
            raise RecordingError(f"{path}:{number}: {len(fields)} fields, but the header names {len(names)}")
        for name, text in zip(names, fields, strict=True):
            if text.strip() and not _is_number(text):
                raise RecordingError(f"{path}:{number}: {name}: {text!r} is not a number{_hint(text)}")
        values.append([float(text) if text.strip() else np.nan for text in fields])
    table = np.array(values, dtype=np.float64).reshape(-1, len(names))
    return {name: as_column(table[:, names.index(name)]) for name in wanted}


def _not_text(path: Path, byte: int) -> RecordingError:
    return RecordingError(f"{path} is not a UTF-8 text file (byte {byte})")


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return "_" not in text


def _hint(text: str) -> str:
    return "; write the decimal comma as a point" if _is_number(text.replace(",", ".")) else ""
