"""Reading and writing of recordings; the suffix of the file selects the format."""

import importlib
import re
import shlex
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from friction_hil.errors import RecordingError, UsageError, choices
from friction_hil.recordings import parts
from friction_hil.recordings.bounds import Memory
from friction_hil.recordings.columns import TIME
from friction_hil.recordings.mapping import Mapped, mapping_of
from friction_hil.recordings.matrices import array_of
from friction_hil.recordings.product import columns_of
from friction_hil.recordings.recording import Array, Recording, check, count_time, count_where, rename
from friction_hil.recordings.source import Source

if TYPE_CHECKING:
    from friction_hil.config import Configuration

_MODULES = {
    ".mcap": "mcap_reader",
    ".csv": "csv_file",
    ".txt": "csv_file",
    ".tsv": "csv_file",
    ".dat": "csv_file",
    ".lvm": "csv_file",
    ".parquet": "parquet_file",
    ".mf4": "mdf_file",
    ".mdf": "mdf_file",
    ".h5": "hdf5_file",
    ".hdf5": "hdf5_file",
    ".mat": "mat_file",
    ".npz": "npz_file",
    ".npy": "npz_file",
    ".json": "json_file",
    ".log": "can_log",
    ".asc": "can_log",
    ".blf": "can_log",
    ".trc": "can_log",
    ".bag": "ros_bag",
    ".db3": "ros_database",
}
_READ_ONLY = (".txt", ".tsv", ".dat", ".lvm", ".npy", ".mdf", ".log", ".asc", ".blf", ".trc", ".bag", ".db3")
_WRITERS = {suffix: name for suffix, name in _MODULES.items() if suffix not in _READ_ONLY} | {".mcap": "mcap_writer"}
"""Module by suffix, with `read(source)`, which returns recordings, and `write(path, recording, overwrite=)`."""
_PICKLES = (".pkl", ".pickle")
_HEAD = 4000  # bytes that show whether a log holds frames, as candump writes or prints them
_SHARED = (".log", ".txt")  # no others are opened for that: what a pipe has given is gone
_FRAME = (
    rb"^\s*(?:\x1b\[[0-9;]*m)*(?:\([^()]*\)\s+)?[A-Za-z]\S*\s+(?:[RT]X\s+\S\s+\S\s+)?[0-9A-Fa-f]{3,8}(?:#|\s+\[\d+\])"
)
_LONGEST_SUFFIX = 8
_LONGEST_GAP = 10  # periods: beyond, values between two rows of the other file are unknown


def formats(*, to_write: bool = False) -> tuple[str, ...]:
    """Return the suffixes of the files that can be read, or written."""
    return tuple(sorted(_WRITERS if to_write else _MODULES))


