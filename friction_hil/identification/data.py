"""Recordings as regression sees them: motion on an even grid, and one filter for both sides of the equation."""

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from friction_hil.errors import RecordingError, UsageError, choices
from friction_hil.numerics import filtering
from friction_hil.numerics.jit import Array
from friction_hil.recordings import Recording
from friction_hil.recordings.even import EvenParts, even_grid
from friction_hil.recordings.quality import is_coarse, resolution

Mask = NDArray[np.bool_]

DEFAULT_LOWPASS_SHARE = 0.1  # of the sampling rate
LEAST_ROWS = 50  # after decimation: below, errors of parameters and folds of cross-validation mean nothing
_STEADY_SHARE = 0.02  # of the top speed: slower changes of speed make an end of a record steady
_DEFAULT_DECIMATION = 10
_SLOW = ("load_torque", "temperature", "position_demand")  # taken along where they are known
_KNOWN_SHARE = 0.9  # of the rows
_ROWS_TO_KEEP = 1000  # decimation by default stops where fewer would be left


@dataclass(frozen=True, slots=True, eq=False)
class Record:
    """A recording ready for regression; arrays (n,) at the full rate, SI.

    Attributes
    ----------
    path, axis : str
        Where it came from.
    rows : int
        Of the recording.
    time_s, position, velocity, acceleration : array
        Low-passed where ``lowpass_hz`` is set.
    torque : array
        Measured, as it was recorded.
    load_torque, temperature, demand : array or None
        Where they were recorded; ``demand`` is that of the position.
    rate_hz : float
    lowpass_hz : float or None
        Cut-off of the zero-phase low-pass behind velocity and acceleration.
    decimation : int
        Each how many rows are kept for the regression.
    begin, end : int
        Rows between which the filters have settled.
    problems : tuple of str
        What had to be done to the recording.
    encoder : array
        Position as it was measured.
    resolution : float or None
        Step in which it came; None where it is not quantised.
    group : str
        Recordings of one group are held out together; empty for a group of its own.
    is_moving : array of bool or None
        Rows of the regression that count, of those that the filters leave; None for all.
    """

    path: str
    axis: str
    rows: int
    time_s: Array
    position: Array
    velocity: Array
    acceleration: Array
    torque: Array
    load_torque: Array | None
    temperature: Array | None
    demand: Array | None
    rate_hz: float
    lowpass_hz: float | None
    decimation: int
    begin: int
    end: int
    problems: tuple[str, ...]
    encoder: Array
    resolution: float | None
    group: str = field(default="", kw_only=True)
    is_moving: Mask | None = field(default=None, kw_only=True)

    @property
    def dt(self) -> float:
        """Sampling period, s."""
        return 1.0 / self.rate_hz

    def reduce(self, values: Array) -> Array:
        """Bring (n,) or (n, m) values at the full rate to the rows of the regression, through the filters.

        Acceleration comes from a low-passed position, so that everything else has to pass that low-pass too;
        but where the decimator, which all of it passes, cuts off well below it, the low-pass changes nothing that
        is left (4 parts in 10,000 of the highest frequency) and costs as much as the model.
        """
        if self.lowpass_hz is not None and not self._is_lowpass_idle:
            values = filtering.lowpass(values, self.lowpass_hz, self.rate_hz)
        return self.reduce_smooth(values)

    def reduce_smooth(self, values: Array) -> Array:
        """`reduce` of what comes from the low-passed position."""
        reduced = filtering.decimate(values[self.begin : self.end], self.decimation)
        return reduced if self.is_moving is None else reduced[self.is_moving]

    def reduced_torque(self) -> Array:
        """Measured torque in the rows of the regression."""
        return self.reduce(self.torque)

    def reduced_time(self) -> Array:
        """Time stamps of the rows of the regression."""
        time = self.time_s[self.begin : self.end]
        time = time if self.decimation == 1 else time[filtering.decimated_rows(len(time), self.decimation)]
        return time if self.is_moving is None else time[self.is_moving]

    @property
    def _is_lowpass_idle(self) -> bool:
        if self.lowpass_hz is None or self.decimation == 1:
            return False
        return filtering.DECIMATOR_SHARE * self.rate_hz / (2.0 * self.decimation) <= 0.5 * self.lowpass_hz


