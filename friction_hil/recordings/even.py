"""An even time grid for a log: rows are sorted, cut at gaps, and interpolated only where necessary. Pure.

Everything that is left out or changed is reported in a sentence.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from friction_hil.errors import RecordingError
from friction_hil.recordings.columns import TIME
from friction_hil.recordings.quality import (
    GAP_PERIODS,
    UNEVEN_RATIO,
    Array,
    RowIndices,
    all_finite,
    find_jumps,
    find_wrap,
    is_coarse,
    resolution,
    rows_text,
    spread,
    stamps_are_coarse,
    time_facts,
    unwrap,
    without_overflow,
)
from friction_hil.recordings.recording import Recording

_POSITION, _VELOCITY = "position", "velocity"
_FEWEST_ROWS = 3
_SHORTEST_PERIOD_S = 1e-12
_MOST_PERIODS_PER_ROW = 20  # more than a gap: columns may have rates of their own

Interval = tuple[float, float]


@dataclass(frozen=True, slots=True)
class EvenGrid:
    """Columns on an even grid."""

    time_s: Array
    columns: dict[str, Array]
    segments: tuple[slice, ...]  # between gaps; together all n rows
    rate_hz: float  # of sampling, in all segments
    problems: list[str]  # defects of the columns and their treatment


@dataclass(slots=True)
class _Block:
    """Rows whose time stamps increase."""

    time: Array
    columns: dict[str, Array]
    known: dict[str, RowIndices | None]  # rows in which a column has a value; None: all


def even_grid(recording: Recording, names: Sequence[str], held: Sequence[str] = ()) -> EvenGrid:
    """Bring columns to an even grid.

    Rows are sorted by time. A new segment begins where the clock was set back, or where more than `GAP_PERIODS`
    periods are missing in one of ``names``. Rows of a segment are used as they are if they are evenly spaced, and are
    interpolated otherwise. A wrapped position is unwrapped.

    ``recording`` has a finite ``time_s``, and each of ``names`` at least one value. Columns ``held`` change slowly;
    they are interpolated over their own gaps. Raises `RecordingError`: no segment has three rows.
    """
    problems: list[str] = []
    columns = {name: without_overflow(recording[name]) for name in (*names, *held)}
    for name in names:
        if not np.isfinite(columns[name]).any():
            raise RecordingError(f"{recording.path}: {'; '.join(recording.problems)}: no value of {name} can be used")
    _note_unknown(columns, held, problems)
    blocks = _ordered(recording[TIME], columns, problems)
    if all(len(block.time) < _FEWEST_ROWS for block in blocks):
        raise RecordingError(f"{recording.path}: {len(recording)} rows are too few")
    _unwrap(blocks, problems)
    period = min(_spacing(blocks, name) for name in names)
    if not np.isfinite(period):
        raise RecordingError(f"{recording.path}: {', '.join(names)} have too few values in order of time")
    if period < _SHORTEST_PERIOD_S:
        raise RecordingError(f"{recording.path}: {TIME} stands still: it needs the time of each row, in s")
    parts = _parts(blocks, names, period, problems)
    if not parts:
        raise RecordingError(f"{recording.path}: no part without a gap has {_FEWEST_ROWS} rows")
    ends = np.cumsum([0, *(len(time) for time, _ in parts)]).tolist()
    duration = sum(float(time[-1] - time[0]) for time, _ in parts)
    return EvenGrid(
        time_s=_joined([time for time, _ in parts]),
        columns={name: _joined([values[name] for _, values in parts]) for name in columns},
        segments=tuple(slice(begin, end) for begin, end in itertools.pairwise(ends)),
        rate_hz=sum(len(time) - 1 for time, _ in parts) / duration,
        problems=problems,
    )


def what_to_repair(recording: Recording) -> list[str]:
    """Return what a replay would repair in position and velocity, one sentence each."""
    problems: list[str] = []
    if _POSITION in recording:
        ignored: list[str] = []
        position = without_overflow(recording[_POSITION])
        _unwrap(_ordered(recording[TIME], {_POSITION: position}, ignored), problems)
    if _VELOCITY in recording:
        velocity = without_overflow(recording[_VELOCITY])
        if is_coarse(velocity):
            problems.append(f"{_VELOCITY} comes in steps of {resolution(velocity):.4g}, and mostly stands still")
    return problems


def _joined(parts: list[Array]) -> Array:
    return parts[0] if len(parts) == 1 else np.concatenate(parts)


def _note_unknown(columns: dict[str, Array], held: Sequence[str], problems: list[str]) -> None:
    for name, values in columns.items():
        if all_finite(values):
            continue
        wrong = np.flatnonzero(~np.isfinite(values))
        if wrong.size:
            cut = "" if name in held else f", unless more than {GAP_PERIODS:g} periods are missing"
            problems.append(f"{name} is not finite in {rows_text(wrong, len(values))}: interpolated{cut}")


def _ordered(time: Array, columns: dict[str, Array], problems: list[str]) -> list[_Block]:
    """Return blocks of rows with increasing time stamps, cut where the clock was set back."""
    facts = time_facts(time)
    back = facts.backward[time[facts.backward] - time[facts.backward - 1] < -GAP_PERIODS * facts.period_s]
    if back.size:
        problems.append(f"time_s is set back at {rows_text(back, len(time))}: a new part begins there")
    is_sorted = back.size == facts.backward.size
    if not is_sorted:
        problems.append(f"time_s goes backward at {rows_text(facts.backward, len(time))}: put in order")
    coarse = stamps_are_coarse(facts, len(time))
    if coarse:
        problems.append(
            f"time_s stands still at {facts.standing.size} of {len(time)} rows: its stamps are coarse, and the rows "
            "are spread evenly between them"
        )
    ends = [0, *back.tolist(), len(time)]
    blocks, repeated = [], []
    for begin, end in itertools.pairwise(ends):
        rows = slice(begin, end)
        stamps, values = time[rows], {name: column[rows] for name, column in columns.items()}
        if not is_sorted:
            order = np.argsort(stamps, kind="stable")
            stamps, values = stamps[order], {name: column[order] for name, column in values.items()}
        if coarse:
            stamps = spread(stamps)
        elif facts.standing.size or not is_sorted:
            keep = np.concatenate([[True], np.diff(stamps) > 0.0])
            repeated += (np.flatnonzero(~keep) + begin).tolist()
            stamps, values = stamps[keep], {name: column[keep] for name, column in values.items()}
        known = {
            name: None if all_finite(column) else np.flatnonzero(np.isfinite(column)) for name, column in values.items()
        }
        blocks.append(_Block(stamps, values, known))
    if repeated:
        problems.append(f"time_s stands still at {rows_text(repeated, len(time))}: the first of each stamp is taken")
    return blocks


def _known_values(block: _Block, name: str) -> tuple[Array, Array]:
    """Return time stamps and values of a column in the rows in which it is known."""
    known = block.known[name]
    values = block.columns[name]
    return (block.time, values) if known is None else (block.time[known], values[known])


def _unwrap(blocks: list[_Block], problems: list[str]) -> None:
    for block in blocks:
        if _POSITION not in block.columns:
            return
        time, position = _known_values(block, _POSITION)
        if len(position) < _FEWEST_ROWS:
            continue
        steps = np.diff(time)
        jumps = find_jumps(position, np.flatnonzero(steps > GAP_PERIODS * np.median(steps)) + 1)
        if not jumps.size:
            continue
        known = block.known[_POSITION]
        where = rows_text(jumps if known is None else known[jumps], len(block.time))
        wrap = find_wrap(position, jumps)
        if wrap is None:
            size = float(np.max(np.abs(np.diff(position))[jumps - 1]))
            problems.append(
                f"position jumps by up to {size:.6g} at {where}, which no encoder wrap explains: left unchanged"
            )
            continue
        problems.append(f"position wraps over {wrap.range:.6g} ({wrap.name}) at {where}: unwrapped")
        straight = block.columns[_POSITION].copy()
        straight[slice(None) if known is None else known] = unwrap(position, wrap)
        block.columns[_POSITION] = straight


def _spacing(blocks: list[_Block], name: str) -> float:
    """Return the median interval between values of a column, s; infinity if it has fewer than two."""
    steps = _joined([np.diff(_known_values(block, name)[0]) for block in blocks])
    return float(np.median(steps)) if steps.size else np.inf


def _intervals(block: _Block, names: Sequence[str], period: float) -> list[Interval]:
    """Return the intervals of time in which every column is known without a gap."""
    common: list[Interval] = [(-np.inf, np.inf)]
    for name in names:
        time, _ = _known_values(block, name)
        if not len(time):
            return []
        steps = np.diff(time)
        limit = GAP_PERIODS * max(period, float(np.median(steps)) if steps.size else period)
        gaps = np.flatnonzero(steps > limit)
        begins, ends = np.concatenate([time[:1], time[gaps + 1]]), np.concatenate([time[gaps], time[-1:]])
        own = list(zip(begins.tolist(), ends.tolist(), strict=True))
        common = _intersection(common, own)
    return common


def _intersection(some: list[Interval], others: list[Interval]) -> list[Interval]:
    found, i, j = [], 0, 0
    while i < len(some) and j < len(others):
        begin, end = max(some[i][0], others[j][0]), min(some[i][1], others[j][1])
        if begin <= end:
            found.append((begin, end))
        if some[i][1] < others[j][1]:
            i += 1
        else:
            j += 1
    return found


def _parts(
    blocks: Sequence[_Block], names: Sequence[str], period: float, problems: list[str]
) -> list[tuple[Array, dict[str, Array]]]:
    """Return time and columns of every segment; report gaps, uneven stamps and segments that are too short."""
    parts, cuts, short, sparse, is_uneven = [], [], 0, 0, False
    for block in blocks:
        intervals = _intervals(block, names, period)
        cuts += [begin for begin, _ in intervals[1:]]
        for interval in intervals:
            if _is_sparse(block, interval, period):
                sparse += 1
                continue
            time, values, was_uneven = _part(block, interval, period)
            if len(time) < _FEWEST_ROWS:
                short += 1
                continue
            is_uneven = is_uneven or was_uneven
            parts.append((time, values))
    if is_uneven:
        problems.append(f"the time stamps are uneven: interpolated at {1.0 / period:.6g} Hz")
    if sparse:
        what = f"{sparse} part{'s' * (sparse > 1)} with fewer than one row in {_MOST_PERIODS_PER_ROW} periods"
        problems.append(f"{what} of {period:g} s: left out")
    _note_parts(parts, cuts, short, problems)
    return parts


def _is_sparse(block: _Block, interval: Interval, period: float) -> bool:
    """True if the rows between two times are so far apart that nearly all of the even grid would be invented."""
    first, last = np.searchsorted(block.time, interval[0], "left"), np.searchsorted(block.time, interval[1], "right")
    time = block.time[first:last]
    return len(time) > 1 and float(time[-1] - time[0]) > _MOST_PERIODS_PER_ROW * len(time) * period


def _part(block: _Block, interval: Interval, period: float) -> tuple[Array, dict[str, Array], bool]:
    """Return time and columns of one segment, interpolated if need be, and whether its rows were uneven."""
    first, last = np.searchsorted(block.time, interval[0], "left"), np.searchsorted(block.time, interval[1], "right")
    time = block.time[first:last]
    if len(time) < _FEWEST_ROWS:
        return time, {}, False
    even = np.linspace(time[0], time[-1], 1 + round((time[-1] - time[0]) / period))
    is_even = len(even) == len(time) and float(np.max(np.abs(even - time))) <= UNEVEN_RATIO * period
    if is_even:
        even = time
    columns = {}
    for name, values in block.columns.items():
        if is_even and all_finite(values[first:last]):
            columns[name] = values[first:last]
        else:
            columns[name] = np.interp(even, *_known_values(block, name))
    return even, columns, not is_even


def _note_parts(
    parts: list[tuple[Array, dict[str, Array]]], cuts: list[float], short: int, problems: list[str]
) -> None:
    if cuts:
        times = ", ".join(f"{cut:.6g} s" for cut in cuts[:5]) + (", ..." if len(cuts) > 5 else "")
        gaps = f"{len(cuts)} gap{'s' * (len(cuts) > 1)}"
        problems.append(
            f"{gaps} of more than {GAP_PERIODS:g} periods, before {times}: {len(parts)} parts, each by itself"
        )
    if short:
        problems.append(f"{short} part{'s' * (short > 1)} of fewer than {_FEWEST_ROWS} rows: left out")
