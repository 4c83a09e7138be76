"""Read and write text: numbers in columns, in CSV below a header of their names."""

import csv
import io
import re
from pathlib import Path

import numpy as np

from friction_hil.errors import RecordingError
from friction_hil.recordings.dates import seconds
from friction_hil.recordings.recording import Array, Recording
from friction_hil.recordings.source import Source, as_column, open_new
from friction_hil.recordings.text_block import block_layout
from friction_hil.recordings.text_layout import (
    BLANKS,
    DATE,
    DECIMAL_COMMA,
    EMPTY,
    FLAG,
    FLAGS,
    NUMBER,
    TEXT,
    TIME_ROW,
    TextLayout,
    agrees,
    is_comment,
    is_missing,
    is_number,
    is_value,
    layout_of,
    split,
)

_ROWS_AT_ONCE = 10_000
_LONGEST_SHOWN = 40  # characters of a field that is no number
_MISSING = ["", "nan", "NaN", "NAN", "-nan", "NULL", "null", "None", "N/A", "n/a", "NA", "#N/A", "-", "--", "---"]
_MARKS = {",": "comma", ".": "point"}
_END_MARK = b"EOF"  # with which a scope may end its file
_NAMED = 10  # columns of text in a message
_LONGEST_GAP = 10  # periods of a channel: beyond, its values between two rows are not known
_BOM = b"\xef\xbb\xbf"
_UTF_16 = {b"\xff\xfe": "utf-16-le", b"\xfe\xff": "utf-16-be"}
_SAMPLE = 400  # bytes that show the zeros of UTF-16 without a mark
_ZEROS = 0.8  # of every second byte
_MOST_SPECIAL = 0.1  # of the bytes of a cp1252 text that are not ASCII; a binary file has more
_CONTROL = bytes(set(range(32)) - set(b"\0\t\n\f\r"))


def read(source: Source) -> list[Recording]:
    """Read a text file: comma, semicolon, tab or blanks; a line of names; ``#`` starts a comment line.

    Lines above the names, a line of units below them, dates and columns of text are found (`block_layout`). Columns
    without names are ``column1``, ``column2``, ... An empty field is NaN. If no comma separates them, numbers may have
    a decimal comma. A last line without a line end is read if it has a number in each column. Raises `RecordingError`:
    the file is not text, or a field is not a number; the message names the line; `OSError`: it cannot be opened.
    """
    path, problems = source.path, list[str]()
    data = as_utf_8(path, path.read_bytes(), problems)
    layout = layout_of(path, data)
    if not agrees(layout, data):
        layout = block_layout(path, data) or layout
    rows = _rows(data, layout, problems)
    source.memory.take(data.count(b"\n") * len(layout.names) * 8)
    columns = _columns_of(layout)
    wanted = columns if layout.has_own_times else source.split(columns)[0]
    values = _quickly(layout, rows, wanted)
    if values is None and (other := block_layout(path, data)) is not None and _has_more_kinds(other, layout):
        layout, rows = other, _rows(data, other, [])
        columns = _columns_of(layout)
        wanted = columns if layout.has_own_times else source.split(columns)[0]
        values = _quickly(layout, rows, wanted)
    recording = Recording(str(path), source.name, {}, problems=problems)
    recording.columns = _by_field(path, rows, layout, wanted) if values is None else values
    recording.units = {name: unit for name, unit in layout.units.items() if name in recording.columns}
    recording.others = tuple(name for name in columns if name not in recording.columns)
    recording.labels, recording.texts, recording.rate_hz = layout.labels, layout.texts, layout.rate_hz
    problems += layout.problems
    _note_texts(layout.texts, problems)
    for name, kind in zip(layout.names, layout.kinds, strict=True):
        if kind == DATE and name in recording.columns:
            recording.units[name] = "s"
            problems.append(f"{name} holds dates or times of day: read as seconds since the first")
        if name == TIME_ROW and kind == NUMBER and name in recording.columns:
            recording.units[name] = "ns"
    if layout.has_own_times:
        _join_channels(recording, layout)
    return [recording]


def _has_more_kinds(other: TextLayout, layout: TextLayout) -> bool:
    """True if another layout has the same names, and columns that hold something else than numbers."""
    return not other.is_plain and [name for name in other.names if not name.startswith("\0")] == layout.names


