"""Read and write MDF 4 (ASAM) with asammdf, a channel with its unit for each column; read MDF 3."""

import contextlib
import gc
import io
import logging
import sys
from pathlib import Path
from typing import Any

import numpy as np

from friction_hil.errors import RecordingError
from friction_hil.recordings.columns import TIME
from friction_hil.recordings.recording import Array, Recording
from friction_hil.recordings.source import Source, as_column, needs_extra, new_file
from friction_hil.recordings.units import known_unit

_MAGIC = (b"MDF     ", b"UnFinMF ")
_NAMED = 5  # channels that a message lists
_LONGEST_REASON = 200  # characters of the library's message
_SPARE_FLAGS = 8  # bytes beyond one for each channel, which needs a bit; with more the library reads elsewhere
_SMALLEST = 168  # bytes of identification and header of MDF 4; MDF 3 has more


def read(source: Source) -> list[Recording]:
    """Read every channel with one number per sample; the time of the groups is ``time_s``.

    Groups with the same time stamps form one table. Otherwise the rows of all groups are sorted by time, and a channel
    is NaN where it has no sample. Raises `RecordingError`: the file was cut off, is not MDF, or has no channel;
    `UsageError`: asammdf is not installed; `OSError`: the file cannot be opened.
    """
    library = _library(source.path)
    size = source.path.stat().st_size
    with source.path.open("rb") as file:
        start = file.read(8)
    if not start:
        raise RecordingError(f"{source.path} is empty")
    if start not in _MAGIC or size < _SMALLEST:
        is_mdf = start in _MAGIC
        raise RecordingError(f"{source.path} {f'was cut off at byte {size}' if is_mdf else 'is no MDF file'}")
    recording = Recording(str(source.path), source.name, {})
    failure = ""
    try:
        with contextlib.redirect_stdout(io.StringIO()), library.MDF(str(source.path)) as mdf:  # it prints what it lacks
            _take(recording, source, mdf)
    except RecordingError:
        raise
    except Exception as error:  # noqa: BLE001 - the library raises whatever damaged bytes lead it to
        failure = " ".join(str(error).split())[:_LONGEST_REASON] or type(error).__name__
    if failure:
        _collect_quietly()
        raise RecordingError(f"{source.path} was cut off, at byte {size}, or is damaged: its rows are lost ({failure})")
    return [recording]


def _collect_quietly() -> None:
    """Collect readers that failed half-way now: their destructors would print errors to stderr later."""
    hook, sys.unraisablehook = sys.unraisablehook, lambda _: None
    gc.collect()
    sys.unraisablehook = hook


def write(path: Path, recording: Recording, *, overwrite: bool) -> None:
    """Write one channel group whose time is ``time_s``.

    Raises `UsageError`: asammdf is not installed; `OSError`: the file exists, unless ``overwrite``, or cannot be
    written.
    """
    library = _library(path)
    time = recording[TIME]
    signals = [
        library.Signal(values, time, name=name, unit=known_unit(recording.units, name))
        for name, values in recording.columns.items()
        if name != TIME
    ]
    with new_file(path, overwrite=overwrite) as part:
        with part.open("ab"):
            pass  # the library overwrites without asking, and does not say why it cannot write
        with library.MDF(version="4.10") as mdf:
            mdf.append(signals, common_timebase=True)
            saved = Path(mdf.save(str(part), overwrite=True))
        if saved != part:  # the library may change the suffix
            saved.replace(part)


def _library(path: Path) -> Any:
    try:  # imported here: an optional package
        import asammdf
    except ImportError:
        raise needs_extra(path, "asammdf") from None
    logging.getLogger("asammdf").setLevel(logging.CRITICAL + 1)  # what it logs is reported in one sentence
    return asammdf


