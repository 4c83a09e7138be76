"""Recording of one axis in memory, and the checks that apply to every format."""

import shlex
import textwrap
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from friction_hil.errors import RecordingError, UsageError, choices
from friction_hil.recordings.columns import CYCLE, NAMES, SPARSE, TIME, AxisKind, unit
from friction_hil.recordings.product import absent, product_of
from friction_hil.recordings.quality import LARGEST, is_ordinary, rows_text, too_large, without_overflow
from friction_hil.recordings.units import conversion, unit_in, unit_problem

Array = NDArray[np.float64]

CHANGE = "change"  # name of the event that holds settings for replay; a notice of the same cycle has it in words
_MOST_NAMED = 100  # columns that a message lists


@dataclass(frozen=True, slots=True)
class Event:
    """Fault or change of a setting in a cycle."""

    cycle: float
    name: str
    text: str


@dataclass(slots=True, repr=False)
class Recording:
    """The log of one axis.

    Attributes
    ----------
    path : str
        File that it was read from.
    axis : str
        Name of the axis.
    columns : dict of (n,) arrays
        float64, SI, by the names of `friction_hil.recordings.columns`; NaN where nothing was measured.
    metadata : dict
        Content of the file besides the columns: configuration, model, fingerprint.
    problems : list of str
        Faults of a file that could be read nevertheless, one sentence each.
    restarts : list of (int, array)
        Rows at which the state of the compensator is known, with the state *before* the step of that row; ordered.
    events : list of Event
        Faults and changes of settings.
    units : dict
        Units of columns as the file has them; not every format has units.
    others : tuple of str
        Columns of the file that were not requested.
    sources : dict of str
        What mapped and scaled columns were made of, as on the command line: ``{"torque": "vir*35.15"}``.
    texts : dict of str
        Columns of text, which are left out, each with an example of its content.
    labels : dict of str
        What the file says of its columns besides their names.
    rate_hz : float or None
        Sampling rate that the file states beside its rows.
    """

    path: str
    axis: str
    columns: dict[str, Array]
    metadata: dict[str, Any] = field(default_factory=dict)
    problems: list[str] = field(default_factory=list)
    restarts: list[tuple[int, Array]] = field(default_factory=list)
    events: list[Event] = field(default_factory=list)
    units: dict[str, str] = field(default_factory=dict)
    others: tuple[str, ...] = ()
    sources: dict[str, str] = field(default_factory=dict)
    texts: dict[str, str] = field(default_factory=dict)
    labels: dict[str, str] = field(default_factory=dict)
    rate_hz: float | None = None

    def __repr__(self) -> str:
        """Return what it holds in a few lines, and not its values."""
        told = f"{len(self.problems)} problems, {len(self.events)} events, {len(self.restarts)} restarts"
        names = textwrap.shorten(", ".join(self.columns), 300, placeholder=" ...")
        return f"Recording({self.path!r}, axis {self.axis!r}: {len(self)} rows; {told};\n  columns {names})"

    def __len__(self) -> int:
        return len(next(iter(self.columns.values()))) if self.columns else 0

    def __getitem__(self, name: str) -> Array:
        self.require(name)
        return self.columns[name]

    def __contains__(self, name: object) -> bool:
        """True if the column exists and has at least one value."""
        if name not in self.columns:
            return False
        values = self.columns[str(name)]
        return not bool(np.isnan(values[:1]).all() and np.isnan(values).all())

    def at(self, rows: NDArray[Any]) -> "Recording":
        """Return the recording with some rows, which a mask or indices select; restart points stay as they are."""
        return replace(self, columns={name: values[rows] for name, values in self.columns.items()})

    @property
    def period_s(self) -> float:
        """Median interval between time stamps, s; NaN with fewer than two rows."""
        return float(np.median(np.diff(self.columns[TIME]))) if len(self) > 1 else float("nan")

    @property
    def duration_s(self) -> float:
        """Time from the first row to the last, s."""
        return float(self.columns[TIME][-1] - self.columns[TIME][0]) if len(self) else 0.0

    @property
    def axis_kind(self) -> AxisKind | None:
        """Kind of the axis, if the recording has the configuration of the daemon; else None."""
        try:
            kind = self.metadata["configuration"]["axes"][self.axis]["model"]["axis"]
        except (KeyError, TypeError):
            return None
        return kind if kind in ("rotary", "linear") else None

    def require(self, *names: str) -> None:
        """Raise RecordingError if a column is missing or has no value; the message explains how to map one."""
        missing = [name for name in names if name not in self]
        if not missing:
            return
        known = [*(name for name in self.columns if name in self), *self.others]
        more = f" and {len(known) - _MOST_NAMED} more" if len(known) > _MOST_NAMED else ""
        there = ", ".join(known[:_MOST_NAMED]) or "none"
        rate = "; a recording without time stamps takes --rate HZ" if TIME in missing else ""
        from friction_hil.recordings.suggestion import suggest  # imported here: it needs this module

        options = shlex.join(suggest(self).options)
        raise RecordingError(
            f"{self.path}: no column {', '.join(missing)}. There are: {there}{more}. "
            f"A column of another name is mapped with {' '.join(f'--column {name}=NAME' for name in missing)}{rate}"
            + (f". By the names, try {options}; convert --info shows more" if options else "")
        )


