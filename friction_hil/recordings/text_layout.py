"""Layout of a text file of numbers: names of the columns, what separates them, and where the rows begin. Pure."""

import csv
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from friction_hil.errors import RecordingError
from friction_hil.recordings.bounds import check_columns
from friction_hil.recordings.dates import is_date

BLANKS = None  # what separates columns that stand in line below each other
NUMBER, FLAG, DATE, TEXT, EMPTY = "number", "flag", "date", "text", "empty"  # what a column holds
FLAGS = {"true": 1.0, "false": 0.0, "on": 1.0, "off": 0.0}
MISSING = frozenset(("", "nan", "-nan", "null", "none", "n/a", "na", "#n/a", "#nv", "-", "--", "---", "?"))
TIME_ROW = "%time"  # with which rostopic begins its header

_DELIMITERS = ",;\t"
_COMMENTS = ("#", "%")
_SEPARATOR_LINE = re.compile(r"sep=.")  # with which Excel says what separates the fields
_LIKE_NUMBER = re.compile(r"[-+]?[0-9][0-9.,_' ]*")  # a number in a form that is not read: better refused than left out
DECIMAL_COMMA = re.compile(r"\s*[-+]?(?:[0-9]+,[0-9]*|,[0-9]+)(?:[eE][-+]?[0-9]+)?\s*")


@dataclass(frozen=True, slots=True)
class TextLayout:
    """Layout of a text file."""

    start: int  # offset of the first row, bytes
    line: int  # number of the line before the first row
    names: list[str]  # `column1`, `column2`, ... where the file has none
    delimiter: str | None  # None for blanks
    kinds: list[str] = field(default_factory=list)  # what each column holds
    units: dict[str, str] = field(default_factory=dict)  # what the file says about its columns, by name
    labels: dict[str, str] = field(default_factory=dict)  # the same
    texts: dict[str, str] = field(default_factory=dict)  # examples of columns of text, by name
    problems: list[str] = field(default_factory=list)  # what was done to the names
    has_own_times: bool = False  # columns come in pairs, a time and a value
    rate_hz: float | None = None  # of sampling, by the lines above the rows

    @property
    def is_plain(self) -> bool:
        """True if each column holds numbers."""
        return all(kind == NUMBER for kind in self.kinds)


def layout_of(path: Path, data: bytes) -> TextLayout:
    """Find the layout of UTF-8 text whose first line has the names, or numbers.

    Comment lines begin with ``#`` or ``%``. If the first line holds numbers, the names are those of the comment line
    before it, if that has as many. Raises `RecordingError`: the file is empty, or has too many columns.
    """
    offset, number, comment = 0, 0, ""
    while offset < len(data):
        begin, number = offset, number + 1
        line, offset = line_at(data, begin)
        text = line.strip("\0 \t\r\n")
        if is_comment(text):
            comment = text.lstrip("".join(_COMMENTS))
        elif text and not _SEPARATOR_LINE.fullmatch(text):
            break
    else:
        raise RecordingError(f"{path} is empty: rows of numbers belong here, below a line of column names if need be")
    line = line.rstrip("\r\n\0")
    delimiter = _delimiter(line)
    fields = [each.strip() for each in _fields(path, number, line, delimiter)]
    if all(is_value(each) for each in fields) and any(fields):
        named = comment.strip()
        given = [each.strip() for each in _fields(path, number - 1, named, _delimiter(named))] if named else []
        is_named = len(given) == len(fields) and not any(map(is_value, given)) and len(set(given)) == len(given)
        names = given if is_named else [f"column{i}" for i in range(1, len(fields) + 1)]
        check_columns(path, names)
        return TextLayout(begin, number - 1, names, delimiter, [NUMBER] * len(names))
    if delimiter is BLANKS and len(_next_row(data, offset).split()) < 2:
        fields = [line.strip()]  # one column, whose name has blanks
    check_columns(path, fields)
    problems: list[str] = []
    names = distinct(fields, problems)
    return TextLayout(offset, number, names, delimiter, [NUMBER] * len(names), problems=problems)


def agrees(layout: TextLayout, data: bytes) -> bool:
    """True if the first rows have a value for each name, so that the layout need not be looked for further."""
    if layout.problems:
        return False  # names that are missing may be separators at the ends of lines, repeated ones those of times
    offset, rows = layout.start, 0
    while offset < len(data) and rows < 2:
        line, offset = line_at(data, offset)
        if not line.strip("\0 \t\r\n") or is_comment(line.strip()):
            continue
        rows += 1
        try:
            fields = split(line.rstrip("\r\n\0"), layout.delimiter)
        except csv.Error:
            return False
        if (
            len(fields) != len(layout.names)
            or not all(map(is_value, fields))
            or not any(each.strip() for each in fields)
        ):
            return False
    return True


def distinct(names: Sequence[str], problems: list[str]) -> list[str]:
    """Give a name to columns that have none, and another one to those whose name is there already; report both."""
    found: list[str] = []
    taken = set(names)
    for place, name in enumerate(names, 1):
        new = name or f"column{place}"
        count = 2
        while new in found or (new != name and new in taken):
            new, count = f"{name or f'column{place}'}_{count}", count + 1
        found.append(new)
        if not name:
            problems.append(f"column {place} has no name and is called {new}")
        elif new != name:
            problems.append(f"{name!r} names several columns; the one at place {place} is called {new}")
    return found


def split(line: str, delimiter: str | None) -> list[str]:
    """Return the fields of a line. Raises `csv.Error`: the line cannot be read."""
    if delimiter is BLANKS:
        return next(csv.reader([" ".join(line.split())], delimiter=" "), [])
    return next(csv.reader([line], delimiter=delimiter), [])


def is_comment(text: str) -> bool:
    """True if a line, without blanks before it, is a comment."""
    return text.startswith(_COMMENTS) and not text.startswith(TIME_ROW)


def is_remark(text: str) -> bool:
    """True if a line, without blanks before it, holds no fields: a comment, or what Excel says of separators."""
    return is_comment(text) or _SEPARATOR_LINE.fullmatch(text) is not None


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


def is_missing(text: str) -> bool:
    """True if a field stands for a value that is not there."""
    return text.strip().strip('"').lower() in MISSING


def kind_of(texts: Sequence[str]) -> str:
    """Return what a column holds, from some of its fields: what most of them are."""
    plain = [text.strip().strip('"') for text in texts if not is_missing(text)]
    if not plain:
        return EMPTY
    counts = Counter(map(_kind, plain))
    if 2 * counts[NUMBER] >= len(plain):
        return NUMBER
    if 2 * counts[DATE] >= len(plain):
        return DATE
    return FLAG if all(each.lower() in FLAGS for each in plain) else TEXT


def _kind(text: str) -> str:
    if is_value(text) or _LIKE_NUMBER.fullmatch(text):
        return NUMBER
    return DATE if is_date(text) else TEXT


def line_at(data: bytes, offset: int) -> tuple[str, int]:
    """Return the line at an offset, and the offset of the next one."""
    end = data.find(b"\n", offset) + 1 or len(data)
    return data[offset:end].decode("utf-8"), end


def _next_row(data: bytes, offset: int) -> str:
    while offset < len(data):
        line, offset = line_at(data, offset)
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
