"""Recordings from memory: arrays by the names of columns, and data frames of any library."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from friction_hil.errors import RecordingError, UsageError
from friction_hil.recordings.files import mapped_to
from friction_hil.recordings.mapping import Mapped, split_factors
from friction_hil.recordings.matrices import column_indices, without_blanks
from friction_hil.recordings.parquet_file import is_number, library, values_of
from friction_hil.recordings.recording import Recording
from friction_hil.recordings.source import as_column

_PROTOCOLS = ("__arrow_c_stream__", "__dataframe__")


def from_table(
    table: Any,
    axis: str = "table",
    *,
    columns: Mapping[str, str] | None = None,
    scale: Mapping[str, float] | None = None,
    where: str | None = None,
    rate_hz: float | None = None,
    is_preview: bool = False,
) -> Recording:
    """Make a recording of one axis from arrays or a data frame; `read` does the same from a file.

    Parameters
    ----------
    table : dict of arrays, or data frame
        Arrays by the names of columns, (n,) or (n, k), SI: ``{"time_s": t, "position": q, "torque": tau}``; a column of
        a matrix is ``q[:,3]``. Or a table of pandas, Polars, Arrow and others, by the Arrow PyCapsule or the data
        frame interchange protocol, which takes pyarrow. The values are copied.
    axis : str
        Name of the axis.
    columns, scale, where, rate_hz, is_preview
        As of `read`.

    Raises
    ------
    RecordingError
        Arrays differ in length, or there are no finite time stamps.
    UsageError
        It is no table, a mapped column does not exist, or pyarrow is not installed.

    Examples
    --------
    >>> import friction_hil as fh
    >>> rows = {"position": [0.0, 0.1, 0.3], "current": [2.0, 2.0, 4.0]}
    >>> recording = fh.recordings.from_table(rows, "elbow", columns={"torque": "current*0.5"}, rate_hz=1000.0)
    >>> recording["torque"], recording["time_s"]
    (array([1., 1., 2.]), array([0.   , 0.001, 0.002]))
    """
    recording = Recording(axis, axis, {})
    if isinstance(table, Mapping):
        recording.columns = dict(_arrays(axis, table, recording))
    elif any(hasattr(table, each) for each in _PROTOCOLS):
        recording.columns = dict(_of_data_frame(axis, table, recording))
    else:
        raise UsageError(
            f"{type(table).__name__} is no recording: give a path, a Recording, arrays by the names of columns, or a "
            "data frame"
        )
    sizes = {name: len(values) for name, values in recording.columns.items()}
    if len(set(sizes.values())) > 1:
        several = ", ".join(f"{name} {size}" for name, size in sizes.items())
        raise RecordingError(f"{axis}: the arrays of a recording have one length, not {several}")
    given, factors = split_factors({name: without_blanks(source) for name, source in (columns or {}).items()})
    mapped = Mapped(given, {**factors, **(scale or {})}, rate_hz=rate_hz)
    return mapped_to(recording, mapped, where, is_preview=is_preview)


def _arrays(path: str, table: Mapping[Any, Any], recording: Recording) -> Iterator[tuple[str, Any]]:
    """Yield the columns in arrays; what is no number is reported."""
    for key, each in table.items():
        name = str(key)
        values = np.asarray(each)
        if values.dtype.kind in "mM":  # seconds since the first
            ticks = values - values.flat[0] if values.dtype.kind == "M" and values.size else values
            values = ticks / np.timedelta64(1, "s")
        indices = column_indices(name, values.shape) if values.dtype.kind in "fiub" else {}
        if not indices and values.shape == (1,) and values.dtype.kind in "fiub":
            indices = {name: (slice(None),)}
        for column, index in indices.items():
            yield column, np.array(as_column(values[index]))
        if not indices and values.size:
            recording.problems.append(f"{name} is {values.dtype} of shape {values.shape}, no column: left out")


def _of_data_frame(path: str, table: Any, recording: Recording) -> Iterator[tuple[str, Any]]:
    """Yield the columns of a data frame; what is no number is reported."""
    arrow, _ = library(Path(path))
    if hasattr(table, _PROTOCOLS[0]):
        content = arrow.table(table)
    else:
        from pyarrow.interchange import from_dataframe  # imported here: an optional package

        content = from_dataframe(table)
    for field in content.schema:
        if is_number(arrow.types, field.type):
            yield field.name, values_of(arrow, content.column(field.name))
        else:
            recording.problems.append(f"{field.name} holds {field.type}, no numbers: left out")