def _columns_of(layout: TextLayout) -> list[str]:
    """Return the names of the columns of values, without those of text and those behind separators at line ends."""
    pairs = zip(layout.names, layout.kinds, strict=True)
    return [name for name, kind in pairs if kind != TEXT and not name.startswith("\0")]


def _quickly(layout: TextLayout, rows: memoryview, wanted: list[str]) -> dict[str, Array] | None:
    """Read with a library; None if none here can."""
    if layout.delimiter is BLANKS:  # which pyarrow does not know
        return _by_numpy(rows, layout, wanted)
    if layout.delimiter != "," and _has_decimal_commas(rows, layout):
        return _by_arrow(rows, layout, wanted, ",")
    return _by_arrow(rows, layout, wanted) or _by_numpy(rows, layout, wanted)


def _note_texts(texts: dict[str, str], problems: list[str]) -> None:
    if texts:
        named = ", ".join(f"{name} ({_shown(text)})" for name, text in list(texts.items())[:_NAMED])
        more = f" and {len(texts) - _NAMED} more" if len(texts) > _NAMED else ""
        problems.append(f"columns of text are left out: {named}{more}")


def _join_channels(recording: Recording, layout: TextLayout) -> None:
    """Bring channels that have a time each to the time of the one with the most rows."""
    pairs = list(zip(layout.names[::2], layout.names[1::2], strict=True))
    there = [(clock, name) for clock, name in pairs if clock in recording.columns and name in recording.columns]
    main, _ = max(there, key=lambda pair: int(np.isfinite(recording.columns[pair[0]]).sum()))
    time = recording.columns[main]
    is_row = np.isfinite(time)
    time = time[is_row]
    columns = {layout.names[0]: time}
    moved = []
    for clock, name in there:
        own, values = recording.columns[clock], recording.columns[name]
        if np.array_equal(own[is_row], time):
            columns[name] = values[is_row]
            continue
        known = np.flatnonzero(np.isfinite(own) & np.isfinite(values))
        columns[name] = np.full(len(time), np.nan)
        if known.size:
            columns[name] = np.interp(time, own[known], values[known], left=np.nan, right=np.nan)
            _forget_gaps(columns[name], time, own[known])
        moved.append(name)
    units = recording.units
    recording.units = {name: units[name] for name in columns if name in units}
    if clock_unit := units.get(main) or units.get(layout.names[0]):
        recording.units[layout.names[0]] = clock_unit
    recording.columns, recording.others = columns, ()
    if moved:
        recording.problems.append(
            f"channels with a time of their own are interpolated at that of {main}: {', '.join(moved)}"
        )


def _forget_gaps(values: Array, time: Array, own: Array) -> None:
    steps = np.diff(own)
    if steps.size:
        at = np.clip(np.searchsorted(own, time), 1, len(steps))
        is_between = (time > own[at - 1]) & (time < own[at])
        values[is_between & (steps[at - 1] > _LONGEST_GAP * np.median(steps))] = np.nan


