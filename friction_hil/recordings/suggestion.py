"""A suggestion how columns of another program become friction_hil's, by their names and units. Pure."""

import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field

import numpy as np

from friction_hil.recordings.columns import NAMES, TIME
from friction_hil.recordings.contradictions import register_of
from friction_hil.recordings.recording import Array, Recording
from friction_hil.recordings.units import conversion, unit_in

# Words in the names of other programs, by friction_hil's column; earlier columns are looked for first.
_WORDS = {
    TIME: r"%?time|__time|t|zeit|timestamp|stamp|datetime|date|datum|clock|x[_ ]?value|elapsed|seconds?|cycle",
    "velocity": r"vel\w*|speed|omega|w|qd|dq|qdot|velo|v|drehzahl|geschwindigkeit|rpm|actvelo\w*|istdrehzahl|rate",
    "torque": r"torque|trq|tau|effort|moment|drehmoment|kraft|force|current|curr|strom|iq|load|acttorque|m|eff|u",
    "position": r"pos\w*|angle|theta|q|winkel|weg|lage|encoder|enc|actpos\w*|counts?|position|phi|x|deg",
}
_OTHERS = re.compile(
    r"set|cmd|command|target|ref\w*|demand\w*|soll|desired|des|goal|err\w*|error|limit|lag|max|min|raw"
)
_UNITS = {  # units that tell what a column is where its name does not
    "velocity": ("rad/s", "m/s"),
    "torque": ("N m", "N"),
    "position": ("rad", "m"),
}
_CURRENT = frozenset(("a", "ma", "arms"))
_COUNTS = frozenset(("counts", "count", "cnt", "cts", "inc", "incr", "increments", "pulse", "pulses", "pls", "ticks"))
_NUMBERED = re.compile(r"(.*?)[\[_.]?(\d+)\]?$")
_EPOCHS = ((1e17, "1e-9", "ns"), (1e14, "1e-6", "us"), (1e11, "0.001", "ms"))  # s since 1970 by their size


@dataclass(slots=True)
class Suggestion:
    """Sources of columns as ``--column`` takes them, and what has to be known besides."""

    columns: dict[str, str] = field(default_factory=dict)  # only those that are not there under friction_hil's name
    rate_hz: float | None = None  # that the file states, if it has no time stamps
    notes: list[str] = field(default_factory=list)  # what `FACTOR` in a source is, and columns that are still missing

    @property
    def options(self) -> list[str]:
        """Options of the command line."""
        rate = [] if self.rate_hz is None else ["--rate", f"{self.rate_hz:.10g}"]
        return [*rate, *(word for name, source in self.columns.items() for word in ("--column", f"{name}={source}"))]


def joint_options(columns: Mapping[str, str], names: Collection[str]) -> list[str]:
    """Return the options that read all joints of a wide log, if there is a numbered position and torque of each.

    ``columns`` are sources by friction_hil's names, as of a `Suggestion`; ``names`` are the columns of the file.
    """
    found: list[list[str]] = []  # numbers of the joints that have each quantity
    options = [word for name, source in columns.items() if name == TIME for word in ("--column", f"{name}={source}")]
    for option, name in (("--joints", "position"), ("--torque", "torque")):
        source = re.match(r"(\w*?)(\d+)(?=([*/].*)?$)", columns.get(name, ""))
        if source is None:
            return []
        fits = (re.fullmatch(re.escape(source[1]) + r"(\d+)", each) for each in names)
        found.append(sorted(each[1] for each in fits if each is not None))
        options += [option, f"{source[1]}{{}}{source[3] or ''}"]
    return options if found[0] == found[1] and len(found[0]) > 1 else []


def suggest(recording: Recording) -> Suggestion:
    """Suggest sources for time, position, velocity and torque that are not there under these names."""
    found = Suggestion()
    names = [*recording.columns, *recording.others]
    free = [name for name in names if name not in NAMES]
    without_unit: list[str] = []
    for column in _WORDS:
        if column in names:
            continue
        source = _best(column, free, recording)
        if source is None:
            continue
        free.remove(source)
        factor = _factor(column, source, recording, found.notes)
        register = register_of(recording.columns[source]) if column != TIME and source in recording.columns else None
        found.columns[column] = (
            source if register is None else f"{register.source(source)}*{register.step:.6g}"
        ) + factor
        if register is not None:
            found.notes.append(f"{source} is a signed register of {register.bits} bits, logged as an unsigned one")
        if not factor and column != TIME and not unit_of(recording, source):
            without_unit.append(source)
    if without_unit:
        found.notes.append(
            f"the file states no unit of {', '.join(without_unit)}: taken for SI (rad, rad/s, N m); a factor goes "
            "behind the name, e.g. NAME*pi/180"
        )
    there = {*names, *found.columns}
    if TIME not in there and recording.rate_hz:
        found.rate_hz = recording.rate_hz
    elif TIME not in there:
        found.notes.append("no column looks like a time: --rate HZ gives the sampling rate")
    missing = [name for name in ("position", "torque") if name not in there]
    if missing == ["position"] and "velocity" in there:
        missing = []  # it is integrated
    found.notes += [f"no column looks like a {name}: --column {name}=NAME gives it" for name in missing]
    found.columns = {
        name: found.columns[name] for name in (TIME, "position", "velocity", "torque") if name in found.columns
    }
    return found


