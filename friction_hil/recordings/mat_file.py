"""Read and write MATLAB files: vectors and matrices of equal length hold the columns. 7.3 is read as HDF5."""

from pathlib import Path

from friction_hil.errors import RecordingError, UsageError
from friction_hil.recordings import mat_variables
from friction_hil.recordings.matrices import kept_length
from friction_hil.recordings.recording import Array, Recording
from friction_hil.recordings.source import Source, open_new

_VERSION_7_3 = b"MATLAB 7.3"
_LONGEST_NAME = 31


def read(source: Source) -> list[Recording]:
    """Read the real vectors and matrices of a MATLAB 4 to 7.3 file; scalars and everything else are ignored.

    If the vectors differ in length, those of the most frequent length are the columns, and ``problems`` names the
    others. Of a file that was cut off, the variables before the cut are read. Raises `RecordingError`: the file is not
    a MATLAB file, or has no vector; `OSError`: the file cannot be opened.
    """
    problems: list[str] = []
    data = source.path.read_bytes()
    if data.startswith(_VERSION_7_3):
        return _read_7_3(source)
    found: dict[str, Array] = {}
    try:
        found.update(mat_variables.vectors(data, source.memory, problems))
    except ValueError as error:
        raise RecordingError(f"{source.path} is not a readable MATLAB file: {error}") from None
    if not found:
        because = f": {'; '.join(problems)}" if problems else ""
        raise RecordingError(f"{source.path}: there is no real vector in it, which a column would be{because}")
    names = kept_length({name: values.size for name, values in found.items()}, problems)
    wanted, others = source.split(names)
    columns = {name: found[name] for name in wanted}
    return [Recording(str(source.path), source.name, columns, problems=problems, others=others)]


def write(path: Path, recording: Recording, *, overwrite: bool) -> None:
    """Write the columns as MATLAB 5 column vectors.

    Raises `RecordingError`: MATLAB does not allow the name of a column as a variable; `OSError`: the file exists,
    unless ``overwrite``, or cannot be written.
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
        return hdf5_file.read(source, is_transposed=True)
    except UsageError as error:
        raise UsageError(f"{source.path} is a MATLAB 7.3 file, which is HDF5: {error}{advice}") from None
    except RecordingError as error:
        raise RecordingError(f"{source.path} is a MATLAB 7.3 file, which is HDF5: {error}{advice}") from None
