"""Read and write Parquet with pyarrow; units are in the metadata of the fields."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from friction_hil.errors import RecordingError
from friction_hil.recordings import lerobot
from friction_hil.recordings.bounds import check_columns
from friction_hil.recordings.matrices import MOST_WIDE, column_indices
from friction_hil.recordings.recording import Array, Recording
from friction_hil.recordings.source import Source, as_column, damaged, needs_extra, open_new
from friction_hil.recordings.units import known_unit

_UNIT_KEYS = (b"unit", b"units")
_SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}


def read(source: Source) -> list[Recording]:
    """Read the numeric columns, and lists of numbers as matrices; missing values are NaN.

    Times are seconds since the first. The data of LeRobot are read joint by joint (`friction_hil.recordings.lerobot`).
    Raises `RecordingError`: the file was cut off or is not Parquet; `UsageError`: pyarrow is not installed; `OSError`:
    the file cannot be opened.
    """
    arrow, parquet = library(source.path)
    recording = Recording(str(source.path), source.name, {})
    source.path.open("rb").close()  # raises the usual error where the file cannot be opened
    # arrow's own file: its threads may still hold it when an error is raised, and crash with one of Python's
    with arrow.OSFile(str(source.path)) as file:
        try:
            content = parquet.ParquetFile(file, page_checksum_verification=True)
            fields = {field.name: field for field in content.schema_arrow}
            check_columns(source.path, fields)
            is_lerobot = lerobot.is_frames(name for name, each in fields.items() if is_list(arrow.types, each.type))
            names = []
            for name, each in fields.items():
                if not (is_lerobot or source.wants_part_of(name)):
                    recording.others += (name,)
                elif is_number(arrow.types, each.type) or is_list(arrow.types, each.type):
                    names.append(name)
                elif not is_lerobot:  # pictures are expected there
                    recording.problems.append(f"{name} holds {each.type}, no numbers: left out")
            source.memory.take(8 * _count(content.metadata, names))
            matrices = {}
            for name, column in _columns(arrow, content, names, recording.problems):
                if is_list(arrow.types, fields[name].type):
                    matrices[name] = _matrix(arrow, name, column, recording.problems)
                    continue
                recording.columns[name] = values_of(arrow, column)
                metadata = fields[name].metadata or {}
                unit = next((metadata[key] for key in _UNIT_KEYS if key in metadata), b"")
                if unit:
                    recording.units[name] = unit.decode("utf-8", "replace")
        except (arrow.ArrowException, ValueError, OSError) as error:
            raise _damaged(source.path, error) from None
    if is_lerobot:
        return lerobot.joints(source, recording, matrices)
    for name, values in matrices.items():
        indices = column_indices(name, values.shape)
        wanted, others = source.split(indices)
        recording.others += others
        recording.columns |= {each: as_column(values[indices[each]]) for each in wanted}
    return [recording]


def _count(metadata: Any, names: list[str]) -> int:
    """Return the number of values in columns, also in their lists, as the table of contents states it."""
    count = 0
    for group in map(metadata.row_group, range(metadata.num_row_groups)):
        for column in map(group.column, range(group.num_columns)):
            path = column.path_in_schema
            if path in names or any(path.startswith(f"{name}.") for name in names):
                count += column.num_values
    return count


def write(path: Path, recording: Recording, *, overwrite: bool) -> None:
    """Write the columns as float64, with their units, and a checksum for each page.

    Raises `UsageError`: pyarrow is not installed; `OSError`: the file exists, unless ``overwrite``, or cannot be
    written.
    """
    arrow, parquet = library(path)
    fields = []
    for name in recording.columns:
        unit = known_unit(recording.units, name)
        fields.append(arrow.field(name, arrow.float64(), metadata={"unit": unit} if unit else None))
    table = arrow.table(list(recording.columns.values()), schema=arrow.schema(fields))
    with open_new(path, overwrite=overwrite) as file:
        parquet.write_table(table, file, write_page_checksum=True)


def library(path: Path) -> tuple[Any, Any]:
    """Return pyarrow and its module for Parquet. Raises `UsageError`: it is not installed."""
    try:  # imported here: an optional package
        import pyarrow
        import pyarrow.compute
        import pyarrow.parquet
    except ImportError:
        raise needs_extra(path, "pyarrow") from None
    return pyarrow, pyarrow.parquet


def _columns(arrow: Any, content: Any, names: list[str], problems: list[str]) -> Iterator[tuple[str, Any]]:
    """Yield name and content of each column; a damaged column is reported and costs only itself."""
    try:
        table = content.read(columns=names)
    except (arrow.ArrowException, OSError):
        table = None
    for name in names:
        try:
            yield name, (content.read(columns=[name]) if table is None else table).column(name)
        except (arrow.ArrowException, OSError) as error:
            problems.append(f"{name} is damaged ({' '.join(str(error).split())}): left out")


def is_number(types: Any, kind: Any) -> bool:
    """True if a type of Arrow holds numbers or times."""
    tests = (
        types.is_integer,
        types.is_floating,
        types.is_decimal,
        types.is_boolean,
        types.is_timestamp,
        types.is_duration,
    )
    return any(test(kind) for test in tests)


def is_list(types: Any, kind: Any) -> bool:
    """True if a type of Arrow holds lists of numbers."""
    tests = (types.is_list, types.is_large_list, types.is_fixed_size_list)
    return any(test(kind) for test in tests) and is_number(types, kind.value_type)


def _matrix(arrow: Any, name: str, column: Any, problems: list[str]) -> Array:
    """Return a column of lists as a matrix (n, k), (n, 0) if they differ in length; a row without one is NaN."""
    column = column.combine_chunks()
    known = column.is_valid().to_numpy(zero_copy_only=False)
    values = values_of(arrow, arrow.chunked_array([column.flatten()]))  # of the rows that have a list
    width, rest = divmod(len(values), max(int(np.count_nonzero(known)), 1))
    lengths = arrow.compute.list_value_length(column).drop_null().unique()
    if rest or len(lengths) > 1 or width > MOST_WIDE:
        problems.append(f"{name} holds lists of different lengths, or of more than {MOST_WIDE} values: left out")
        width = 0
    found: Array = np.full((len(known), width), np.nan)
    if width:
        found[known] = values.reshape(-1, width)
    return found


def values_of(arrow: Any, column: Any) -> Any:
    """Return a column of numbers as float64."""
    kind = column.type
    types = arrow.types
    if types.is_float64(kind) and column.null_count == 0:
        return as_column(column.to_numpy())
    if types.is_timestamp(kind) or types.is_duration(kind):
        # masked, because nulls become the smallest integer in numpy
        whole = column.cast(arrow.int64())
        valid = whole.is_valid().to_numpy()
        ticks = whole.fill_null(0).to_numpy()
        origin = ticks[valid][0] if valid.any() and types.is_timestamp(kind) else 0
        return np.where(valid, (ticks - origin) * _SECONDS[kind.unit], np.nan)
    if types.is_boolean(kind):
        column = column.cast(arrow.int8())
    return as_column(column.cast(arrow.float64(), safe=False).to_numpy())


def _damaged(path: Path, error: Exception) -> RecordingError:
    size = path.stat().st_size
    with path.open("rb") as file:
        is_parquet = file.read(4) == b"PAR1"
        file.seek(max(0, size - 4))
        is_whole = file.read(4) == b"PAR1" and size > 8
    if not size:
        return RecordingError(f"{path} is empty")
    if is_parquet and not is_whole:
        return RecordingError(
            f"{path} was cut off at byte {size}: the table of contents at the end of a Parquet file is missing, "
            "and without it all rows are lost"
        )
    return damaged(path, "is damaged" if is_parquet else "is no Parquet file", error)
