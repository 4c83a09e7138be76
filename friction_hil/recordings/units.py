"""Units in a file, beside its columns or in their names, and how they become those of friction_hil's columns. Pure."""

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass

from friction_hil.recordings.columns import AxisKind, unit

_KINDS: tuple[AxisKind, ...] = ("rotary", "linear")

# By friction_hil's unit: spellings of other programs, as `_plain` leaves them, and the factor that makes it of them.
_FACTORS = {
    "s": {
        "1": "s sec second seconds sek",
        "0.001": "ms msec millisecond milliseconds",
        "1e-6": "us usec microsecond microseconds",
        "1e-7": "100ns",
        "1e-9": "ns nsec nanosecond nanoseconds",
        "60": "min minute minutes",
    },
    "us": {"1": "us usec", "1000": "ms", "1e6": "s", "0.001": "ns"},
    "rad": {
        "1": "rad radian radians",
        "0.001": "mrad",
        "1e-6": "urad",
        "pi/180": "deg ° º degree degrees",
        "2*pi": "rev revs revolution revolutions turn turns",
    },
    "rad/s": {
        "1": "rad/s rads-1 rads^-1 radian/s rad/sec rads",
        "0.001": "mrad/s",
        "pi/180": "deg/s °/s º/s deg/sec degree/s degrees/s dps",
        "pi/30": "rpm 1/min min-1 min^-1 rev/min r/min u/min upm",
        "2*pi": "rev/s r/s rps turn/s turns/s 1/s s-1 s^-1 hz",
    },
    "rad/s^2": {"1": "rad/s^2 rad/s2 rads-2 rads^-2", "pi/180": "deg/s^2 deg/s2 °/s^2 °/s2", "2*pi": "rev/s^2 rev/s2"},
    "m": {"1": "m meter metre meters metres", "0.01": "cm", "0.001": "mm", "1e-6": "um", "1e-9": "nm"},
    "m/s": {
        "1": "m/s ms-1 ms^-1 m/sec mps",
        "0.01": "cm/s",
        "0.001": "mm/s mm/sec mmps",
        "1e-6": "um/s",
        "1/60": "m/min",
        "0.001/60": "mm/min",
    },
    "m/s^2": {"1": "m/s^2 m/s2 ms-2", "0.001": "mm/s^2 mm/s2"},
    "N m": {
        "1": "Nm newtonmeter newtonmetre newtonmeters",
        "0.001": "mNm Nmm",
        "0.01": "Ncm cNm",
        "1000": "kNm",
        "1e-6": "uNm",
    },
    "N": {"1": "N newton newtons", "0.001": "mN", "1000": "kN"},
    "°C": {"1": "°C degC celsius C"},
}
# Units that no factor known here converts.
_words = str.split
_OTHERS = frozenset(
    _words(
        "% permille ‰ counts count cnt cts inc incr increments pulse pulses puls pls ticks step steps lsb digit digits "
        "raw a ma arms mv v w kw k f °f -"
    )
)
_SUFFIXES = frozenset(  # units that may follow the name with an underscore: these are hardly anything else
    _words("deg degree degrees rpm dps deg_s degs rad rads rad_s mrad ms us ns sec mm mm_s mnm nm ma")
)
_IN_BRACKETS = re.compile(r"[\[(<{]([^\[\](){}<>]*)[\])>}]\s*$")
_BEHIND = re.compile(r"\s(?:in|/)\s+(\S[^/]*(?:/\S+)?)$")
_SUFFIX = re.compile(r"[_.\s-]([A-Za-z]+(?:_s)?)$")


@dataclass(frozen=True, slots=True)
class Conversion:
    """What makes friction_hil's unit of one in a file: ``factor`` in words, for the unit ``to``."""

    factor: str
    to: str

    @property
    def value(self) -> float:
        """The factor."""
        value = 1.0
        for operator, text in re.findall(r"([*/]?)([^*/]+)", self.factor):
            number = math.pi if text == "pi" else float(text)
            value = value / number if operator == "/" else value * number
        return value


def _plain(text: str) -> str:
    bare = "".join(text.split())
    for other, ours in (("·", ""), ("⋅", ""), ("*", ""), (".", ""), ("µ", "u"), ("μ", "u"), ("²", "^2"), ("⁻¹", "^-1")):
        bare = bare.replace(other, ours)
    return bare


_BY_UNIT = {
    ours: {each: factor for factor, words in factors.items() for each in words.split()}
    for ours, factors in _FACTORS.items()
}
_KNOWN = {each.lower() for spellings in _BY_UNIT.values() for each in spellings} | _OTHERS


def units_of(name: str) -> tuple[str, ...]:
    """Return the units that one of friction_hil's columns may have, on a rotary axis first."""
    return tuple(dict.fromkeys(filter(None, (unit(name, kind) for kind in _KINDS))))


def is_unit(text: str) -> bool:
    """True if a text is a unit, in one of the spellings that are known."""
    return _plain(text.strip().strip("[]()")).lower() in _KNOWN


def unit_in(name: str) -> str:
    """Return the unit in the name of a column, such as ``pos [deg]`` or ``speed_rpm``; empty if there is none."""
    found = _IN_BRACKETS.search(name) or _BEHIND.search(name)
    if found and is_unit(found[1]):
        return found[1].strip()
    found = _SUFFIX.search(name)
    if found and found[1].lower() in _SUFFIXES:
        return _with_slash(found[1])
    return name.strip() if name.strip().lower() in ("rpm", "deg", "dps") else ""


def _with_slash(suffix: str) -> str:
    return suffix.replace("_s", "/s") if suffix.endswith("_s") else suffix


def conversion(name: str, given: str) -> Conversion | None:
    """Return what converts a unit of the file to that of friction_hil's column ``name``; None if nothing known does.

    Capitals matter only where there is no other spelling: in ``torque_nm`` the unit is N m.
    """
    bare = _plain(given)
    for ours in units_of(name):
        spellings = _BY_UNIT.get(ours, {})
        lower = {each.lower(): factor for each, factor in spellings.items()}
        factor = spellings.get(bare) or lower.get(bare.lower())
        if factor:
            return Conversion(factor, ours)
    return None


def unit_problem(name: str, given: str, source: str) -> str:
    """Return a sentence if a column, read from ``source``, is in a unit that nothing known converts, else none."""
    expected = units_of(name)
    if not expected or not _plain(given) or conversion(name, given) is not None:
        return ""
    return (
        f"{name} is in {given} in the file and is taken for {' or '.join(expected)}: "
        f"scale it with --column {name}={source}*FACTOR"
    )


def known_unit(units: Mapping[str, str], name: str) -> str:
    """Return the unit of a column to be written; empty if it is not known.

    ``units``, by column as the file that was read has them (`Recording.units`), take precedence over friction_hil's own
    unit, which counts only where it is the same on rotary and linear axes.
    """
    own = {unit(name, kind) for kind in _KINDS}
    return units.get(name) or (own.pop() if len(own) == 1 else "")
