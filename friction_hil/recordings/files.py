"""Reading and writing of recordings by the suffix of the file."""

from collections.abc import Callable, Mapping
from pathlib import Path

from friction_hil.errors import RecordingError, UsageError, choices
from friction_hil.recordings.recording import Recording, check, rename

Select = Callable[[list[str]], list[str]]
"""From the names of the axes in a file, those to read."""


def formats() -> tuple[str, ...]:
    """Suffixes of the files that can be read."""
    return (".csv", ".mat", ".mcap")


def read(
    path: str | Path,
    axis: str | None = None,
    *,
    columns: Mapping[str, str] | None = None,
    scale: Mapping[str, float] | None = None,
) -> Recording:
    """Read one axis of a recording: MCAP, CSV with a header, or MATLAB 5 .mat.

    Parameters
    ----------
    path : path
        The file; its suffix says what it is.
    axis : str, optional
        Name of the axis; needed where the file has several. A CSV or .mat file has one, without a name: it
        is called this, or else after the file.
    columns : dict, optional
        Our name of a column to the file's: ``{"time_s": "t", "torque": "effort"}``.
    scale : dict, optional
        Our name of a column to the factor that makes it SI: ``{"torque": 35.15}``.

    Raises
    ------
    RecordingError
        The file cannot be read, or has no finite ``time_s``.
    UsageError
        The suffix is unknown, the file has several axes or not this one, or a mapped column is not there.
    """

    def one(names: list[str]) -> list[str]:
        if axis is None and len(names) > 1:
            raise UsageError(f"{path} has several axes; choose one with --axis. {choices('', names)}")
        if axis is not None and axis not in names:
            raise UsageError(f"{path} has no axis {axis!r}; {choices(axis, names)}")
        return names if axis is None else [axis]

    (recording,) = _read(Path(path), one, axis, columns or {}, scale or {}).values()
    return recording


def read_all(
    path: str | Path, *, columns: Mapping[str, str] | None = None, scale: Mapping[str, float] | None = None
) -> dict[str, Recording]:
    """Read every axis of a recording, by name; otherwise as `read`."""
    return _read(Path(path), lambda names: names, None, columns or {}, scale or {})


def write(path: str | Path, recording: Recording, *, overwrite: bool = False) -> None:
    """Write one axis as MCAP or CSV, by the suffix.

    Values are kept bit for bit; metadata, events and restart points are not written.

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
        The file exists or cannot be written, or MCAP cannot hold a column's name.
    UsageError
        The suffix is not one that can be written.
    """
    path = Path(path)
    suffix = _suffix(path, (".csv", ".mcap"))
    try:
        if suffix == ".csv":
            from friction_hil.recordings.csv_file import write_csv

            write_csv(path, recording, overwrite=overwrite)
        else:
            from friction_hil.recordings.mcap_writer import write_mcap

            write_mcap(path, recording, overwrite=overwrite)
    except FileExistsError:
        raise RecordingError(f"{path} exists already; --force replaces it") from None
    except OSError as error:
        raise RecordingError(f"{path} cannot be written: {error.strerror}") from None


def _read(
    path: Path, select: Select, axis: str | None, columns: Mapping[str, str], scale: Mapping[str, float]
) -> dict[str, Recording]:
    suffix = _suffix(path, formats())
    try:
        if suffix == ".mcap":
            from friction_hil.recordings.mcap_reader import read_mcap

            recordings = read_mcap(path, select)
        else:
            recordings = [_read_single(path, suffix, axis or path.stem)]
    except OSError as error:
        raise RecordingError(f"{path} cannot be read: {error.strerror or error}") from None
    for recording in recordings:
        rename(recording, columns, scale)
        check(recording)
    return {recording.axis: recording for recording in recordings}


def _read_single(path: Path, suffix: str, axis: str) -> Recording:
    if suffix == ".csv":
        from friction_hil.recordings.csv_file import read_csv

        return read_csv(path, axis)
    from friction_hil.recordings.mat_file import read_mat

    return read_mat(path, axis)


def _suffix(path: Path, known: tuple[str, ...]) -> str:
    suffix = path.suffix.lower()
    if suffix not in known:
        raise UsageError(f"{path}: the suffix {suffix!r} is not known here; {choices(suffix, known)}")
    return suffix
