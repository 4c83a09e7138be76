"""Read NPY and read and write NPZ, numpy's archive of arrays: each vector, and each column of a matrix, is a column."""

import io
import math
import zipfile
from collections import Counter
from pathlib import Path

import numpy as np

from friction_hil.errors import RecordingError
from friction_hil.recordings.bounds import Memory, check_columns
from friction_hil.recordings.matrices import column_indices, kept_length
from friction_hil.recordings.recording import Recording
from friction_hil.recordings.source import Source, as_column, damaged, open_new

_LOCAL_MAGIC = b"PK\x03\x04"
_COMPRESSIONS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)  # those of numpy; others expand without limit
_NAMED = 20  # members in messages
_HEADERS = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}


def read(source: Source) -> list[Recording]:
    """Read the numeric vectors and matrices; arrays of objects are not read, because they could execute code.

    The one array of an NPY file has the name of the file. Raises `RecordingError`: the file was cut off, is not NPZ or
    has no vector; `OSError`: the file cannot be opened.
    """
    recording = Recording(str(source.path), source.name, {})
    if source.path.suffix.lower() == ".npy":
        return [_read_single(source, recording)]
    with source.path.open("rb") as file:
        try:
            archive = zipfile.ZipFile(file)
        except (zipfile.BadZipFile, ValueError, OSError, NotImplementedError) as error:
            raise _damaged(source.path, error) from None
        members = {name.removesuffix(".npy"): name for name in archive.namelist() if name.endswith(".npy")}
        recording.problems += _not_arrays(archive)
        columns: dict[str, np.ndarray] = {}
        check_columns(source.path, members)
        recording.others = tuple(name for name in members if not source.wants_part_of(name))
        for name in members:
            if not source.wants_part_of(name):
                continue
            try:
                values = _array(archive, archive.getinfo(members[name]), source.memory)
            except RecordingError:
                raise
            except Exception as error:  # noqa: BLE001 - the libraries raise whatever damaged bytes lead them to
                recording.problems.append(f"{name} is damaged ({' '.join(str(error).split())}): left out")
                continue
            indices = column_indices(name, values.shape) if values.dtype.kind in "fiub" else {}
            wanted, others = source.split(indices)
            recording.others += others
            columns |= {each: values[indices[each]] for each in wanted}
            if not indices and values.size > 1:
                recording.problems.append(f"{name} is {values.dtype} of shape {values.shape}, no column: left out")
    if not columns and not recording.problems and not recording.others:
        raise RecordingError(f"{source.path}: there is no vector of numbers in it, which a column would be")
    if columns:
        for name in kept_length({name: values.size for name, values in columns.items()}, recording.problems):
            recording.columns[name] = as_column(columns[name])
    return [recording]


def write(path: Path, recording: Recording, *, overwrite: bool) -> None:
    """Write each column as an array of its name, uncompressed.

    Raises `RecordingError`: an archive cannot hold the name of a column; `OSError`: the file exists, unless
    ``overwrite``, or cannot be written.
    """
    for name in recording.columns:
        if "\0" in name or "\\" in name or name.endswith("/"):
            raise RecordingError(f"{path}: NPZ cannot hold a column {name!r}; rename with --column new_name='{name}'")
    with open_new(path, overwrite=overwrite) as file, zipfile.ZipFile(file, "w", allowZip64=True) as archive:
        # not np.savez, which takes names as keyword arguments and cannot write a column `file`
        for name, values in recording.columns.items():
            with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                np.lib.format.write_array(member, values, allow_pickle=False)


def _not_arrays(archive: zipfile.ZipFile) -> list[str]:
    """Return what is there beside the arrays, in words: the name of an array may be damaged, or there twice."""
    names = [each for each in archive.namelist() if not each.endswith("/")]
    others = [each for each in names if not each.endswith(".npy")]
    problems = [f"{name!r} is no array (.npy): left out" for name in others[:_NAMED]]
    if len(others) > _NAMED:
        problems.append(f"{len(others) - _NAMED} more are no arrays (.npy): left out")
    twice = [name for name, count in Counter(names).items() if count > 1]
    return problems + [f"{name!r} is there more than once: the last one counts" for name in twice[:_NAMED]]


def _array(archive: zipfile.ZipFile, member: zipfile.ZipInfo, memory: Memory) -> np.ndarray:
    """Read an array; neither its size nor its shape is believed before the values are there."""
    if member.compress_type not in _COMPRESSIONS:
        raise ValueError(f"its compression {member.compress_type} is none that numpy writes")
    memory.take(member.file_size)
    with archive.open(member) as file:
        # all of it at once, as numpy reads it in pieces with a checksum for each; with a size, which limits expansion
        return _parsed(file.read(member.file_size))


def _read_single(source: Source, recording: Recording) -> Recording:
    source.memory.take(source.path.stat().st_size)
    try:
        values = _parsed(source.path.read_bytes())
    except OSError:
        raise
    except Exception as error:  # noqa: BLE001 - the library raises whatever damaged bytes lead it to
        raise damaged(source.path, "is no readable NPY file", error) from None
    indices = column_indices(source.path.stem, values.shape) if values.dtype.kind in "fiub" else {}
    if not indices:
        raise RecordingError(
            f"{source.path}: holds {values.dtype} of shape {values.shape}, which is no column and no matrix of columns"
        )
    wanted, recording.others = source.split(indices)
    recording.columns = {name: as_column(values[indices[name]]) for name in wanted}
    return recording


def _parsed(data: bytes) -> np.ndarray:
    start = io.BytesIO(data)
    version = np.lib.format.read_magic(start)
    if version not in _HEADERS:
        raise ValueError(f"its version {version[0]}.{version[1]} is that of an array of records")
    shape, is_fortran, kind = _HEADERS[version](start)
    if kind.hasobject:
        raise ValueError("it holds Python objects, which could execute code")
    count, at = math.prod(shape), start.tell()
    if min(shape, default=0) < 0 or count * kind.itemsize > len(data) - at:
        raise ValueError(f"its header claims {count} values; {(len(data) - at) // max(kind.itemsize, 1)} are there")
    return np.frombuffer(data, kind, count, at).reshape(shape, order="F" if is_fortran else "C").copy()


def _damaged(path: Path, error: Exception) -> RecordingError:
    with path.open("rb") as file:
        start = file.read(4)
    if not start:
        return RecordingError(f"{path} is empty")
    if _LOCAL_MAGIC.startswith(start):
        return RecordingError(
            f"{path} was cut off at byte {path.stat().st_size}: the directory at the end of an NPZ file is missing, "
            "and without it all rows are lost"
        )
    return damaged(path, "is no NPZ file", error)
