"""Read and write CSV: a header of column names, then numbers."""

import csv
import io
import re
from collections import Counter
from pathlib import Path

import numpy as np

from friction_hil.errors import RecordingError
from friction_hil.recordings.bounds import check_columns
from friction_hil.recordings.recording import Array, Recording
from friction_hil.recordings.source import Source, as_column, open_new

_DELIMITERS = ",;\t"
_ROWS_AT_ONCE = 10_000
_LONGEST_SHOWN = 40  # characters of a field that is no number
_BOM = b"\xef\xbb\xbf"
_MISSING = ["", "nan", "NaN", "NAN", "-nan"]
_MARKS = {",": "comma", ".": "point"}
_SEPARATOR_LINE = re.compile(r"sep=.")  # with which Excel says what separates the fields
_DECIMAL_COMMA = re.compile(r"\s*[-+]?(?:[0-9]+,[0-9]*|,[0-9]+)(?:[eE][-+]?[0-9]+)?\s*")


def read(source: Source) -> list[Recording]:
    """Read a CSV file: comma, semicolon or tab; a first line of names; ``#`` starts a comment line.

    An empty field is NaN. Between semicolons or tabs, numbers may have a decimal comma. A last line without a line end
    is read if it has a number in each column.

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
    delimiter = max(_DELIMITERS, key=header.count)
    names = _names(path, number, header, delimiter)
    rows = memoryview(data)[start : _end(data, start, len(names), delimiter, problems)]
    wanted, others = source.split(names)
    source.memory.take(data.count(b"\n") * len(names) * 8)
    recording = Recording(str(path), source.name, {}, problems=problems, others=others)
    if delimiter != "," and _has_decimal_commas(rows):
        values = _by_arrow(rows, names, wanted, delimiter, ",")
    else:
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
    with (
        open_new(path, overwrite=overwrite) as opened,
        io.TextIOWrapper(opened, encoding="utf-8", newline="") as file,
    ):
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(recording.columns)
        for start in range(0, len(recording), _ROWS_AT_ONCE):
            block = [values[start : start + _ROWS_AT_ONCE] for values in recording.columns.values()]
            writer.writerows(np.stack(block, axis=1).tolist())


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
        text = line.strip("\0 \t\r\n")
        if text and not line.startswith("#") and not _SEPARATOR_LINE.fullmatch(text):
            return offset, number, line.rstrip("\r\n")
    raise RecordingError(f"{path} is empty: a line of column names and rows of numbers belong here")


def _end(data: bytes, start: int, columns: int, delimiter: str, problems: list[str]) -> int:
    """Return the offset at which the last row ends; report what follows it, and a last row without line end."""
    end = len(data)
    while end > start and data[end - 1] == 0:
        end -= 1
    if end < len(data):
        problems.append(f"the file ends in {len(data) - end} zero bytes, as a crash leaves them: left out")
    if end > start and data[end - 1 : end] not in (b"\n", b"\r"):
        begin = max(start, data.rfind(b"\n", start, end) + 1)
        number = data.count(b"\n", 0, begin) + 1
        line = f"line {number} has no line end"
        fields = data[begin:end].decode("utf-8", "replace").split(delimiter)
        if end == len(data) and len(fields) == columns and all(map(_is_value, fields)):
            problems.append(f"{line}: its row is read; if the file was cut off there, its last value is wrong")
            return end
        problems.append(f"{line}, so the file may have been cut off in it: that row is left out")
        return begin
    return end


def _names(path: Path, number: int, line: str, delimiter: str) -> list[str]:
    try:
        names = [name.strip() for name in next(csv.reader([line], delimiter=delimiter))]
    except csv.Error as error:
        raise RecordingError(f"{path}:{number}: the line of column names cannot be read: {error}") from None
    check_columns(path, names)
    if all(_is_number(name) for name in names):
        raise RecordingError(f"{path}:{number}: the first line must name the columns; it holds numbers")
    for name, times in Counter(names).items():
        if not name:
            raise RecordingError(f"{path}:{number}: column {names.index(name) + 1} has no name")
        if times > 1:
            raise RecordingError(f"{path}:{number}: column {name!r} is there {times} times")
    return names


def _has_decimal_commas(rows: memoryview) -> bool:
    """True if there is a comma, but no point, in rows whose fields are separated by something else."""
    data = bytes(rows)
    return b"," in data and not (b"." in data and re.search(rb"^[^#\r\n]*\.", data, re.MULTILINE))


def _by_arrow(
    rows: memoryview, names: list[str], wanted: list[str], delimiter: str, decimal_point: str = "."
) -> dict[str, Array] | None:
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
                column_types=dict.fromkeys(names, pyarrow.float64()),
                null_values=_MISSING,
                include_columns=wanted,
                decimal_point=decimal_point,
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
    blocks: list[Array] = []
    values: list[list[float]] = []
    mark = ""  # the decimal sign of the file, once one has been seen
    for number, line in enumerate(lines, header + 1):
        if not line.strip() or line.startswith("#"):
            continue
        try:
            fields = next(csv.reader([line], delimiter=delimiter))
        except csv.Error as error:
            raise RecordingError(f"{path}:{number}: cannot be read: {error}") from None
        if len(fields) != len(names):
            raise RecordingError(f"{path}:{number}: {len(fields)} fields, but the header names {len(names)}")
        values.append([_number(path, number, name, text, delimiter) for name, text in zip(names, fields, strict=True)])
        for own in "," if "," in line else "", "." if "." in line else "":
            if delimiter != "," and own and mark not in ("", own):
                raise RecordingError(f"{path}:{number}: has a decimal {_MARKS[own]}; lines before, a {_MARKS[mark]}")
            mark = own or mark
        if len(values) == _ROWS_AT_ONCE:
            blocks.append(np.array(values))
            values = []
    table = np.concatenate([*blocks, np.array(values, dtype=np.float64).reshape(-1, len(names))])
    places = {name: i for i, name in enumerate(names)}
    return {name: as_column(table[:, places[name]]) for name in wanted}


def _number(path: Path, line: int, name: str, text: str, delimiter: str) -> float:
    """Return the value of a field; NaN if it is empty."""
    if not text.strip():
        return np.nan
    plain = text.replace(",", ".") if delimiter != "," and _DECIMAL_COMMA.fullmatch(text) else text
    if not _is_number(plain):
        shown = text if len(text) <= _LONGEST_SHOWN else f"{text[:_LONGEST_SHOWN]}..."
        raise RecordingError(f"{path}:{line}: {name}: {shown!r} is not a number{_hint(text)}")
    return float(plain)


def _not_text(path: Path, byte: int) -> RecordingError:
    return RecordingError(f"{path} is not a UTF-8 text file (byte {byte})")


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return "_" not in text


def _is_value(text: str) -> bool:
    """True if a field of unknown quoting and decimal sign may be a value; an empty one is."""
    plain = text.strip().strip('"')
    return not plain or _is_number(plain) or _DECIMAL_COMMA.fullmatch(plain) is not None


def _hint(text: str) -> str:
    if not _DECIMAL_COMMA.fullmatch(text):
        return ""
    return "; decimal commas need semicolons or tabs between the fields, or write the decimal comma as a point"
