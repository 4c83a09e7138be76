"""The rows of numbers in a text file with anything above them: preamble, several header lines, text beside. Pure."""

import csv
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from friction_hil.recordings.bounds import check_columns
from friction_hil.recordings.text_layout import (
    BLANKS,
    DATE,
    EMPTY,
    NUMBER,
    TEXT,
    TextLayout,
    distinct,
    is_comment,
    is_missing,
    is_remark,
    is_value,
    kind_of,
    line_at,
    split,
)
from friction_hil.recordings.units import conversion, is_unit, unit_in

_MOST_LINES = 1000  # above the first row, and of the sample that shows what the columns hold
_MOST_BYTES = 1_000_000  # of that sample
_MOST_HEADER = 60  # lines, as a scope writes them
_words = str.split
_DELIMITERS = (",", ";", "\t", "|", BLANKS)
_TYPES = frozenset(  # of controllers, in a line of their own
    _words("bool bit byte word dword lword sint usint int uint dint udint lint ulint real lreal float double")
)
_NAME_KEYS = frozenset(("name", "names", "channel", "signal", "variable"))
_UNIT_KEYS = ("unit", "y_unit_label", "einheit")
_PERIOD = re.compile(
    r"(?P<name>[^,;\t|]*?(?:sampl\w*\s*(?:time|interval|period)|time\s*interval|interval|delta_x|cycle\s*time|period)[^,;\t|]*?)"
    r"[,;\t|:=]+\s*\"?(?P<value>[0-9.,eE+-]+)",
    re.IGNORECASE,
)
_RATE = re.compile(
    r"(?:sampl\w*\s*(?:rate|frequency)|sample_rate|samplerate)[^,;\t|0-9]*?[,;\t|:=\s]\s*\"?(?P<value>[0-9.,eE+-]+)",
    re.IGNORECASE,
)
_LONGEST_PERIOD_S = 10.0
_ONE_COLUMN = 0.25  # of the weight of lines without separators, which any text has
_BLANKS_BETWEEN = 0.9  # of the weight: blanks also divide what a tab separates
_FEW = 10  # lines, all of which show what the columns hold


@dataclass(frozen=True, slots=True)
class _Line:
    start: int
    number: int
    text: str


@dataclass(frozen=True, slots=True)
class _Rows:
    """How the lines of a sample divide into rows: delimiter, number of fields, and what each holds."""

    delimiter: str | None
    fields: list[list[str]]  # of each line
    width: int
    kinds: list[str]

    def is_row(self, place: int) -> bool:
        """True if a line of the sample may be a row."""
        fields = self.fields[place]
        if len(fields) < self.width or any(each.strip() for each in fields[self.width :]):
            return False
        pairs = list(zip(fields, self.kinds, strict=False))
        fits = all(
            is_missing(text) or is_value(text) if kind == NUMBER else is_missing(text) or kind_of([text]) == kind
            for text, kind in pairs
            if kind in (NUMBER, DATE)
        )
        return fits and any(text.strip() for text, kind in pairs if kind in (NUMBER, DATE))

    def first_text(self, first: int, column: int) -> str:
        """Return the first text of a column from line ``first`` on, "" where only lines above have any."""
        found = (fields[column].strip() for fields in self.fields[first:] if column < len(fields))
        return next((each for each in found if not is_missing(each)), "")

    def begins_like_row(self, place: int) -> bool:
        """True if a line has as many fields as a row, and its first one is what that of a row is."""
        fields, kind = self.fields[place], self.kinds[0]
        if len(fields) != self.width or kind not in (NUMBER, DATE) or is_missing(fields[0]):
            return False
        return kind_of([fields[0]]) == kind