def read(
    path: str | Path,
    axis: str | None = None,
    *,
    columns: Mapping[str, str] | None = None,
    scale: Mapping[str, float] | None = None,
    where: str | None = None,
    rate_hz: float | None = None,
    only: Collection[str] | None = None,
    configuration: "Configuration | None" = None,
    is_alone: bool = False,
    is_preview: bool = False,
) -> Recording:
    """Read one axis of a recording; `formats` lists the suffixes.

    Parameters
    ----------
    path : path
        File to read; its suffix selects the format. ``NAME.columns.yaml`` beside it, or ``columns.yaml`` for all files
        of the folder, may map columns; ``columns`` and ``scale`` take precedence.
    axis : str, optional
        Name of the axis; required if the file has several. The only axis of a table of columns has no name: it is
        given this one, or else that of the file.
    columns : dict, optional
        friction_hil's name of a column to the file's: ``{"time_s": "t", "torque": "effort"}``, or to a product of
        columns: ``{"torque": "load:int16*input_volts/885"}`` (`friction_hil.recordings.product`), or to a column of a
        file beside this one: ``{"torque": "torque.csv:tau"}`` (`friction_hil.recordings.files`).
    scale : dict, optional
        friction_hil's name of a column to the factor that converts it to SI: ``{"torque": 35.15}``.
    where : str, optional
        Column, by friction_hil's name or the file's. In rows in which it is zero or NaN, ``torque`` becomes NaN.
    rate_hz : float, optional
        Sampling rate of a file without time stamps, Hz; time stamps of the file are not used.
    only : sequence of str, optional
        friction_hil's names of the columns to load, if they exist; all by default.
    configuration : Configuration, optional
        Configuration of the machine; required for a CAN log.
    is_alone : bool
        True to read this file alone, also if it is the first of several into which the daemon has divided a recording;
        otherwise those that follow are read with it.
    is_preview : bool
        True if time stamps may be missing.

    Raises
    ------
    RecordingError
        The file cannot be read, has no finite ``time_s``, or ``where`` leaves no torque.
    UsageError
        The suffix is unknown, the file has several axes or not this one, a mapped column does not exist, or a package
        is not installed.
    """

    def one(names: list[str]) -> list[str]:
        if axis is None and len(names) > 1:
            raise UsageError(f"{path} has several axes; choose one with --axis; {choices('', names)}")
        if axis is not None and axis not in names:
            raise UsageError(f"{path} has no axis {axis!r}; {choices(axis, names)}")
        return names if axis is None else [axis]

    mapped = mapping_of(Path(path), columns or {}, scale or {}, rate_hz)
    source = Source(Path(path), axis, None, one, configuration)
    (recording,) = _read(source, mapped, where, only, is_alone=is_alone, is_preview=is_preview)
    return recording


def read_all(
    path: str | Path,
    *,
    columns: Mapping[str, str] | None = None,
    scale: Mapping[str, float] | None = None,
    where: str | None = None,
    rate_hz: float | None = None,
    only: Collection[str] | None = None,
    configuration: "Configuration | None" = None,
    is_alone: bool = False,
    is_preview: bool = False,
) -> dict[str, Recording]:
    """Read all axes of a recording; return them by name.

    Parameters are as of `read`.
    """
    mapped = mapping_of(Path(path), columns or {}, scale or {}, rate_hz)
    source = Source(Path(path), configuration=configuration)
    found = _read(source, mapped, where, only, is_alone=is_alone, is_preview=is_preview)
    return {recording.axis: recording for recording in found}


def write(path: str | Path, recording: Recording, *, overwrite: bool = False) -> None:
    """Write one axis; ``formats(to_write=True)`` lists the suffixes.

    Values are kept bit for bit, and units if the format can hold them. Metadata, events and restart points are not
    written.

    Parameters
    ----------
    path : path
        File to write.
    recording : Recording
    overwrite : bool
        True to replace an existing file.

    Raises
    ------
    RecordingError
        The file exists or cannot be written, or the format cannot hold the name of a column.
    UsageError
        This format cannot be written, or a package is not installed.
    """
    path = Path(path)
    module = _module(path, _WRITERS)
    try:
        module.write(path, recording, overwrite=overwrite)
    except FileExistsError:
        raise RecordingError(f"{path} exists already; --force replaces it") from None
    except OSError as error:
        raise RecordingError(f"{path} cannot be written: {error.strerror or error}") from None


def _read(
    source: Source,
    mapped: Mapped,
    where: str | None,
    only: Collection[str] | None,
    *,
    is_alone: bool,
    is_preview: bool = False,
) -> list[Recording]:
    """Read the axes of a file, with the files that continue it unless ``is_alone``, by friction_hil's names."""
    if only is not None:
        condition = set() if where is None else {where, *mapped.sources(where)}
        source = replace(source, wanted=frozenset(condition.union(*map(mapped.sources, only))), shared=source.memory)
    files = [source.path]
    if source.path.suffix.lower() == parts.SUFFIX and not is_alone:
        files = parts.parts_of(source.path)
    if len(files) == 1:
        recordings = _read_file(source)
    else:
        memory = Memory(*files)
        recordings = parts.read_as_one(files, lambda path: _read_file(replace(source, path=path, shared=memory)))
    return [mapped_to(each, mapped, where, only, is_preview=is_preview) for each in recordings]


