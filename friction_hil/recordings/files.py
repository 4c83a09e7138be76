"""Reading and writing of recordings by the suffix of the file."""

import importlib
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from friction_hil.errors import RecordingError, UsageError, choices
from friction_hil.recordings.mapping import Mapped, mapping_beside
from friction_hil.recordings.recording import Array, Recording, check, count_where, rename
from friction_hil.recordings.source import Source

if TYPE_CHECKING:
    from friction_hil.config import Configuration

_MODULES = {
    ".mcap": "mcap_reader",
    ".csv": "csv_file",
    ".parquet": "parquet_file",
    ".mf4": "mdf_file",
    ".mdf": "mdf_file",
    ".h5": "hdf5_file",
    ".hdf5": "hdf5_file",
    ".mat": "mat_file",
    ".npz": "npz_file",
    ".json": "json_file",
    ".log": "can_log",
    ".asc": "can_log",
    ".blf": "can_log",
}
_READ_ONLY = (".mdf", ".log", ".asc", ".blf")
_WRITERS = {suffix: name for suffix, name in _MODULES.items() if suffix not in _READ_ONLY} | {".mcap": "mcap_writer"}
"""Module of each suffix: `read(source)` gives recordings; `write(path, recording, overwrite=)` takes one."""


def formats(*, to_write: bool = False) -> tuple[str, ...]:
    """Suffixes of the files that can be read, or written."""
    return tuple(sorted(_WRITERS if to_write else _MODULES))


def read(
    path: str | Path,
    axis: str | None = None,
    *,
    columns: Mapping[str, str] | None = None,
    scale: Mapping[str, float] | None = None,
    where: str | None = None,
    only: Collection[str] | None = None,
    configuration: "Configuration | None" = None,
) -> Recording:
    """Read one axis of a recording; `formats` has the suffixes.

    Parameters
    ----------
    path : path
        The file; its suffix says what it is. Beside it may lie ``NAME.columns.yaml``, or ``columns.yaml`` for
        all files of the folder, with the same as ``columns`` and ``scale``, which go before it.
    axis : str, optional
        Name of the axis; needed where the file has several. A file of columns has one, without a name: it
        is called this, or else after the file.
    columns : dict, optional
        Our name of a column to the file's: ``{"time_s": "t", "torque": "effort"}``, or to what it is made of:
        ``{"torque": "load:int16*input_volts/885"}`` (`friction_hil.recordings.product`).
    scale : dict, optional
        Our name of a column to the factor that makes it SI: ``{"torque": 35.15}``.
    where : str, optional
        Column, by our name or the file's, in whose rows the torque counts where it is neither zero nor NaN; in the
        others ``torque`` becomes NaN.
    only : sequence of str, optional
        Our names of the columns to load, as far as they are there; all when not given.
    configuration : Configuration, optional
        Of the machine; a CAN log is decoded by it.

    Raises
    ------
    RecordingError
        The file cannot be read, has no finite ``time_s``, or the torque counts nowhere.
    UsageError
        The suffix is unknown, the file has several axes or not this one, a mapped column is not there, or a
        package is not installed.
    """

    def one(names: list[str]) -> list[str]:
        if axis is None and len(names) > 1:
            raise UsageError(f"{path} has several axes; choose one with --axis. {choices('', names)}")
        if axis is not None and axis not in names:
            raise UsageError(f"{path} has no axis {axis!r}; {choices(axis, names)}")
        return names if axis is None else [axis]

    mapped = mapping_beside(Path(path)).overridden(columns or {}, scale or {})
    source = Source(Path(path), axis, _wanted(only, mapped, where), one, configuration)
    (recording,) = _read(source, mapped, where, only).values()
    return recording


def read_all(
    path: str | Path,
    *,
    columns: Mapping[str, str] | None = None,
    scale: Mapping[str, float] | None = None,
    where: str | None = None,
    only: Collection[str] | None = None,
    configuration: "Configuration | None" = None,
) -> dict[str, Recording]:
    """Read every axis of a recording, by name; otherwise as `read`."""
    mapped = mapping_beside(Path(path)).overridden(columns or {}, scale or {})
    source = Source(Path(path), None, _wanted(only, mapped, where), configuration=configuration)
    return _read(source, mapped, where, only)


def write(path: str | Path, recording: Recording, *, overwrite: bool = False) -> None:
    """Write one axis, by the suffix; ``formats(to_write=True)`` has them.

    Values are kept bit for bit, units where the format has a place for them; metadata, events and restart points
    are not written.

    Parameters
    ----------
    path : path
        The file.
    recording : Recording
        What to write.
    overwrite : bool
        Whether an existing file is replaced.

    Raises
    ------
    RecordingError
        The file exists or cannot be written, or the format cannot hold a column's name.
    UsageError
        The suffix is not one that can be written, or a package is not installed.
    """
    path = Path(path)
    module = _module(path, _WRITERS)
    try:
        module.write(path, recording, overwrite=overwrite)
    except FileExistsError:
        raise RecordingError(f"{path} exists already; --force replaces it") from None
    except OSError as error:
        raise RecordingError(f"{path} cannot be written: {error.strerror or error}") from None


def _wanted(only: Collection[str] | None, mapped: Mapped, where: str | None) -> frozenset[str] | None:
    if only is None:
        return None
    condition = set() if where is None else {where, *mapped.sources(where)}
    return frozenset(condition.union(*map(mapped.sources, only)))


def _read(source: Source, mapped: Mapped, where: str | None, only: Collection[str] | None) -> dict[str, Recording]:
    module = _module(source.path, _MODULES)
    try:
        recordings: list[Recording] = module.read(source)
    except OSError as error:
        raise RecordingError(f"{source.path} cannot be read: {error.strerror or error}") from None
    for recording in recordings:
        fitting = mapped.fitting({*recording.columns, *recording.others})
        before = recording.columns
        rename(recording, fitting.columns, fitting.scale)
        there: dict[str, Array] = {**before, **recording.columns}
        if only is not None:  # others were read for what these are made of
            recording.others += tuple(name for name in recording.columns if name not in only)
            recording.columns = {name: values for name, values in recording.columns.items() if name in only}
            recording.units = {name: unit for name, unit in recording.units.items() if name in only}
        check(recording)
        if where is not None:
            count_where(recording, where, there)
    return {recording.axis: recording for recording in recordings}


def _module(path: Path, known: Mapping[str, str]) -> Any:
    suffix = path.suffix.lower()
    if suffix not in known:
        raise UsageError(f"{path}: the suffix {suffix!r} is not known here; {choices(suffix, known)}")
    return importlib.import_module(f"friction_hil.recordings.{known[suffix]}")
