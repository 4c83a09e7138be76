"""Read and write MATLAB files: vectors of equal length are columns. Version 7.3 is read as HDF5."""

import io
import os
import struct
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from friction_hil.errors import RecordingError, UsageError
from friction_hil.recordings.recording import Recording
from friction_hil.recordings.source import Source, as_column, is_column, most_frequent_length, open_new

_HEADER = 128  # bytes of a MATLAB 5 file before its first variable
_VERSION_7_3 = b"MATLAB 7.3"
_TAG = struct.Struct("<II")  # kind and length of what follows
_FIXED = struct.Struct("<12I")  # start of a variable: tag, tag and flags, tag and size, tag of its name
_START = 128  # bytes of a variable that contain everything before its values
_MATRIX, _DOUBLES, _TEXT = 14, 9, 1
_REAL_DOUBLES = [6, 8, 6, 0, 5, 8]  # tag and flags: not complex, not logical; tag of two dimensions
_LONGEST_NAME = 31


def read(source: Source) -> list[Recording]:
    """Read the real vectors of a MATLAB 5 to 7.3 file; scalars and everything else are ignored.

    If the vectors differ in length, those of the most frequent length are the columns, and ``problems`` names the
    others. Of a file that was cut off, the variables before the cut are read.

    Raises
    ------
    RecordingError
        The file is not a MATLAB file, or has no vector.
    OSError
        The file cannot be opened.
    """
    problems: list[str] = []
    with source.path.open("rb") as file:
        start = file.read(_HEADER)
        if start.startswith(_VERSION_7_3):
            return _read_7_3(source)
        content = _load(source.path, file, start, problems)
    vectors = {name: value for name, value in content.items() if _is_vector(value)}
    if not vectors:
        because = f": {'; '.join(problems)}" if problems else ""
        raise RecordingError(f"{source.path}: there is no real vector in it, which a column would be{because}")
    names = most_frequent_length({name: value.size for name, value in vectors.items()}, problems)
    wanted, others = source.split(names)
    columns = {name: as_column(vectors[name]) for name in wanted}
    return [Recording(str(source.path), source.name, columns, problems=problems, others=others)]


def write(path: Path, recording: Recording, *, overwrite: bool) -> None:
    """Write the columns as MATLAB 5 column vectors.

    Raises
    ------
    RecordingError
        MATLAB does not allow the name of a column as a variable.
    OSError
        The file exists, unless ``overwrite``, or cannot be written.
    """
    from scipy.io import savemat  # imported here: scipy.io takes long to import

    for name in recording.columns:
        if not (name.isascii() and name.isidentifier() and name[0] != "_" and len(name) <= _LONGEST_NAME):
            raise RecordingError(
                f"{path}: a variable of MATLAB 5 is named with up to {_LONGEST_NAME} letters, digits and underscores, "
                f"a letter first, not {name!r}; rename with --column new_name='{name}'"
            )
    with open_new(path, overwrite=overwrite) as file:
        savemat(file, recording.columns, oned_as="column")


def _read_7_3(source: Source) -> list[Recording]:
    from friction_hil.recordings import hdf5_file  # imported here: only this version of the format needs it

    advice = "; in MATLAB save it with save(..., '-v7')"
    try:
        return hdf5_file.read(source)
    except UsageError as error:
        raise UsageError(f"{source.path} is a MATLAB 7.3 file, which is HDF5: {error}{advice}") from None
    except RecordingError as error:
        raise RecordingError(f"{source.path} is a MATLAB 7.3 file, which is HDF5: {error}{advice}") from None


def _load(path: Path, file: BinaryIO, start: bytes, problems: list[str]) -> dict[str, Any]:
    variables, end, size = _variables(file)
    if start.endswith(b"IM"):  # only in that order are the variables' lengths read
        if end < size:
            problems.append(
                f"the file was cut off in the variable at byte {end}: that variable and what followed are lost"
            )
        plain = _plain(file, variables)
        if plain is not None:
            return plain
    from scipy.io import loadmat  # imported here: scipy.io takes long to import

    file.seek(0)
    whole = io.BytesIO(file.read(end)) if problems else file
    try:
        content: dict[str, Any] = loadmat(whole, appendmat=False)
    except Exception as error:  # noqa: BLE001 - the parser raises whatever damaged bytes lead it to
        raise RecordingError(f"{path} is not a readable MATLAB 5 file: {error}") from None
    return {name: value for name, value in content.items() if not name.startswith("__")}


def _variables(file: BinaryIO) -> tuple[list[bytes], int, int]:
    """Return the first bytes of each whole variable, the offset after the last of them, and the size of the file."""
    size = file.seek(0, os.SEEK_END)
    variables = []
    at = _HEADER
    while at + _TAG.size <= size:
        file.seek(at)
        start = file.read(_START)
        length = _TAG.unpack_from(start)[1]
        if length > size - at - _TAG.size:
            break
        variables.append(start)
        at += _TAG.size + length
    return variables, at, size


def _plain(file: BinaryIO, variables: list[bytes]) -> dict[str, Any] | None:
    """Read all variables if each is an uncompressed matrix of doubles in native byte order; else return None.

    MATLAB's ``save -v6`` and scipy write such files. This takes half of scipy's time.
    """
    content: dict[str, Any] = {}
    at = _HEADER
    for start in variables:
        if len(start) < _FIXED.size:
            return None
        kind, length, *tags, rows, columns, name_kind, name_length = _FIXED.unpack_from(start)
        if kind != _MATRIX or tags != _REAL_DOUBLES or name_kind & 0xFFFF != _TEXT:
            return None
        # a name of up to four letters is stored in its own tag, with its length in the upper half of the kind
        begin = _FIXED.size - 4 * (name_kind > 0xFFFF)
        end = begin + (name_kind >> 16 or name_length)
        data = -(-end // 8) * 8
        if data + _TAG.size > len(start) or rows * columns * 8 + data != length:
            return None
        if _TAG.unpack_from(start, data) != (_DOUBLES, rows * columns * 8):
            return None
        file.seek(at + data + _TAG.size)
        values = np.empty((columns, rows), "<f8")
        if file.readinto(values.data) != values.nbytes:  # type: ignore[attr-defined]
            return None
        content[start[begin:end].decode("latin-1")] = values.T
        at += _TAG.size + length
    return content or None


def _is_vector(value: Any) -> bool:
    return isinstance(value, np.ndarray) and value.size > 1 and is_column(value)