def block_layout(path: Path, data: bytes) -> TextLayout | None:
    """Find the rows of numbers in UTF-8 text, and what the lines above say of their columns; None if there are none.

    The rows are most of the lines with the same number of fields. The names stand in the line above them; if that has
    units, in the line before. A scope that writes a header of keys (Name, Unit) has them behind these.
    """
    lines = _sample(data)
    rows = max((_rows(lines, delimiter) for delimiter in _DELIMITERS), key=_weight, default=None)
    if rows is None or NUMBER not in rows.kinds:
        return None
    first = next((i for i in range(len(lines)) if rows.is_row(i) and (i + 1 == len(lines) or rows.is_row(i + 1))), None)
    if first is None:
        return None
    while first > 0 and rows.begins_like_row(first - 1):
        first -= 1  # with a field that is none: the reader says which
    check_columns(path, rows.kinds)
    header = _header(lines, rows, first)
    if header is None:
        return None
    names, units, labels, has_own_times = header
    problems: list[str] = []
    given = enumerate(zip(names, rows.kinds, strict=True))
    named = [name if kind != EMPTY or name else f"\0{i}" for i, (name, kind) in given]
    names = distinct(named, problems)  # empty columns without a name are behind separators at the ends of lines
    texts = {
        name: rows.first_text(first, i)
        for i, (name, kind) in enumerate(zip(names, rows.kinds, strict=True))
        if kind == TEXT
    }
    start = lines[first].start
    return TextLayout(
        start,
        lines[first].number - 1,
        names,
        rows.delimiter,
        list(rows.kinds),
        units={name: unit for name, unit in zip(names, units, strict=True) if unit},
        labels={name: label for name, label in zip(names, labels, strict=True) if label},
        texts=texts,
        problems=problems,
        has_own_times=has_own_times,
        rate_hz=_rate([each.text for each in lines[:first]]),
    )


def _sample(data: bytes) -> list[_Line]:
    """Return the first lines that are not empty; comments too, because one may have the names."""
    found: list[_Line] = []
    offset, number = 0, 0
    while offset < min(len(data), _MOST_BYTES) and len(found) < _MOST_LINES:
        begin, number = offset, number + 1
        text, offset = line_at(data, begin)
        found.append(_Line(begin, number, text.rstrip("\r\n\0")))
    if data and not data.endswith(b"\n") and len(found) > _FEW and offset >= len(data):
        found.pop()  # it may be cut off
    return found