def mapped_to(
    recording: Recording, mapped: Mapped, where: str | None, only: Collection[str] | None = None, *, is_preview: bool
) -> Recording:
    """Rename and scale the columns of a recording, check it, and return it."""
    fitting = mapped.fitting({*recording.columns, *recording.others})
    if only is not None:
        fitting = fitting.without(_not_looked_at(fitting, only, recording))
    if sources := [*fitting.columns.values(), *([] if where is None else [where])]:
        time_source = "" if mapped.rate_hz is not None else fitting.columns.get(TIME, TIME)
        add_columns_beside(recording, sources, time_source, _MODULES, lambda path: _read_file(Source(path)))
    before = recording.columns
    rename(recording, fitting.columns, fitting.scale)
    if mapped.rate_hz is not None:
        count_time(recording, mapped.rate_hz)
    there: dict[str, Array] = {**before, **recording.columns}
    if only is not None:  # others were read because mapped columns are products of them
        recording.others += tuple(name for name in recording.columns if name not in only)
        recording.columns = {name: values for name, values in recording.columns.items() if name in only}
        recording.units = {name: unit for name, unit in recording.units.items() if name in only}
    if TIME in recording.columns or not is_preview:
        check(recording)
    if where is not None:
        count_where(recording, where, there)
    return recording


def _not_looked_at(mapped: Mapped, only: Collection[str], recording: Recording) -> set[str]:
    """Return the columns that are not requested and come from a file or a matrix that was not read."""
    return {
        name
        for name, source in mapped.columns.items()
        if name not in only
        and any(
            is_beside(each, _MODULES) or (each not in recording.others and array_of(each) in recording.others)
            for each in columns_of(source)
        )
    }


def _read_file(source: Source) -> list[Recording]:
    """Read the axes of one file with the names of the file."""
    is_shared = source.path.suffix.lower() in _SHARED
    module = _module(source.path, _MODULES | _by_content(source) if is_shared else _MODULES)
    try:
        found: list[Recording] = module.read(source)
    except OSError as error:
        raise RecordingError(f"{source.path} cannot be read: {error.strerror or error}") from None
    except MemoryError:
        raise RecordingError(f"{source.path} does not fit into the memory: split it into shorter files") from None
    return found


def _by_content(source: Source) -> dict[str, str]:
    """Return the module of a suffix that logs of frames and tables share; a log of frames needs a configuration."""
    suffix = source.path.suffix.lower()
    try:
        with source.path.open("rb") as file:
            has_frames = re.search(_FRAME, file.read(_HEAD), re.MULTILINE) is not None
    except OSError:
        return {}  # the reader says what is wrong
    if suffix == ".log" and not has_frames and source.configuration is None:
        return {suffix: "csv_file"}
    return {suffix: "can_log"} if suffix == ".txt" and has_frames else {}


def _module(path: Path, known: Mapping[str, str]) -> Any:
    suffix = path.suffix.lower()
    if suffix in _PICKLES and known is not _WRITERS:
        code = f"import pandas; pandas.read_pickle({path.name!r}).to_parquet({path.with_suffix('.parquet').name!r})"
        raise UsageError(
            f"{path}: a pickle can run any code when it is read, so it is not read here. Where you trust it, convert "
            f"it with python -c {shlex.quote(code)}, or give its data frame to friction_hil in Python"
        )
    if suffix not in known and path.is_dir():
        raise UsageError(f"{path} is a folder; name a recording in it")
    if suffix not in known:
        raise UsageError(f"{path}: the suffix {suffix!r} is not known here; {choices(suffix, known)}")
    return importlib.import_module(f"friction_hil.recordings.{known[suffix]}")


