"""Read and write MATLAB files: vectors of equal length are columns. Version 7.3 is HDF5, and read as that."""

import io
import os
import struct
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from friction_hil.errors import RecordingError, UsageError
from friction_hil.recordings.recording import Recording
from friction_hil.recordings.source import Source, as_column, commonest_length, is_column, open_new

_HEADER = 128  # bytes of a MATLAB 5 file before its first variable
_VERSION_7_3 = b"MATLAB 7.3"
_TAG = struct.Struct("<II")
_LONGEST_NAME = 31


def read(source: Source) -> list[Recording]:
    """Read the real vectors of a MATLAB 5 to 7.3 file; scalars and everything else are passed over.

    Where vectors differ in length, those of the commonest length are the columns, and ``problems`` names the
    others. Of a file that was cut off the variables before the cut are read.

    Raises
    ------
    RecordingError
        The file is no MATLAB file, or has no vector.
    OSError
        It cannot be opened.
    """
    with source.path.open("rb") as file:
        start = file.read(_HEADER)
    if start.startswith(_VERSION_7_3):
        return _read_7_3(source)
    problems: list[str] = []
    vectors = {name: value for name, value in _load(source.path, problems).items() if _is_vector(value)}
    if not vectors:
        because = f": {'; '.join(problems)}" if problems else ""
        raise RecordingError(f"{source.path}: there is no real vector in it, which a column would be{because}")
    names = commonest_length({name: value.size for name, value in vectors.items()}, problems)
    wanted, others = source.split(names)
    columns = {name: as_column(vectors[name]) for name in wanted}
    return [Recording(str(source.path), source.name, columns, problems=problems, others=others)]


def write(path: Path, recording: Recording, *, overwrite: bool) -> None:
    """Write the columns as MATLAB 5 column vectors.

    Raises
    ------
    RecordingError
        A column's name is no name of a variable in MATLAB.
    OSError
        The file exists, unless ``overwrite``, or cannot be written.
    """
    from scipy.io import savemat

    for name in recording.columns:
        if not (name.isascii() and name.isidentifier() and name[0] != "_" and len(name) <= _LONGEST_NAME):
            raise RecordingError(
                f"{path}: a variable of MATLAB 5 is named with up to {_LONGEST_NAME} letters, digits and underscores, "
                f"a letter first, not {name!r}; rename with --column new_name='{name}'"
            )
    with open_new(path, overwrite=overwrite) as file:
        savemat(file, recording.columns, oned_as="column")


def _read_7_3(source: Source) -> list[Recording]:
    from friction_hil.recordings import hdf5_file

    advice = "; in MATLAB save it with save(..., '-v7')"
    try:
        return hdf5_file.read(source)
    except UsageError as error:
        raise UsageError(f"{source.path} is a MATLAB 7.3 file, which is HDF5: {error}{advice}") from None
    except RecordingError as error:
        raise RecordingError(f"{source.path} is a MATLAB 7.3 file, which is HDF5: {error}{advice}") from None


def _load(path: Path, problems: list[str]) -> dict[str, Any]:
    from scipy.io import loadmat

    with path.open("rb") as file:
        end, size, is_little_endian = _whole(file)
        if end < size and is_little_endian:
            problems.append(
                f"the file was cut off in the variable at byte {end}: that variable and what followed are lost"
            )
        file.seek(0)
        whole = io.BytesIO(file.read(end)) if problems else str(path)
    try:
        content: dict[str, Any] = loadmat(whole, appendmat=False)
    except Exception as error:  # noqa: BLE001 - the parser raises whatever damaged bytes lead it to
        raise RecordingError(f"{path} is not a readable MATLAB 5 file: {error}") from None
    return {name: value for name, value in content.items() if not name.startswith("__")}


def _whole(file: BinaryIO) -> tuple[int, int, bool]:
    """Byte behind the last whole variable, size of the file, and whether it is in the order of bytes that is read."""
    size = file.seek(0, os.SEEK_END)
    file.seek(_HEADER - 2)
    is_little_endian = file.read(2) == b"IM"
    at = _HEADER
    while at + _TAG.size <= size:
        file.seek(at)
        length = _TAG.unpack(file.read(_TAG.size))[1]
        if length > size - at - _TAG.size:
            break
        at += _TAG.size + length
    return at, size, is_little_endian


def _is_vector(value: Any) -> bool:
    return isinstance(value, np.ndarray) and value.size > 1 and is_column(value)
