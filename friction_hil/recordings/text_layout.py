"""Layout of a text file of numbers: names of the columns, what separates them, and where the rows begin. Pure."""

import csv
import re
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from friction_hil.errors import RecordingError
from friction_hil.recordings.bounds import check_columns

BLANKS = None  # what separates columns that stand in line below each other
_DELIMITERS = ",;\t"
_COMMENTS = ("#", "%")
_BOM = b"\xef\xbb\xbf"
_SEPARATOR_LINE = re.compile(r"sep=.")  # with which Excel says what separates the fields
DECIMAL_COMMA = re.compile(r"\s*[-+]?(?:[0-9]+,[0-9]*|,[0-9]+)(?:[eE][-+]?[0-9]+)?\s*")


@dataclass(frozen=True, slots=True)
class TextLayout:
    """Layout of a text file.

    Attributes
    ----------
    start : int
        Offset of the first row, bytes.
    line : int
        Number of the line before the first row.
    names : list of str
        ``column1``, ``column2``, ... where the file has none.
    delimiter : str or None
        What separates the columns; None for blanks.
    """

    start: int
    line: int
    names: list[str]
    delimiter: str | None


def layout_of(path: Path, data: bytes) -> TextLayout:
    """Find the layout of a text file; comment lines begin with ``#`` or ``%``.

    If its first line holds numbers, the names are those of the comment line before it, if that has as many.

    Raises
    ------
    RecordingError
        The file is empty or not text, a name is there twice or missing, or there are too many.
    """
    offset, number, comment = len(_BOM) if data.startswith(_BOM) else 0, 0, ""
    while offset < len(data):
        begin, number = offset, number + 1
        line, offset = _line(path, data, begin)
        text = line.strip("\0 \t\r\n")
        if text.startswith(_COMMENTS):
            comment = text.lstrip("".join(_COMMENTS))
        elif text and not _SEPARATOR_LINE.fullmatch(text):
            break
    else:
        raise RecordingError(f"{path} is empty: rows of numbers belong here, below a line of column names if need be")
    line = line.rstrip("\r\n\0")
    delimiter = _delimiter(line)
    fields = [field.strip() for field in _fields(path, number, line, delimiter)]
    if all(is_value(field) for field in fields) and any(fields):
        named = comment.strip()
        given = [each.strip() for each in _fields(path, number - 1, named, _delimiter(named))] if named else []
        is_named = len(given) == len(fields) and not any(map(is_value, given)) and len(set(given)) == len(given)
        names = given if is_named else [f"column{i}" for i in range(1, len(fields) + 1)]
        check_columns(path, names)
        return TextLayout(begin, number - 1, names, delimiter)
    if delimiter is BLANKS and len(_next_row(path, data, offset).split()) < 2:
        fields = [line.strip()]  # one column, whose name has blanks
    _check_names(path, number, fields)
    return TextLayout(offset, number, fields, delimiter)


def split(line: str, delimiter: str | None) -> list[str]:
    """Return the fields of a line.

    Raises
    ------
    csv.Error
        The line cannot be read.
    """
    if delimiter is BLANKS:
        return next(csv.reader([" ".join(line.split())], delimiter=" "), [])
    return next(csv.reader([line], delimiter=delimiter), [])


def is_number(text: str) -> bool:
    """True if a text is a number with a decimal point, infinity or NaN."""
    try:
        float(text)
    except ValueError:
        return False
    return "_" not in text


def is_value(text: str) -> bool:
    """True if a field of unknown quoting and decimal sign may be a value; an empty one is."""
    plain = text.strip().strip('"')
    return not plain or is_number(plain) or DECIMAL_COMMA.fullmatch(plain) is not None


def not_text(path: Path, byte: int) -> RecordingError:
    """Return the error for a file that is not UTF-8."""
    return RecordingError(f"{path} is not a UTF-8 text file (byte {byte})")


def _line(path: Path, data: bytes, offset: int) -> tuple[str, int]:
    """Return the line at an offset, and the offset of the next one."""
    end = data.find(b"\n", offset) + 1 or len(data)
    try:
        return data[offset:end].decode("utf-8"), end
    except UnicodeDecodeError as error:
        raise not_text(path, offset + error.start) from None


def _next_row(path: Path, data: bytes, offset: int) -> str:
    while offset < len(data):
        line, offset = _line(path, data, offset)
        if line.strip() and not line.startswith(_COMMENTS):
            return line
    return ""


def _delimiter(line: str) -> str | None:
    """Return what separates the fields of a line: comma, semicolon or tab, and where there is none, blanks."""
    words = line.split()
    if len(words) > 1 and all(DECIMAL_COMMA.fullmatch(word) and word[-1] != "," for word in words):
        return "\t" if "\t" in line else BLANKS
    for delimiter in ";\t":  # a comma may then be the decimal sign
        if delimiter in line and all(map(is_value, line.split(delimiter))):
            return delimiter
    most = max(_DELIMITERS, key=line.count)
    return most if most in line else BLANKS if len(words) > 1 else ","


def _fields(path: Path, number: int, line: str, delimiter: str | None) -> list[str]:
    try:
        return split(line, delimiter)
    except csv.Error as error:
        raise RecordingError(f"{path}:{number}: the line of column names cannot be read: {error}") from None


def _check_names(path: Path, number: int, names: list[str]) -> None:
    check_columns(path, names)
    for name, times in Counter(names).items():
        if not name:
            raise RecordingError(f"{path}:{number}: column {names.index(name) + 1} has no name")
        if times > 1:
            raise RecordingError(f"{path}:{number}: column {name!r} is there {times} times")