def rename(recording: Recording, columns: Mapping[str, str], scale: Mapping[str, float]) -> None:
    """Rename columns to friction_hil's names, ``{'time_s': 't'}``, then multiply them by ``scale``, by new names.

    A column that already has the name is replaced. Several names may refer to one column. The factors of a product
    (`product_of`) remain as columns; the product has no unit. Raises `UsageError`: a column to be mapped or scaled does
    not exist or cannot be multiplied, or a factor is not finite, zero or too large.
    """
    if columns:
        _map_columns(recording, columns)
    recording.sources = {
        name: columns.get(name, name) + (f"*{scale[name]:.10g}" if name in scale else "")
        for name in dict.fromkeys((*columns, *scale))
    }
    for name, factor in scale.items():
        if name in recording.columns:
            _scale_column(recording, name, factor)
        elif name not in recording.others and name not in columns:
            there = {*recording.columns, *recording.others}
            raise UsageError(f"{recording.path}: --scale {name}: {choices(name, there)}")
    # what the file has in other units, as it says itself; what was given a factor is SI already
    for name in [each for each in recording.columns if each in NAMES and each not in scale]:
        given = recording.units.get(name, "")
        found = conversion(name, given) if given else None
        if found is None:
            continue
        if found.value != 1.0:
            source = recording.sources.get(name, name)
            _scale_column(recording, name, found.value)
            recording.sources[name] = f"{source}*{found.value:.10g}"
            recording.problems.append(f"{name} is in {given} in the file: multiplied by {found.factor}")
            recording.units[name] = found.to


def _map_columns(recording: Recording, columns: Mapping[str, str]) -> None:
    there = recording.columns
    names = {*there, *recording.others}
    taken: dict[str, Array] = {}
    units: dict[str, str] = {}
    renamed = set()
    for name, source in columns.items():
        try:
            product = product_of(source, names)
            missing = product.missing(names)
            if missing in recording.texts:
                raise UsageError(f"column {missing!r} holds text ({recording.texts[missing]!r}), no numbers")
            if missing:
                raise UsageError(("" if missing == source else f"no column {missing!r}; ") + absent(missing, names))
            if not product.is_plain:
                taken |= {} if product.missing(there) else {name: product.values(there)}
                continue
        except UsageError as error:
            raise UsageError(f"{recording.path}: --column {name}={source}: {error}") from None
        column = product.terms[0].column
        _refuse_other_quantity(recording, name, column)
        renamed.add(column)
        if column in there:
            taken[name] = there[column]
        given = recording.units.get(column, "") or ("" if column in NAMES else unit_in(column))
        if given and (name == TIME or conversion(TIME, given) is None):  # speed_ms is hardly in milliseconds
            units[name] = given
    kept = [name for name in there if name not in renamed and name not in columns]
    recording.columns = taken | {name: there[name] for name in kept}
    recording.units = units | {name: recording.units[name] for name in kept if name in recording.units}


def _refuse_other_quantity(recording: Recording, name: str, column: str) -> None:
    """Refuse one of friction_hil's columns in place of another quantity."""
    own, other = unit(name), unit(column)
    if not own or not other or own == other:
        return
    hint = (
        "; a recording without position needs none: it is integrated from the velocity"
        if name == "position" and column == "velocity"
        else ""
    )
    raise UsageError(f"{recording.path}: --column {name}={column}: {column} is in {other}, {name} in {own}{hint}")


def _scale_column(recording: Recording, name: str, factor: float) -> None:
    if not np.isfinite(factor) or factor == 0.0:
        raise UsageError(f"--scale {name}={factor:g}: a factor is finite and not zero")
    values = recording.columns[name]
    with np.errstate(over="ignore"):
        scaled = values * factor
    if np.isinf(scaled[np.isfinite(values)]).any():
        raise UsageError(f"{recording.path}: --scale {name}={factor:g}: what results is too large for a number")
    recording.columns[name] = scaled
    recording.units.pop(name, None)  # SI now


