"""What a reader is asked for, and what readers and writers of files share."""

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
    """A file to read, and what of it.

    Attributes
    ----------
    path : path
    axis : str or None
        The axis to take; where a file has one without a name, what it is called.
    wanted : frozenset of str or None
        Columns to take, by the file's names, as far as they are there; None: all.
    select : function
        From the names of the axes in the file, those to read.
    configuration : Configuration or None
        Of the machine, for files that cannot be understood without.
    """

    path: Path
    axis: str | None = None
    wanted: frozenset[str] | None = None
    select: Callable[[list[str]], list[str]] = field(default=lambda names: names)
    configuration: "Configuration | None" = None

    @property
    def name(self) -> str:
        """Name of the only axis of a file that has no names."""
        return self.axis or self.path.stem

    def wants(self, column: str) -> bool:
        """Whether a column is to be read."""
        return self.wanted is None or column in self.wanted

    def split(self, names: Iterable[str]) -> tuple[list[str], tuple[str, ...]]:
        """Columns to read, and the others."""
        names = list(names)
        return [name for name in names if self.wants(name)], tuple(name for name in names if not self.wants(name))


def open_new(path: Path, *, overwrite: bool) -> BinaryIO:
    """Open a file to write, an existing one only to ``overwrite`` it."""
    return path.open("wb" if overwrite else "xb")


def needs_extra(path: Path, package: str) -> UsageError:
    """Say which extra is missing."""
    return UsageError(f'{path}: {package} is needed for this format: pip install "friction-hil[formats]"')


def damaged(path: Path, what: str, error: Exception) -> RecordingError:
    """Say that a library could not read a file; ``what`` says what that means for its content."""
    reason = " ".join(str(error).split()) or type(error).__name__
    return RecordingError(f"{path} {what} ({reason})")


def is_column(values: Any) -> bool:
    """Whether an array is a real vector, which a column would be: (n,), (n, 1) or (1, n)."""
    shape = getattr(values, "shape", None) or ()  # HDF5 has datasets of no shape
    return values.dtype.kind in "fiub" and len(shape) > 0 and math.prod(shape) == max(shape)


def as_column(values: Any) -> Array:
    """Give a numeric vector as contiguous float64 (n,) in the machine's byte order."""
    return np.ascontiguousarray(np.asarray(values).ravel(), dtype=np.float64)


def commonest_length(lengths: dict[str, int], problems: list[str]) -> list[str]:
    """Names of the vectors that have the commonest length; the others are told."""
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
