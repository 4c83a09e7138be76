"""Dates and times of day as other programs write them, in seconds. Pure."""

import re
from collections.abc import Callable, Sequence
from datetime import UTC, datetime

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_DAY = 86400.0
_TIME = r"(?P<hour>\d{1,2}):(?P<minute>\d{2})(?::(?P<second>\d{2})(?P<fraction>[.,:]\d+)?)?\s*(?P<half>[AaPp][Mm])?"
_ZONE = r"\s*(?P<zone>Z|UTC|[-+]\d{2}:?\d{2})?"
_FORMS = (
    re.compile(rf"(?P<year>\d{{4}})[-/.](?P<month>\d{{1,2}})[-/.](?P<day>\d{{1,2}})(?:[T\s_-]+{_TIME}{_ZONE})?"),
    re.compile(rf"(?P<day>\d{{1,2}})\.(?P<month>\d{{1,2}})\.(?P<year>\d{{4}})(?:[T\s,]+{_TIME}{_ZONE})?"),
    re.compile(rf"(?P<month>\d{{1,2}})/(?P<day>\d{{1,2}})/(?P<year>\d{{4}})(?:[T\s,]+{_TIME}{_ZONE})?"),
    re.compile(rf"(?P<day>\d{{1,2}})/(?P<month>\d{{1,2}})/(?P<year>\d{{4}})(?:[T\s,]+{_TIME}{_ZONE})?"),
    re.compile(_TIME),
)
_DURATION = re.compile(  # of IEC 61131-3: T#1s200ms
    r"L?T(?:IME)?#(?P<sign>-?)(?:(?P<d>[\d.]+)d)?_?(?:(?P<h>[\d.]+)h)?_?(?:(?P<m>[\d.]+)m(?!s))?_?(?:(?P<s>[\d.]+)s)?_?"
    r"(?:(?P<ms>[\d.]+)ms)?_?(?:(?P<us>[\d.]+)us)?_?(?:(?P<ns>[\d.]+)ns)?",
    re.IGNORECASE,
)
_SECONDS = {"d": _DAY, "h": 3600.0, "m": 60.0, "s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
_STAMP = re.compile(r"L?(?:DT|DATE_AND_TIME|TOD|TIME_OF_DAY)#", re.IGNORECASE)  # what IEC 61131-3 puts before a date


def is_date(text: str) -> bool:
    """True if a field is a date, a time of day, or a duration of a controller (``T#1s200ms``)."""
    return bool(text) and any(parse(text) is not None for parse in _parsers())


def seconds(texts: Sequence[str]) -> Array | None:
    """Return the time of each text since the first one, s; NaN for an empty one; None if they are of no one form.

    Times of day go on over midnight. Of a date such as 3/4/2024 the month is first, unless the days are closer
    together the other way round.
    """
    found = [values for parse in _parsers() if (values := _all(texts, parse)) is not None]
    if not found:
        return None
    whole, rest = min(found, key=lambda each: np.nanmax(each[0], initial=-np.inf) - np.nanmin(each[0], initial=np.inf))
    known = np.flatnonzero(np.isfinite(whole))
    if not known.size:
        return whole
    whole = whole - whole[known[0]]
    if parse_time_of_day(texts[known[0]]) is not None:
        steps = np.diff(whole[known], prepend=0.0)
        whole[known] += _DAY * np.cumsum((steps < -_DAY / 2.0).astype(float) - (steps > _DAY / 2.0))
    since: Array = whole + (rest - rest[known[0]])  # the fraction apart: it keeps its digits
    return since


Parsed = tuple[float, float]  # whole seconds, and their fraction


def parse_time_of_day(text: str) -> Parsed | None:
    """Return the seconds since midnight."""
    return _parse(_FORMS[-1], _STAMP.sub("", text.strip(), count=1))


def _parsers() -> "list[Callable[[str], Parsed | None]]":
    dates = [lambda text, form=form: _parse(form, _STAMP.sub("", text.strip(), count=1)) for form in _FORMS]
    return [*dates, _duration]


def _all(texts: Sequence[str], parse: "Callable[[str], Parsed | None]") -> tuple[Array, Array] | None:
    values = np.full((len(texts), 2), np.nan)
    for row, text in enumerate(texts):
        if not text.strip():
            continue
        parsed = parse(text)
        if parsed is None:
            return None
        values[row] = parsed
    return values[:, 0], values[:, 1]


def _parse(form: re.Pattern[str], text: str) -> Parsed | None:
    found = form.fullmatch(text)
    if found is None:
        return None
    part = {"year": None, "month": None, "day": None, "zone": None} | found.groupdict()
    hour = int(part["hour"] or 0)
    if part["half"]:
        hour = hour % 12 + (12 if part["half"].lower() == "pm" else 0)
    try:
        day = datetime(int(part["year"] or 1970), int(part["month"] or 1), int(part["day"] or 1), tzinfo=UTC)
    except ValueError:
        return None
    minute, second = int(part["minute"] or 0), int(part["second"] or 0)
    if hour > 23 or minute > 59 or second > 60:
        return None
    zone = (part["zone"] or "").replace(":", "")
    ahead = 0.0
    if zone[:1] in ("+", "-"):
        ahead = float(f"{zone[0]}1") * (3600.0 * int(zone[1:3]) + 60.0 * int(zone[3:]))
    fraction = float(f"0.{part['fraction'][1:]}") if part["fraction"] else 0.0
    return day.timestamp() + 3600.0 * hour + 60.0 * minute + second - ahead, fraction


def _duration(text: str) -> Parsed | None:
    found = _DURATION.fullmatch(text.strip())
    if found is None or not any(found[name] for name in _SECONDS):
        return None
    try:
        value = sum(factor * float(found[name]) for name, factor in _SECONDS.items() if found[name])
    except ValueError:
        return None
    return (-value if found["sign"] else value), 0.0
