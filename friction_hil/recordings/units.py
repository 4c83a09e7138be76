"""Comparison of the units in a file with the units of friction_hil's columns. Pure."""

from collections.abc import Mapping

from friction_hil.recordings.columns import AxisKind, unit

_KINDS: tuple[AxisKind, ...] = ("rotary", "linear")

# Spellings of other programs, compared without blanks and dots, and in lower case.
_SPELLINGS = {
    "sec": "s",
    "second": "s",
    "seconds": "s",
    "radian": "rad",
    "radians": "rad",
    "meter": "m",
    "metre": "m",
    "rads-1": "rad/s",
    "rads^-1": "rad/s",
    "ms-1": "m/s",
    "ms^-1": "m/s",
    "newton": "N",
    "newtonmeter": "Nm",
    "newtonmetre": "Nm",
    "degc": "°C",
    "celsius": "°C",
    "c": "°C",
    "µs": "us",
    "μs": "us",
}
_TO_SI = {
    "deg": "pi/180",
    "°": "pi/180",
    "degree": "pi/180",
    "degrees": "pi/180",
    "deg/s": "pi/180",
    "°/s": "pi/180",
    "rpm": "pi/30",
    "1/min": "pi/30",
    "min-1": "pi/30",
    "rev/min": "pi/30",
    "rev": "2*pi",
    "rev/s": "2*pi",
    "ms": "0.001",
    "us": "1e-6",
    "µs": "1e-6",
    "ns": "1e-9",
    "mm": "0.001",
    "mm/s": "0.001",
    "mNm": "0.001",
    "Ncm": "0.01",
    "kN": "1000",
    "kNm": "1000",
}


def _plain(text: str) -> str:
    bare = "".join(text.split()).replace(".", "").replace("*", "").replace("·", "").replace("⋅", "")
    return _SPELLINGS.get(bare.lower(), bare)


def unit_problem(name: str, given: str) -> str:
    """Return a sentence if a column of the file is in another unit than friction_hil's, else an empty text."""
    expected = tuple(dict.fromkeys(filter(None, (unit(name, kind) for kind in _KINDS))))
    bare = _plain(given)
    if not expected or not bare or bare in map(_plain, expected):
        return ""
    factor = _TO_SI.get(bare) or _TO_SI.get(bare.lower())
    hint = f"--column {name}={name}*{factor}" if factor else f"scale it with --column {name}={name}*FACTOR"
    return f"{name} is in {given} in the file and is taken for {' or '.join(expected)}: {hint}"


def known_unit(units: Mapping[str, str], name: str) -> str:
    """Return the unit of a column to be written; empty if it is not known.

    Parameters
    ----------
    units : dict
        Units by column as the file that was read has them (`Recording.units`). They take precedence over
        friction_hil's own unit, which counts only where it is the same on rotary and linear axes.
    name : str
        Name of the column.
    """
    own = {unit(name, kind) for kind in _KINDS}
    return units.get(name) or (own.pop() if len(own) == 1 else "")
