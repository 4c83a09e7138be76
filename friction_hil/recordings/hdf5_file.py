"""Read and write HDF5 through h5py: a dataset each, or the fields of a compound dataset; units as attributes."""

import math
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from friction_hil.errors import RecordingError
from friction_hil.recordings.matrices import Index, column_indices, kept_length
from friction_hil.recordings.recording import Recording
from friction_hil.recordings.source import (
    Source,
    as_column,
    damaged,
    needs_extra,
    open_new,
)
from friction_hil.recordings.units import known_unit

_SIGNATURE = b"\x89HDF\r\n\x1a\n"
_UNIT_ATTRIBUTES = ("unit", "units", "Unit", "Units")
_MATLAB_INTERNAL = "#"
_CHUNK_ROWS = 1 << 16


@dataclass(frozen=True, slots=True)
class _Place:
    """Where a column is: a dataset (h5py's low-level object), a field of it if it is compound, an index if a matrix."""

    dataset: Any
    field: str | None
    index: Index
    size: int

    @property
    def is_whole(self) -> bool:
        """True if the column is all of the dataset."""
        return self.field is None and self.size == math.prod(self.dataset.shape)


def read(source: Source, *, is_transposed: bool = False) -> list[Recording]:
    """Read every numeric vector and matrix of the file, also those in groups, and MATLAB 7.3.

    MATLAB writes its matrices transposed: with ``is_transposed``, columns are named as in MATLAB. The name of a column
    is that of its dataset, or its whole path if several datasets have that name. If they differ in length, those of the
    length of the recording are the columns (`kept_length`). Raises `RecordingError`: the file was cut off, is not HDF5
    or has no vector, or something in it is the content of another file; `UsageError`: h5py is not installed; `OSError`:
    the file cannot be opened.
    """
    h5py = _library(source.path)
    with source.path.open("rb") as opened:
        try:
            with h5py.File(opened, "r") as file:
                return [_read(source, h5py, file, is_transposed=is_transposed)]
        except RecordingError:
            raise
        except Exception as error:  # noqa: BLE001 - the library raises whatever damaged bytes lead it to
            raise _damaged(source.path, error) from None


def write(path: Path, recording: Recording, *, overwrite: bool) -> None:
    """Write each column as a float64 dataset with checksums, and its unit as attribute ``unit``.

    Raises `RecordingError`: the name of a column has a slash, which separates groups; `UsageError`: h5py is not
    installed; `OSError`: the file exists, unless ``overwrite``, or cannot be written.
    """
    h5py = _library(path)
    for name in recording.columns:
        if "/" in name or name == "." or "\0" in name:
            raise RecordingError(f"{path}: HDF5 cannot hold a column {name!r}; rename with --column new_name='{name}'")
    with open_new(path, overwrite=overwrite) as opened, h5py.File(opened, "w", track_order=True) as file:
        for name, values in recording.columns.items():
            # only chunks have checksums, and an empty dataset has no chunks
            chunks = {"chunks": (min(len(values), _CHUNK_ROWS),), "fletcher32": True} if len(values) else {}
            dataset = file.create_dataset(name, data=values, **chunks)
            unit = known_unit(recording.units, name)
            if unit:
                dataset.attrs["unit"] = unit


def _library(path: Path) -> Any:
    try:  # imported here: an optional package
        import h5py
    except ImportError:
        raise needs_extra(path, "h5py") from None
    return h5py


