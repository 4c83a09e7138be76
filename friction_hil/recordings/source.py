"""Request to a reader of files, and helpers that readers and writers share."""

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, TypeVar

import numpy as np

from friction_hil.errors import RecordingError, UsageError
from friction_hil.recordings.recording import Array

if TYPE_CHECKING:
    from friction_hil.config import Configuration

Value = TypeVar("Value")


@dataclass(frozen=True, slots=True)
class Source:
    """Request to read axes and columns of a file.

    Attributes
    ----------
    path : path
    axis : str or None
        Axis to read; the name of the axis in a file whose only axis has none.
    wanted : frozenset of str or None
        Columns to read, by the file's names, if they exist; None: all.
    select : function
        From the names of all axes in the file to those to read.
    configuration : Configuration or None
        Configuration of the machine, for formats that require it.
    """

    path: Path
    axis: str | None = None
    wanted: frozenset[str] | None = None
    select: Callable[[list[str]], list[str]] = field(default=lambda names: names)
    configuration: "Configuration | None" = None

    @property
    def name(self) -> str:
        """Name of the only axis of a file that does not name it."""
        return self.axis or self.path.stem

    def wants(self, column: str) -> bool:
        """True if a column is to be read."""
        return self.wanted is None or column in self.wanted

    def split(self, names: Iterable[str]) -> tuple[list[str], tuple[str, ...]]:
        """Split names into columns to read and others."""
        names = list(names)
        return [name for name in names if self.wants(name)], tuple(name for name in names if not self.wants(name))


def open_new(path: Path, *, overwrite: bool) -> BinaryIO:
    """Open a file to write; an existing one is an error unless ``overwrite``."""
    return path.open("wb" if overwrite else "xb")


def needs_extra(path: Path, package: str) -> UsageError:
    """Return the error that names the missing extra."""
    return UsageError(f'{path}: {package} is needed for this format: pip install "friction-hil[formats]"')


def damaged(path: Path, what: str, error: Exception) -> RecordingError:
    """Return the error for a file that a library could not read; ``what`` states the consequence."""
    reason = " ".join(str(error).split()) or type(error).__name__
    return RecordingError(f"{path} {what} ({reason})")


def is_column(values: Any) -> bool:
    """True if an array is a real vector and can be a column: (n,), (n, 1) or (1, n)."""
    shape = getattr(values, "shape", None) or ()  # HDF5 has datasets without a shape
    return values.dtype.kind in "fiub" and len(shape) > 0 and math.prod(shape) == max(shape)


def as_column(values: Any) -> Array:
    """Return a numeric vector as contiguous float64 (n,) in native byte order."""
    return np.ascontiguousarray(np.asarray(values).ravel(), dtype=np.float64)


def most_frequent_length(lengths: dict[str, int], problems: list[str]) -> list[str]:
    """Return the names of the vectors that have the most frequent length; report the others."""
    counts: dict[int, int] = {}
    for size in lengths.values():
        counts[size] = counts.get(size, 0) + 1
    rows = max(counts, key=lambda size: (counts[size], size))
    problems += [
        f"{name} has {size} values, the other columns {rows}: left out"
        for name, size in lengths.items()
        if size != rows
    ]
    return [name for name, size in lengths.items() if size == rows]