def add_columns_beside(
    recording: Recording,  # with the names of its file
    sources: Iterable[str],  # of columns, such as `torque.csv:tau*0.5`
    time_source: str,  # of the time stamps in both files; if it is empty, or in another file, rows are counted
    suffixes: Collection[str],  # of files that can be read
    read: Callable[[Path], list[Recording]],  # the axes of a file, with the names of the file
) -> None:
    """Add each column of another file that a source refers to, under the name by which it does.

    If both files have a column of time stamps, values are interpolated at the times of the recording. Otherwise the
    files are joined row by row. Raises `RecordingError`: a file cannot be read, or the times or the numbers of rows do
    not match; `UsageError`: there is no such file, or no such column in it.
    """
    if is_beside(time_source, suffixes):
        time_source = ""
    files: dict[Path, Recording] = {}
    for name in dict.fromkeys(each for source in sources for each in columns_of(source)):
        if name in recording.columns or name in recording.others:
            continue
        file, column = _file_and_column(name, suffixes)
        if not file:
            continue
        path = _found(Path(recording.path), file, name)
        if path not in files:
            files[path] = _only_axis(path, read(path))
        other = files[path]
        if column not in other.columns:
            raise UsageError(f"{path}: there is no column {column!r}; {choices(column, other.columns)}")
        recording.columns[name] = _joined(recording, other, column, time_source)
        if column in other.units:
            recording.units[name] = other.units[column]
    for path, other in files.items():
        recording.problems += [f"{path.name}: {problem}" for problem in other.problems]


def is_beside(name: str, suffixes: Collection[str]) -> bool:
    """True if the name of a column refers to another file."""
    return bool(_file_and_column(name, suffixes)[0])


def _file_and_column(name: str, suffixes: Collection[str]) -> tuple[str, str]:
    """Split ``torque.csv:tau``; both are empty if there is no file in the name."""
    found = re.match(rf"(?P<file>.*(?P<suffix>\.\w{{1,{_LONGEST_SUFFIX}}}))\s*:\s*(?P<column>.+)", name)
    if found is None or found["suffix"].lower() not in suffixes:
        return "", ""
    return found["file"].strip(), found["column"].strip()


def _found(recording: Path, file: str, name: str) -> Path:
    for path in (recording.parent / file, Path(file)):
        if path.is_file():
            return path
    raise UsageError(f"{recording}: {name}: there is no file {file} beside the recording or in the current folder")


def _only_axis(path: Path, axes: list[Recording]) -> Recording:
    if len(axes) != 1:
        raise UsageError(
            f"{path} has the axes {', '.join(each.axis for each in axes)}; a file beside a recording has one"
        )
    return axes[0]


def _joined(recording: Recording, other: Recording, column: str, time_source: str) -> Array:
    """Return a column of another file (n,) for the rows of a recording; NaN at times that the other does not cover."""
    values = other.columns[column]
    if not time_source or time_source not in other.columns or time_source not in recording.columns:
        if len(values) != len(recording):
            named = f" {time_source}" if time_source else ""
            raise RecordingError(
                f"{other.path} has {len(values)} rows and {recording.path} has {len(recording)}: without a column of "
                f"time stamps{named} in both they are joined row by row, which takes equal numbers of rows"
            )
        return values
    time, own = recording.columns[time_source], other.columns[time_source]
    if np.array_equal(time, own):
        return values
    known = np.flatnonzero(np.isfinite(own) & np.isfinite(values))
    order = known[np.argsort(own[known], kind="stable")]
    found: Array = np.full(len(time), np.nan)
    if len(order):
        found = np.interp(time, own[order], values[order], left=np.nan, right=np.nan)
        steps = np.diff(own[order])
        at = np.clip(np.searchsorted(own[order], time), 1, max(len(steps), 1))
        if len(steps):
            is_between = (time > own[order][at - 1]) & (time < own[order][at])
            found[is_between & (steps[at - 1] > _LONGEST_GAP * np.median(steps))] = np.nan
    if not np.isfinite(found).any():
        raise RecordingError(
            f"{other.path}: its times do not overlap with those of {recording.path}: {time_source} is "
            f"{np.nanmin(own):.6g} to {np.nanmax(own):.6g} there, {np.nanmin(time):.6g} to {np.nanmax(time):.6g} here"
        )
    recording.problems.append(f"{Path(other.path).name}:{column} is interpolated at the times of {time_source}")
    return found