def unit_of(recording: Recording, name: str) -> str:
    """Return the unit of a column by the file: beside it, or in its name; empty if it is not known."""
    return recording.units.get(name, "") or ("" if name in NAMES else unit_in(name))


def _best(column: str, names: list[str], recording: Recording) -> str | None:
    """Return the column that is most likely one of friction_hil's; None if none is likely."""
    ranked = sorted(
        (-rank, _number(name), place, name)
        for place, name in enumerate(names)
        if (rank := _rank(column, name, recording))
    )
    return ranked[0][3] if ranked else None


def _rank(column: str, name: str, recording: Recording) -> int:
    """Return how likely a column is the one of friction_hil; 0 if it is not."""
    unit = unit_of(recording, name)
    words = _words(f"{name} {recording.labels.get(name, '')}", unit)
    words.append(name.lower())
    is_named = any(re.fullmatch(_WORDS[column], word) for word in words)
    if column == TIME:
        values = recording.columns.get(name)
        is_clock = bool(unit) and conversion(TIME, unit) is not None
        if values is not None and not _increases(values):
            return 0
        return 3 * is_named + 2 * is_clock
    fits = conversion(column, unit) is not None
    of_other = any(conversion(other, unit) is not None for other in (TIME, *_UNITS) if other != column and unit)
    if not (is_named or fits) or (of_other and not fits):
        return 0
    if column == "torque" and not fits and unit.lower() in _COUNTS:
        return 0
    exact = name.lower() in (column, "effort", "tau", "speed", "pos", "vel")
    is_other = any(_OTHERS.fullmatch(word) for word in words)
    is_constant = name in recording.columns and not np.ptp(_finite(recording.columns[name])) > 0.0
    return max(1, 4 * fits + 6 * is_named + exact - 3 * is_other - 3 * is_constant)


def _finite(values: Array) -> Array:
    finite = values[np.isfinite(values)]
    return finite if len(finite) else np.zeros(1)


def _words(text: str, unit: str) -> list[str]:
    """Return the words of a name, of ``ActPos`` and ``field.position0`` as well, without its unit."""
    text = text.replace(unit, " ") if len(unit) > 1 else text
    text = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", text)
    return [
        re.sub(r"\d+$", "", word) or word
        for word in re.split(r"[^\w%]+|_", text.lower().replace("__time", "time"))
        if word
    ]


def _number(name: str) -> int:
    found = _NUMBERED.fullmatch(name)
    return int(found[2][-9:]) if found else 0


def _increases(values: Array) -> bool:
    finite = values[np.isfinite(values)]
    steps = np.diff(finite)
    return bool(len(steps) and np.mean(steps > 0.0) > 0.5 and np.mean(steps >= 0.0) > 0.9)


def _factor(column: str, name: str, recording: Recording, notes: list[str]) -> str:
    """Return the factor to write behind a source; empty where the unit is known, or none is."""
    unit = unit_of(recording, name)
    if unit and conversion(column, unit) is not None:
        return ""
    if column == TIME:
        return _clock_factor(recording.columns.get(name))
    known: Mapping[str, str] = {
        "position": "rad (or m) for each step of the encoder",
        "velocity": f"rad/s (or m/s) for each {unit or 'unit'}",
        "torque": f"N m (or N) for each {unit or 'unit'}",
    }
    is_amount = unit.lower() in _CURRENT or (column == "torque" and re.search(r"curr|strom|\biq", name.lower()))
    if is_amount:
        notes.append(f"FACTOR of {column}: N m for each {unit or 'ampere'}: torque constant times gear ratio")
    elif unit:
        notes.append(f"FACTOR of {column}: {known[column]}, because {name} is in {unit}")
    elif column == "position" and _is_counts(recording.columns.get(name)):
        notes.append(
            f"FACTOR of {column}: {known[column]}, because {name} holds whole numbers: 2*pi/4096 for 4096 a turn"
        )
    else:
        return ""
    return "*FACTOR"


def _is_counts(values: Array | None) -> bool:
    if values is None:
        return False
    finite = values[np.isfinite(values)]
    return bool(len(finite) > 1 and np.ptp(finite) > 20.0 and np.all(finite == np.floor(finite)))


def _clock_factor(values: Array | None) -> str:
    if values is None or not np.isfinite(values).any():
        return ""
    top = float(np.nanmax(values))
    return next((f"*{factor}" for least, factor, _ in _EPOCHS if top > least), "")