def _rows(lines: Sequence[_Line], delimiter: str | None) -> _Rows:
    fields = []
    for line in lines:
        try:
            fields.append([] if is_remark(line.text.strip()) else split(line.text, delimiter))
        except csv.Error:
            fields.append([])
    counts = Counter(len(each) for each in fields if any(text.strip() for text in each))
    width = max(counts, key=lambda count: (counts[count], count), default=0)
    same = [each for each in fields if len(each) == width]
    last = same[len(same) // 2 :] if len(same) > 3 else same[-2:]  # below the header
    return _Rows(delimiter, fields, width, [kind_of([each[i] for each in last]) for i in range(width)])


def _weight(rows: _Rows) -> tuple[float, int]:
    """Return how well a delimiter explains the lines: the number of those with a share of values."""
    same = [each for each in rows.fields if len(each) == rows.width]
    if not rows.width:
        return 0.0, 0
    values = sum(kind in (NUMBER, DATE, EMPTY) for kind in rows.kinds) / rows.width
    if rows.delimiter is BLANKS and any(text.endswith(",") for each in same for text in each):
        values = 0.0  # the commas separate
    likely = _ONE_COLUMN if rows.width == 1 else _BLANKS_BETWEEN if rows.delimiter is BLANKS else 1.0
    return len(same) * values * likely, rows.width


Header = tuple[list[str], list[str], list[str], bool]


def _header(lines: Sequence[_Line], rows: _Rows, first: int) -> Header | None:
    """Return names, units and labels of the columns, and whether each has a time of its own.

    None if there is a line of names that are not as many as the fields of a row.
    """
    width = rows.width
    block: list[list[str]] = []
    place = first - 1
    while place >= 0 and not lines[place].text.strip():
        place -= 1
    nearest = place
    while place >= 0 and len(block) < _MOST_HEADER:
        fields = _header_fields(lines[place].text, rows)
        if fields is None:
            break
        block.insert(0, fields)
        place -= 1
    no_names = [""] * width
    if not block:
        if nearest >= 0 and not is_comment(lines[nearest].text.strip()) and len(rows.fields[nearest]) > 1:
            return None
        return [f"column{i}" for i in range(1, width + 1)], no_names, no_names, False
    keyed = _keyed(block, width) or _in_pairs(block, width)
    return keyed or _by_lines(block, width)


def _header_fields(text: str, rows: _Rows) -> list[str] | None:
    """Return the fields of a line above the rows, one for each column; None if they are not as many."""
    bare = text.strip()
    if is_comment(bare):
        text = bare.lstrip("#%").strip()
    try:
        fields = [each.strip() for each in split(text, rows.delimiter)]
    except csv.Error:
        return None
    width = rows.width
    while len(fields) > width and not fields[-1]:
        fields.pop()
    if len(fields) == width + 1 and fields[-1].lower() == "comment":  # of LabVIEW, without values
        fields.pop()
    least = width - next((i for i, kind in enumerate(reversed(rows.kinds)) if kind != EMPTY), width)
    if not least <= len(fields) <= width or not any(fields):
        return None
    return fields + [""] * (width - len(fields))


def _keyed(block: list[list[str]], width: int) -> Header | None:
    """Return the header of a scope: each line has a key, and beside it a value for each channel."""
    keys = [fields[0].lower() for fields in block]
    name_at = next((i for i, key in enumerate(keys) if key in _NAME_KEYS), None)
    if name_at is None or len(block) < 3:
        return None
    is_paired = width % 2 == 0 and all(len(set(fields[::2]) - {""}) <= 1 for fields in block)
    channels = slice(1, None, 2) if is_paired else slice(1, None)
    unit_row = next((fields for fields, key in zip(block, keys, strict=True) if key in _UNIT_KEYS), [""] * width)
    clock = next((unit_in(key) for key in keys if conversion("time_s", unit_in(key))), "")
    names, units = [""] * width, [""] * width
    names[channels] = block[name_at][channels]
    units[channels] = [each.partition(" ")[0] if is_unit(each.partition(" ")[0]) else "" for each in unit_row[channels]]
    for i in range(0, width, 2 if is_paired else width):
        names[i] = "time" if i == 0 else f"time of {names[i + 1]}"
        units[i] = clock
    return names, units, [""] * width, is_paired and width > 2


def _in_pairs(block: list[list[str]], width: int) -> Header | None:
    """Return the header of columns that come in pairs: the same name of a time before each channel."""
    fields = block[-1] if not any(map(is_unit, block[-1])) or len(block) < 2 else block[-2]
    if width < 4 or width % 2 or len(set(fields[::2])) != 1 or not fields[0] or len(set(fields[1::2])) == 1:
        return None
    names, units, labels, _ = _by_lines(block, width)
    names = [f"{name} of {names[i + 1]}" if i % 2 == 0 and i else name for i, name in enumerate(names)]
    clock = units[0] or unit_in(fields[0])
    return names, [clock if i % 2 == 0 else each for i, each in enumerate(units)], labels, True


def _by_lines(block: list[list[str]], width: int) -> Header:
    """Return the header of one line of names, with a line of units below it if there is one."""
    texts = [each for each in block if not any(text and is_value(text) for text in each)]
    texts = [each for each in texts if 2 * sum(map(bool, each)) >= width or width < 3]
    texts = [each for each in texts if not all(text.lower() in _TYPES for text in each if text)] or block[-1:]
    names, below = texts[-1], [""] * width
    if len(texts) > 1 and any(map(is_unit, names)) and sum(map(is_unit, names)) > sum(map(is_unit, texts[-2])):
        names, below = texts[-2], names
    keyed = next((each for each in block if each[0].lower() in _UNIT_KEYS), None)
    units = [text.strip("[]()") if is_unit(text) else "" for text in below]
    if keyed is not None and not any(units):
        units = [text if is_unit(text) else "" for text in keyed]
    labels = ["" if is_unit(text) else text for text in below]
    return names, units, labels, False


def _rate(preamble: Sequence[str]) -> float | None:
    """Return the sampling rate that the lines above the rows state, Hz; None if they do not."""
    for line in preamble:
        found = _PERIOD.search(line)
        if found:
            clock = conversion("time_s", unit_in(found["name"].strip()) or "s")
            period = _number(found["value"]) * (clock.value if clock else 1.0)
            if 0.0 < period < _LONGEST_PERIOD_S:
                return 1.0 / period
        found = _RATE.search(line)
        if found and _number(found["value"]) > 0.0:
            return _number(found["value"])
    return None


def _number(text: str) -> float:
    try:
        return float(text.replace(",", "."))
    except ValueError:
        return 0.0