def _take(recording: Recording, source: Source, mdf: Any) -> None:
    """Fill the columns of a recording."""
    there, rows = _channels(mdf, recording.problems)
    if not there:
        reasons = "".join(f"; {problem}" for problem in recording.problems)
        raise RecordingError(f"{source.path}: there is no channel with samples in it{reasons}")
    wanted, recording.others = source.split(there)
    numbers = {there[name][0] for name in wanted}
    source.memory.take(
        sum(rows[there[name][0]] for name in wanted) * 8
        + sum(rows[number] * int(mdf.groups[number].channel_group.samples_byte_nr) for number in numbers)
    )
    signals = mdf.select([(None, *there[name]) for name in wanted], copy_master=False) if wanted else []
    times: dict[int, Array] = {}  # by group
    for name, signal in zip(wanted, signals, strict=True):
        number = there[name][0]
        if number in times:
            continue
        times[number] = as_column(signal.timestamps)
        if len(times[number]) < rows[number]:
            recording.problems.append(
                f"group {number} has {len(times[number])} of {rows[number]} samples: the file was cut off, the others "
                "are lost"
            )
    if not times:
        number = next(iter(there.values()))[0]
        times[number] = as_column(mdf.get_master(number))
    recording.columns[TIME] = _merged_time(times, recording.problems)
    for name, signal in zip(wanted, signals, strict=True):
        _take_signal(recording, name, signal, times[there[name][0]])


def _channels(mdf: Any, problems: list[str]) -> tuple[dict[str, tuple[int, int]], dict[int, int]]:
    """Return group and index of each channel with samples by its name, and the number of samples of each group."""
    there: dict[str, tuple[int, int]] = {}
    rows: dict[int, int] = {}
    for number, group in enumerate(mdf.groups):
        rows[number] = int(group.channel_group.cycles_nr)
        flags = int(getattr(group.channel_group, "invalidation_bytes_nr", 0))
        if flags > len(group.channels) + _SPARE_FLAGS:
            problems.append(
                f"group {number}: the file is damaged: {flags} bytes of flags in a record for {len(group.channels)} "
                "channels: left out"
            )
            continue
        master = mdf.masters_db.get(number)
        outside = {index for index, channel in enumerate(group.channels) if not _fits(channel, group.channel_group)}
        if outside:
            names = ", ".join(group.channels[index].name or "one without a name" for index in sorted(outside)[:_NAMED])
            problems.append(
                f"{names}: the file is damaged: {len(outside)} channels lie outside their records: left out"
            )
        if master in outside:
            continue
        for index, channel in enumerate(group.channels):
            if index != master and rows[number] and index not in outside:
                name = channel.name
                there[name if name not in there else f"{name}@{number}"] = number, index
    return there, rows


def _fits(channel: Any, group: Any) -> bool:
    """True if the bits of a channel lie within the record; elsewhere the library reads memory that is not its own."""
    if hasattr(channel, "byte_offset"):  # MDF 4
        begin = 8 * channel.byte_offset + channel.bit_offset
    else:
        begin = 8 * channel.additional_byte_offset + channel.start_offset
    return bool(begin + channel.bit_count <= 8 * group.samples_byte_nr)


def _merged_time(times: dict[int, Array], problems: list[str]) -> Array:
    """Return the time stamps of all groups in one sorted array; report groups with different ones."""
    first = next(iter(times.values()))
    if all(np.array_equal(time, first) for time in times.values()):
        return first
    problems.append(
        f"{len(times)} groups of channels have time stamps of their own: merged, NaN where a channel has no sample"
    )
    return np.unique(np.concatenate(list(times.values())))


def _take_signal(recording: Recording, name: str, signal: Any, own: Array) -> None:
    """Add a channel with the time stamps ``own`` as a column; report one that holds no numbers."""
    values = np.asarray(signal.samples)
    if values.dtype.kind not in "fiub" or values.ndim != 1:
        recording.problems.append(f"{name} holds {values.dtype} of shape {values.shape}, no numbers: left out")
        return
    column = as_column(values)
    invalid = getattr(signal, "invalidation_bits", None)
    if invalid is not None and np.any(invalid):
        column[np.asarray(invalid, dtype=bool)] = np.nan
    time = recording.columns[TIME]
    if len(column) < len(time) or not np.array_equal(time, own):
        merged = np.full(len(time), np.nan)
        merged[np.searchsorted(time, own[: len(column)])] = column
        column = merged
    recording.columns[name] = column
    if signal.unit:
        recording.units[name] = str(signal.unit)
