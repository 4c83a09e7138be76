"""Read and write text: numbers in columns, in CSV below a header of their names."""

import csv
import io
import re
from pathlib import Path

import numpy as np

from friction_hil.errors import RecordingError
from friction_hil.recordings.recording import Array, Recording
from friction_hil.recordings.source import Source, as_column, open_new
from friction_hil.recordings.text_layout import BLANKS, DECIMAL_COMMA, is_number, is_value, layout_of, not_text, split

_ROWS_AT_ONCE = 10_000
_LONGEST_SHOWN = 40  # characters of a field that is no number
_MISSING = ["", "nan", "NaN", "NAN", "-nan"]
_MARKS = {",": "comma", ".": "point"}


def read(source: Source) -> list[Recording]:
    """Read a text file: comma, semicolon, tab or blanks; a first line of names; ``#`` starts a comment line.

    Columns without names are ``column1``, ``column2``, ... (`layout_of`). An empty field is NaN. If no comma separates
    them, numbers may have a decimal comma. A last line without a line end is read if it has a number in each column.

    Raises
    ------
    RecordingError
        The file is not text, its header has a name twice, or a field is not a number; the message names the line.
    OSError
        It cannot be opened.
    """
    path, problems = source.path, list[str]()
    data = path.read_bytes()
    layout = layout_of(path, data)
    start, number, names, delimiter = layout.start, layout.line, layout.names, layout.delimiter
    rows = memoryview(data)[start : _end(data, start, len(names), delimiter, problems)]
    wanted, others = source.split(names)
    source.memory.take(data.count(b"\n") * len(names) * 8)
    recording = Recording(str(path), source.name, {}, problems=problems, others=others)
    if delimiter is BLANKS:  # which pyarrow does not know
        values = _by_numpy(rows, names, wanted, delimiter)
    elif delimiter != "," and _has_decimal_commas(rows):
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


def _end(data: bytes, start: int, columns: int, delimiter: str | None, problems: list[str]) -> int:
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
        if end == len(data) and len(fields) == columns and all(map(is_value, fields)):
            problems.append(f"{line}: its row is read; if the file was cut off there, its last value is wrong")
            return end
        problems.append(f"{line}, so the file may have been cut off in it: that row is left out")
        return begin
    return end


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


def _by_numpy(rows: memoryview, names: list[str], wanted: list[str], delimiter: str | None) -> dict[str, Array] | None:
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
    path: Path, rows: memoryview, header: int, names: list[str], wanted: list[str], delimiter: str | None
) -> dict[str, Array]:
    """Read field by field, in order to report the first one that cannot be read."""
    try:
        lines = bytes(rows).decode("utf-8").splitlines()
    except UnicodeDecodeError as error:
        raise not_text(path, len(path.read_bytes()) - len(rows) + error.start) from None
    blocks: list[Array] = []
    values: list[list[float]] = []
    mark = ""  # the decimal sign of the file, once one has been seen
    for number, line in enumerate(lines, header + 1):
        if not line.strip() or line.startswith("#"):
            continue
        try:
            fields = split(line, delimiter)
        except csv.Error as error:
            raise RecordingError(f"{path}:{number}: cannot be read: {error}") from None
        if len(fields) != len(names):
            what = "the first row has" if names[0] == "column1" else "the header names"
            raise RecordingError(f"{path}:{number}: {len(fields)} fields, but {what} {len(names)}")
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


def _number(path: Path, line: int, name: str, text: str, delimiter: str | None) -> float:
    """Return the value of a field; NaN if it is empty."""
    if not text.strip():
        return np.nan
    plain = text.replace(",", ".") if delimiter != "," and DECIMAL_COMMA.fullmatch(text) else text
    if not is_number(plain):
        shown = text if len(text) <= _LONGEST_SHOWN else f"{text[:_LONGEST_SHOWN]}..."
        raise RecordingError(f"{path}:{line}: {name}: {shown!r} is not a number{_hint(text)}")
    return float(plain)


def _hint(text: str) -> str:
    if not DECIMAL_COMMA.fullmatch(text):
        return ""
    return "; decimal commas need semicolons or tabs between the fields, or write the decimal comma as a point"