def count_time(recording: Recording, rate_hz: float) -> None:
    """Set the time stamps to those of an even sampling rate, Hz; report it if the file has others.

    Raises `UsageError`: the rate is no number above zero.
    """
    if not 0.0 < rate_hz < np.inf:
        raise UsageError(f"{recording.path}: a sampling rate is a number of Hz above 0, not {rate_hz:g}")
    if TIME in recording:
        recording.problems.append(f"{TIME} of the file is not used: time stamps are those of {rate_hz:g} Hz")
    recording.columns = {TIME: np.arange(len(recording)) / rate_hz} | {
        name: values for name, values in recording.columns.items() if name != TIME
    }
    recording.units.pop(TIME, None)


def count_where(recording: Recording, where: str, there: Mapping[str, Array]) -> None:
    """Set ``torque`` to NaN in the rows in which the column ``where`` is zero or NaN, and report it.

    ``there``: columns of the recording and of the file. Raises `RecordingError`: no row is left; `UsageError`: one of
    the columns does not exist.
    """
    if where not in there:
        raise UsageError(f"{recording.path}: --where {where}: {choices(where, {*there, *recording.others})}")
    if "torque" not in recording.columns:
        raise UsageError(
            f"{recording.path}: --where {where}: no column torque to count; map one with --column torque=NAME"
        )
    condition = there[where]
    is_out = (condition == 0.0) | np.isnan(condition)
    if is_out.all():
        raise RecordingError(f"{recording.path}: {where} is zero in all rows: the torque counts nowhere")
    if is_out.any():
        recording.columns["torque"] = np.where(is_out, np.nan, recording.columns["torque"])
        rows = rows_text(np.flatnonzero(is_out), len(condition))
        recording.problems.append(f"{where} is zero in {rows}: the torque does not count there")


def check(recording: Recording) -> None:
    """Refuse a recording that cannot be used, and add what is unusual to ``problems``.

    Raises `RecordingError`: there are no rows, no time stamps, or a time stamp is not finite.
    """
    if not len(recording):
        raise RecordingError(f"{recording.path}: there are no rows{_because(recording.problems)}")
    recording.require(TIME)
    time = recording.columns[TIME]
    if not is_ordinary(time):
        wrong = np.flatnonzero(~np.isfinite(time))
        if wrong.size:
            raise RecordingError(f"{recording.path}: {TIME} is not finite in {rows_text(wrong, len(time))}")
        raise RecordingError(f"{recording.path}: {TIME} is {time.min():g} to {time.max():g}: is it in seconds?")
    if not bool((time[1:] > time[:-1]).all()):
        steps = np.diff(time)
        for what, rows in (("goes backward", steps < 0.0), ("stands still", steps == 0.0)):
            if rows.any():
                recording.problems.append(f"{TIME} {what} at {rows_text(np.flatnonzero(rows) + 1, len(time))}")
    for name, values in recording.columns.items():
        if is_ordinary(values):
            continue
        is_absent = name in SPARSE or bool(np.isnan(values).all())
        wrong = np.flatnonzero(np.isinf(values) if is_absent else ~np.isfinite(values))
        if wrong.size:
            recording.problems.append(f"{name} is not finite in {rows_text(wrong, len(values))}")
        large = too_large(values)
        if large.size:
            recording.problems.append(
                f"{name} is beyond {LARGEST:g} in {rows_text(large, len(values))}: not used in computations"
            )
    for name, given in recording.units.items():
        problem = unit_problem(name, given, recording.sources.get(name, name))
        if problem:
            recording.problems.append(problem)
    if CYCLE in recording:
        _note_gaps(recording)


def _note_gaps(recording: Recording) -> None:
    cycle = without_overflow(recording.columns[CYCLE])
    if cycle[-1] - cycle[0] == len(cycle) - 1 and bool((cycle[1:] > cycle[:-1]).all()):
        return
    steps = np.diff(cycle)
    gaps = np.flatnonzero(steps > 1.0)
    if gaps.size:
        missing = float(np.sum(steps[gaps] - 1.0))
        recording.problems.append(
            f"{missing:.15g} cycles are missing in {gaps.size} gap{'s' * (gaps.size > 1)}, "
            f"the first after cycle {cycle[gaps[0]]:.0f}"
        )


def _because(problems: Iterable[str]) -> str:
    text = "; ".join(problems)
    return f": {text}" if text else ""