def prepare(
    recording: Recording,
    *,
    lowpass_hz: float | None = None,
    decimation: int | None = None,
    least_speed: float = 0.0,
    group_by: str | None = None,
) -> list[Record]:
    """Make a recording ready for regression.

    Parameters
    ----------
    recording : Recording
        With ``position`` and ``torque``.
    lowpass_hz : float, optional
        Cut-off of the zero-phase low-pass; velocity and acceleration then come from the position. Without it the
        recorded velocity is taken, or where there is none, a tenth of the sampling rate.
    decimation : int, optional
        Keep each n-th row for the regression; the models run at the full rate. 10, or less in a short recording.
    least_speed : float
        Rows at which the axis is slower do not count: friction at rest is whatever holds the axis, which no map of
        the velocity knows, nor a spring in presliding where the position is too coarse to see it.
    group_by : str, optional
        Entry of the metadata whose value names the group of the recording.

    Returns
    -------
    list of Record
        One for each part between gaps.

    Raises
    ------
    RecordingError
        A column is missing, or there are too few rows.
    UsageError
        A filter does not fit the sampling rate.
    """
    recording.require("position", "torque")
    problems = list(recording.problems)
    has_velocity = "velocity" in recording and lowpass_hz is None
    why = "no velocity"
    if has_velocity and is_coarse(recording["velocity"]):
        has_velocity = False
        why = f"velocity comes in steps of {resolution(recording['velocity']):.4g}, and mostly stands still"
    held = [name for name in _SLOW if name in recording and np.mean(np.isfinite(recording[name])) >= _KNOWN_SHARE]
    grid = even_grid(recording, ["position", "torque", *(["velocity"] if has_velocity else [])], held)
    problems += grid.problems
    delay_s = _torque_delay_s(recording)
    if delay_s:
        problems.append(f"the drive's torque was read {1e3 * delay_s:.3g} ms late: moved back by as much")
        torque = grid.columns["torque"] = grid.columns["torque"].copy()
        for part in grid.segments:
            torque[part] = np.interp(grid.time_s[part] + delay_s, grid.time_s[part], torque[part])
    if not has_velocity and lowpass_hz is None:
        lowpass_hz = DEFAULT_LOWPASS_SHARE * grid.rate_hz
        problems.append(f"{why}: derived from the position below {lowpass_hz:.4g} Hz")
    if lowpass_hz is not None and not 0.0 < lowpass_hz < grid.rate_hz / 2.0:
        raise UsageError(
            f"{recording.path}: a low-pass lies above 0 and below half the sampling rate, {grid.rate_hz / 2.0:.6g} Hz, "
            f"not at {lowpass_hz:g} Hz"
        )
    longest = max(part.stop - part.start for part in grid.segments)
    factor = decimation if decimation is not None else min(_DEFAULT_DECIMATION, max(1, longest // _ROWS_TO_KEEP))
    if factor < 1:
        raise UsageError(f"decimate by a whole number from 1, not {factor}")
    settling = 0 if lowpass_hz is None else filtering.settling_samples(lowpass_hz, grid.rate_hz)
    padding = max(filtering.lowpass_padding(), filtering.decimation_padding())
    fewest = 2 * settling + padding + LEAST_ROWS * factor
    kept = [part for part in grid.segments if part.stop - part.start >= fewest]
    if not kept:
        raise RecordingError(
            f"{recording.path}: {longest} rows without a gap are too few: the filters take {2 * settling + padding} to "
            f"settle, and {LEAST_ROWS} must be left where 1 in {factor} is kept; record for longer, or raise --lowpass"
        )
    if len(kept) < len(grid.segments):
        rows = sum(part.stop - part.start for part in grid.segments if part not in kept)
        problems.append(f"parts of fewer than {fewest} rows are too short for the filters: {rows} rows left out")
    group = _group(recording, group_by)
    records = [_record(recording, grid, part, lowpass_hz, factor, settling, tuple(problems)) for part in kept]
    records = [replace(each, group=group) for each in records]
    return records if least_speed == 0.0 else _moving(records, least_speed)


def _torque_delay_s(recording: Recording) -> float:
    """How much older the torque is than the position in the same row, as the driver stated it."""
    facts = [each for each in recording.metadata.get("facts", ()) if each["name"] == recording.axis]
    delay_s = facts[0].get("torque_delay_s", 0.0) if facts else 0.0
    if delay_s is None and not recording["torque"].any():
        raise RecordingError(
            f"{recording.path}: the drive of axis {recording.axis} does not tell its torque; in mode cst the command "
            "is nearly that: --column torque=command"
        )
    return float(delay_s or 0.0)


def _group(recording: Recording, group_by: str | None) -> str:
    if group_by is None:
        return ""
    if group_by not in recording.metadata:
        there = choices(group_by, map(str, recording.metadata)) if recording.metadata else "it has none"
        raise UsageError(f"{recording.path}: nothing called {group_by!r} beside the rows to group by; {there}")
    return f"{group_by} {recording.metadata[group_by]}"


def _moving(records: Sequence[Record], least_speed: float) -> list[Record]:
    """Let only rows count at which the axis moves; a record without any is left out."""
    if not (0.0 < least_speed < math.inf):
        raise UsageError(f"the least speed that counts is a number above 0, not {least_speed:g}")
    found = []
    masks = [np.abs(record.reduce_smooth(record.velocity)) >= least_speed for record in records]
    for record, is_moving in zip(records, masks, strict=True):
        note = f"slower than {least_speed:g}: {np.count_nonzero(~is_moving)} of {len(is_moving)} rows do not count"
        if is_moving.any():
            found.append(replace(record, is_moving=is_moving, problems=(*record.problems, note)))
    return found


def _record(
    recording: Recording,
    grid: EvenParts,
    part: slice,
    lowpass_hz: float | None,
    decimation: int,
    settling: int,
    problems: tuple[str, ...],
) -> Record:
    columns = {name: np.ascontiguousarray(values[part]) for name, values in grid.columns.items()}
    position, n = columns["position"], part.stop - part.start
    if lowpass_hz is not None:
        position = filtering.lowpass(position, lowpass_hz, grid.rate_hz)
    has_velocity = "velocity" in columns and lowpass_hz is None
    velocity = columns["velocity"] if has_velocity else np.gradient(position, 1.0 / grid.rate_hz)
    end = n - settling
    if settling and np.ptp(velocity[end:]) < _STEADY_SHARE * np.max(np.abs(velocity)):
        end = n  # the filters extend a record as one that goes on as it ended: here, that is right
    return Record(
        path=recording.path,
        axis=recording.axis,
        rows=len(recording),
        time_s=grid.time_s[part],
        position=position,
        velocity=velocity,
        acceleration=np.gradient(velocity, 1.0 / grid.rate_hz),
        torque=columns["torque"],
        load_torque=columns.get("load_torque"),
        temperature=columns.get("temperature"),
        demand=columns.get("position_demand"),
        rate_hz=grid.rate_hz,
        lowpass_hz=lowpass_hz,
        decimation=decimation,
        begin=settling,
        end=end,
        problems=problems,
        encoder=columns["position"],
        resolution=resolution(columns["position"]),
    )


class Data:
    """Several records stacked for one regression.

    Parameters
    ----------
    records : sequence of Record
    known : mapping, optional
        Torque per unit of linear parameters that are known while the gain of the drive is not: together they are the
        column ``drive.inverse_gain``.

    Attributes
    ----------
    records : tuple of Record
    parts : tuple of slice
        Rows of each record in the stack.
    torque : (k,) array
        Measured torque, reduced.
    """

    def __init__(self, records: Sequence[Record], known: Mapping[str, float] | None = None) -> None:
        self.records = tuple(records)
        self.known = dict(known or {})
        reduced = [record.reduced_torque() for record in self.records]
        ends = np.cumsum([0, *map(len, reduced)])
        self.parts = tuple(slice(int(a), int(b)) for a, b in itertools.pairwise(ends))
        self.torque: Array = np.concatenate([np.empty(0), *reduced])
        self._columns: dict[str, Array] = {}

    def __len__(self) -> int:
        return len(self.torque)

    def stack(self, values: Sequence[Array]) -> Array:
        """Reduce full-rate (n,) or (n, m) values of each record and put them under each other."""
        return np.concatenate([record.reduce(each) for record, each in zip(self.records, values, strict=True)])

    def column(self, name: str) -> Array:
        """Torque per unit of a linear parameter, reduced (k,); remembered by its name."""
        if name == "drive.inverse_gain" and name not in self._columns:
            self._columns[name] = sum(
                (value * self.column(each) for each, value in self.known.items()), start=np.zeros(len(self))
            )
        elif name not in self._columns:
            parts = []
            for record in self.records:
                if name == "inertia":
                    parts.append(record.reduce_smooth(record.acceleration))
                else:
                    parts.append(record.reduce(linear_column(name, record)))
            self._columns[name] = np.concatenate(parts)
        return self._columns[name]

    def motion(self, name: str) -> Array:
        """Position, velocity, acceleration, load_torque or temperature, reduced (k,)."""
        return np.concatenate([record.reduce_smooth(getattr(record, name)) for record in self.records])

    @property
    def time_s(self) -> Array:
        """Time stamps of the reduced rows (k,)."""
        return np.concatenate([record.reduced_time() for record in self.records])


def linear_column(key: str, record: Record) -> Array:
    """Torque at the full rate per unit of a parameter that the torque is linear in.

    Parameters
    ----------
    key : str
        ``offset``, ``gravity.constant``, ``gravity.sine``, ``gravity.cosine``, ``viscous``, ``viscous.positive`` and
        ``viscous.negative`` (in one direction alone), ``viscous.quadratic``, ``viscous.cubic``, ``drive.back_emf``, or
        ``ripple.cosine@K`` and ``ripple.sine@K`` with K the angle per position, rad/rad or rad/m.
    """
    v, q = record.velocity, record.position
    kind, _, angle = key.partition("@")
    match kind:
        case "offset" | "gravity.constant":
            return np.ones_like(v)
        case "gravity.sine":
            return np.sin(q)
        case "gravity.cosine":
            return np.cos(q)
        case "viscous" | "drive.back_emf":
            return v
        case "viscous.positive":
            return np.maximum(v, 0.0)
        case "viscous.negative":
            return np.minimum(v, 0.0)
        case "viscous.quadratic":
            return v * np.abs(v)
        case "viscous.cubic":
            return v * v * v
        case "ripple.cosine":
            return np.cos(float(angle) * q)
        case "ripple.sine":
            return np.sin(float(angle) * q)
    raise KeyError(key)