def write(path: Path, recording: Recording, *, overwrite: bool) -> None:
    """Write the columns with enough digits to read back the same float64.

    Raises `OSError`: the file exists, unless ``overwrite``, or cannot be written.
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


def _rows(data: bytes, layout: TextLayout, problems: list[str]) -> memoryview:
    """Return the bytes of the rows; report what follows them, and a last row without line end."""
    start, end = layout.start, len(data)
    while end > start and data[end - 1] == 0:
        end -= 1
    if end < len(data):
        problems.append(f"the file ends in {len(data) - end} zero bytes, as a crash leaves them: left out")
    tail = data[max(start, end - 16) : end].rstrip()
    if tail.endswith(b"\n" + _END_MARK):
        end = data.rfind(_END_MARK, start, end)
    elif end > start and data[end - 1 : end] not in (b"\n", b"\r"):
        begin = max(start, data.rfind(b"\n", start, end) + 1)
        number = data.count(b"\n", 0, begin) + 1
        line = f"line {number} has no line end"
        fields = data[begin:end].decode("utf-8", "replace").split(layout.delimiter)
        fits = [is_value(text) or kind != NUMBER for text, kind in zip(fields, layout.kinds, strict=False)]
        if end == len(data) and len(fields) == len(layout.names) and all(fits):
            problems.append(f"{line}: its row is read; if the file was cut off there, its last value is wrong")
        else:
            problems.append(f"{line}, so the file may have been cut off in it: that row is left out")
            end = begin
    return memoryview(data)[start:end]


def _has_decimal_commas(rows: memoryview, layout: TextLayout) -> bool:
    """True if there is a comma, but no point, in rows whose fields are separated by something else."""
    data = bytes(rows)
    if not layout.is_plain:  # a text or a date may have either
        numbers = [i for i, kind in enumerate(layout.kinds) if kind == NUMBER]
        lines = [line.split(layout.delimiter) for line in data[:100_000].decode("utf-8", "replace").splitlines()[:1000]]
        fields = [line[i] for line in lines for i in numbers if i < len(line)]
        return any("," in each for each in fields) and not any("." in each for each in fields)
    return b"," in data and not (b"." in data and re.search(rb"^[^#\r\n]*\.", data, re.MULTILINE))


def _by_arrow(
    rows: memoryview, layout: TextLayout, wanted: list[str], decimal_point: str = "."
) -> dict[str, Array] | None:
    """Read with pyarrow, ten times as fast as numpy; None if it is not installed or refuses the file."""
    try:  # imported here: an optional package
        import pyarrow
        from pyarrow import csv as arrow_csv
    except ImportError:
        return None
    kinds = dict(zip(layout.names, layout.kinds, strict=True))
    if not len(rows) or FLAG in kinds.values():
        return None
    try:
        table = arrow_csv.read_csv(
            pyarrow.BufferReader(pyarrow.py_buffer(rows)),
            read_options=arrow_csv.ReadOptions(column_names=layout.names),
            parse_options=arrow_csv.ParseOptions(delimiter=layout.delimiter, quote_char=False),
            convert_options=arrow_csv.ConvertOptions(
                column_types={
                    name: pyarrow.float64() if kind in (NUMBER, EMPTY) else pyarrow.string()
                    for name, kind in kinds.items()
                },
                null_values=_MISSING,
                include_columns=wanted,
                decimal_point=decimal_point,
            ),
        )
    except pyarrow.ArrowException:
        return None
    found = {}
    for name in wanted:
        column = table.column(name)
        if kinds[name] != DATE:
            found[name] = as_column(column.to_numpy())
            continue
        dates = seconds([(text or "").strip().strip('"') for text in column.to_pylist()])
        if dates is None:
            return None
        found[name] = dates
    return found


def _by_numpy(rows: memoryview, layout: TextLayout, wanted: list[str]) -> dict[str, Array] | None:
    """Read with numpy; None if it refuses the file."""
    if not layout.is_plain or (not bytes(rows[:64]).strip() and not bytes(rows).strip()):
        return None  # numpy would warn about an empty file
    names = layout.names
    try:
        values = np.loadtxt(
            io.TextIOWrapper(io.BytesIO(rows), encoding="utf-8"),
            delimiter=layout.delimiter,
            comments="#",
            ndmin=2,
            unpack=True,
        )
    except ValueError:
        return None
    if len(values) != len(names) or not values.size:
        return None
    return {name: as_column(values[names.index(name)]) for name in wanted}


def _by_field(path: Path, rows: memoryview, layout: TextLayout, wanted: list[str]) -> dict[str, Array]:
    """Read field by field, in order to report the first one that cannot be read."""
    names, delimiter, width = layout.names, layout.delimiter, len(layout.names)
    blocks: list[Array] = []
    values: list[list[float]] = []
    dates: dict[int, list[str]] = {i: [] for i, kind in enumerate(layout.kinds) if kind == DATE}
    numbers = [i for i, kind in enumerate(layout.kinds) if kind in (NUMBER, EMPTY, FLAG)]
    first_date = layout.line + 1
    mark = ""  # the decimal sign of the file, once one has been seen
    for number, line in enumerate(bytes(rows).decode("utf-8").splitlines(), layout.line + 1):
        if not line.strip() or is_comment(line):
            continue
        try:
            fields = split(line, delimiter)
        except csv.Error as error:
            raise RecordingError(f"{path}:{number}: cannot be read: {error}") from None
        if layout.has_own_times:
            fields += [""] * (width - len(fields))  # channels that end before the others
        if len(fields) != width and (len(fields) < width or any(each.strip() for each in fields[width:])):
            named = sum(not name.startswith("\0") for name in names)
            what = "the first row has" if names[0] == "column1" else "the header names"
            raise RecordingError(f"{path}:{number}: {len(fields)} fields, but {what} {named}")
        row = [np.nan] * width
        for i in numbers:
            row[i] = _number(path, number, names[i], fields[i], layout)
            for own in ",.":
                if delimiter != "," and own in fields[i]:
                    if mark not in ("", own):
                        raise RecordingError(
                            f"{path}:{number}: has a decimal {_MARKS[own]}; lines before, a {_MARKS[mark]}"
                        )
                    mark = own
        for i, texts in dates.items():
            texts.append(fields[i].strip())
        values.append(row)
        if len(values) == _ROWS_AT_ONCE:
            blocks.append(np.array(values))
            values = []
    table = np.concatenate([*blocks, np.array(values, dtype=np.float64).reshape(-1, width)])
    for i, texts in dates.items():
        parsed = seconds(texts)
        if parsed is None:
            raise RecordingError(
                f"{path}:{first_date}: {names[i]}: begins with {_shown(texts[0])}, and not all its fields are dates or "
                "times of this form"
            )
        table[:, i] = parsed
    places = {name: i for i, name in enumerate(names)}
    return {name: as_column(table[:, places[name]]) for name in wanted}


def _number(path: Path, line: int, name: str, text: str, layout: TextLayout) -> float:
    """Return the value of a field; NaN if it is empty."""
    if is_missing(text):
        return np.nan
    flag = FLAGS.get(text.strip().lower())
    if flag is not None:
        return flag
    plain = text.replace(",", ".") if layout.delimiter != "," and DECIMAL_COMMA.fullmatch(text) else text
    if not is_number(plain):
        raise RecordingError(f"{path}:{line}: {name}: {_shown(text)} is not a number{_hint(text)}")
    return float(plain)


def _shown(text: str) -> str:
    return repr(text if len(text) <= _LONGEST_SHOWN else f"{text[:_LONGEST_SHOWN]}...")


def _hint(text: str) -> str:
    if not DECIMAL_COMMA.fullmatch(text):
        return ""
    return "; decimal commas need semicolons or tabs between the fields, or write the decimal comma as a point"


def as_utf_8(path: Path, data: bytes, problems: list[str]) -> bytes:
    """Return the text as UTF-8 without a mark; say in ``problems`` if that took a guess.

    Raises `RecordingError`: the bytes are no text.
    """
    mark = _UTF_16.get(data[:2])
    encoding = mark or (0 in data[:_SAMPLE] and _utf_16_without_mark(data[:_SAMPLE]))
    if encoding:
        try:
            return data[2 if mark else 0 :].decode(encoding).encode()
        except UnicodeError as error:
            raise RecordingError(f"{path} begins as {encoding.upper()} text, and then is none ({error})") from None
    data = data.removeprefix(_BOM)
    try:
        data.decode()
    except UnicodeDecodeError as error:
        if not _may_be_cp1252(data):
            raise not_text(path, error.start) from None
    else:
        return data
    try:
        text = data.decode("cp1252")
    except UnicodeDecodeError as error:
        raise not_text(path, error.start) from None
    problems.append("the text is not UTF-8 and is read as cp1252 (Windows, Western Europe)")
    return text.encode()


def not_text(path: Path, byte: int) -> RecordingError:
    """Return the error for a file that is no text."""
    return RecordingError(f"{path} is not a UTF-8 text file (byte {byte}), nor UTF-16 or cp1252")


def _utf_16_without_mark(head: bytes) -> str:
    if len(head) < 4:
        return ""
    for encoding, zeros, others in ("utf-16-le", head[1::2], head[::2]), ("utf-16-be", head[::2], head[1::2]):
        if zeros.count(0) >= _ZEROS * len(zeros) and 0 not in others:
            return encoding
    return ""


def _may_be_cp1252(data: bytes) -> bool:
    special = len(data) - len(data.translate(None, bytes(range(128, 256))))
    return special <= _MOST_SPECIAL * len(data) and len(data.translate(None, _CONTROL)) == len(data)