def _read(source: Source, h5py: Any, file: Any, *, is_transposed: bool) -> Recording:
    _refuse_other_files(source.path, h5py, file)
    recording = Recording(str(source.path), source.name, {})
    found = _vectors(h5py, file, is_transposed=is_transposed)
    last = {path: path.rpartition("/")[2] for path in found}
    times = Counter(last.values())
    names = {path if times[last[path]] > 1 else last[path]: path for path in found}
    sizes = {name: found[path].size for name, path in names.items()}
    if not sizes:
        raise RecordingError(f"{source.path}: there is no vector of numbers in it, which a column would be")
    wanted, recording.others = source.split(kept_length(sizes, recording.problems))
    source.memory.take(sum(sizes[name] for name in wanted) * 8)
    # One block for all columns: the system maps large blocks in large pages, which are the cheapest to touch first.
    block = np.empty((len(wanted), sizes[wanted[0]])) if wanted else ()
    records: tuple[Any, Any] = None, None  # the compound dataset that was read last, and its content
    for name, room in zip(wanted, block, strict=True):
        place = found[names[name]]
        dataset, field = place.dataset, place.field
        kind = dataset.dtype if field is None else dataset.dtype[field]
        if kind.kind not in "fiub":
            recording.problems.append(f"{name} holds {kind}, no numbers: left out")
            continue
        try:
            if place.is_whole and kind == np.float64:
                dataset.read(h5py.h5s.ALL, h5py.h5s.ALL, room)
                recording.columns[name] = room
            else:
                if dataset is not records[0]:
                    source.memory.take(math.prod(dataset.shape) * dataset.dtype.itemsize)
                    records = dataset, h5py.Dataset(dataset)[()]
                values = records[1] if field is None else records[1][field]
                recording.columns[name] = as_column(values[place.index])
        except OSError as error:
            recording.problems.append(f"{name} is damaged ({' '.join(str(error).split())}): left out")
            continue
        if field is None and h5py.h5a.get_num_attrs(dataset):
            attributes = h5py.Dataset(dataset).attrs
            unit = next((_text(attributes[key]) for key in _UNIT_ATTRIBUTES if key in attributes), "")
            if unit:
                recording.units[name] = unit
    return recording


def _refuse_other_files(path: Path, h5py: Any, file: Any) -> None:
    """Refuse a file that has the library read others: whoever wrote it chooses which.

    Raises `RecordingError`: a link leads to another file, or the values of a dataset are in one.
    """

    found: list[tuple[bytes, bytes]] = []  # the library does not pass on an error that a visitor raises

    def check_link(name: bytes, info: Any) -> None:
        if info.type not in (h5py.h5l.TYPE_HARD, h5py.h5l.TYPE_SOFT):
            is_known = info.type == h5py.h5l.TYPE_EXTERNAL
            found.append((name, file.id.links.get_val(name)[0] if is_known else b"(a link of another kind)"))

    def check_object(name: bytes, info: Any) -> None:
        if info.type != h5py.h5o.TYPE_DATASET:
            return
        created = h5py.h5d.open(file.id, name).get_create_plist()
        if created.get_external_count():
            found.append((name, created.get_external(0)[0]))
        if created.get_layout() == h5py.h5d.VIRTUAL:
            others = map(created.get_virtual_filename, range(created.get_virtual_count()))
            found.extend((name, other.encode()) for other in others if other != ".")

    file.id.links.visit(check_link, info=True)
    h5py.h5o.visit(file.id, check_object, info=True)
    for where, target in found[:1]:
        raise RecordingError(
            f"{path}: {where.decode('utf-8', 'replace')!r} is in another file, {target.decode('utf-8', 'replace')!r}, "
            "which is not read; copy the values into this one, e.g. with h5repack, or with h5py"
        )


def _vectors(h5py: Any, file: Any, *, is_transposed: bool) -> dict[str, _Place]:
    """Return the place of each column by its path.

    The datasets are h5py's low-level objects: creating its high-level ones takes longer than reading their values.
    """
    found: dict[str, _Place] = {}

    def visit(name: bytes, info: Any) -> None:
        path = name.decode("utf-8", "replace")
        if info.type != h5py.h5o.TYPE_DATASET or path.startswith(_MATLAB_INTERNAL):
            return
        dataset = h5py.h5d.open(file.id, name)
        fields = dataset.dtype.names
        if fields:
            if dataset.rank == 1:
                rows = dataset.shape[0]
                found.update({f"{path}/{field}": _Place(dataset, field, (slice(None),), rows) for field in fields})
        elif dataset.dtype.kind in "fiub" and dataset.shape:
            shape, step = dataset.shape, -1 if is_transposed else 1
            for column, index in column_indices(path, shape[::step]).items():
                found[column] = _Place(dataset, None, index[::step], max(shape))

    h5py.h5o.visit(file.id, visit, info=True)
    return found


def _text(value: Any) -> str:
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)


def _damaged(path: Path, error: Exception) -> RecordingError:
    with path.open("rb") as file:
        start = file.read(1024)
    if not start:
        return RecordingError(f"{path} is empty")
    is_hdf5 = _SIGNATURE in (start[:8], start[512:520])
    if is_hdf5 and "truncated" in str(error):
        return RecordingError(
            f"{path} was cut off at byte {path.stat().st_size}: HDF5 does not open such a file, and all rows are lost"
        )
    return damaged(path, "is damaged" if is_hdf5 else "is no HDF5 file", error)
