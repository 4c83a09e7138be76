"""Request to a reader of files, and helpers that readers and writers share."""

import contextlib
import os
import secrets
import shutil
from collections.abc import Callable, Iterable, Iterator
from dataclasses import InitVar, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, TypeVar

import numpy as np

from friction_hil.errors import RecordingError, UsageError
from friction_hil.recordings.bounds import Memory, check_columns
from friction_hil.recordings.matrices import array_of
from friction_hil.recordings.recording import Array

if TYPE_CHECKING:
    from friction_hil.config import Configuration

Value = TypeVar("Value")


@dataclass(frozen=True, slots=True)
class Source:
    """Request to read axes and columns of a file."""

    path: Path
    axis: str | None = None  # to read; the name of the axis in a file whose only axis has none
    wanted: frozenset[str] | None = None  # columns to read, by the file's names, if they exist; None: all
    # from the names of all axes in the file to those to read
    select: Callable[[list[str]], list[str]] = field(default=lambda names: names)
    configuration: "Configuration | None" = None  # of the machine, for formats that require it
    shared: InitVar[Memory | None] = None  # by files which are read as one
    memory: Memory = field(init=False, compare=False, repr=False)  # that the content of the file may take

    def __post_init__(self, shared: Memory | None) -> None:
        object.__setattr__(self, "memory", shared or Memory(self.path))

    @property
    def name(self) -> str:
        """Name of the only axis of a file that does not name it."""
        return self.axis or self.path.stem

    def wants(self, column: str) -> bool:
        """True if a column is to be read."""
        return self.wanted is None or column in self.wanted

    def wants_part_of(self, array: str) -> bool:
        """True if an array, or a column of it if it is a matrix, is to be read."""
        return self.wants(array) or any(array_of(each) == array for each in self.wanted or ())

    def split(self, names: Iterable[str]) -> tuple[list[str], tuple[str, ...]]:
        """Split names into columns to read and others.

        Raises `RecordingError`: there are more columns than a table may have.
        """
        names = list(names)
        check_columns(self.path, names)
        if self.wanted is None:
            return names, ()
        return [name for name in names if name in self.wanted], tuple(name for name in names if name not in self.wanted)


@contextlib.contextmanager
def new_file(path: Path, *, overwrite: bool) -> Iterator[Path]:
    """Yield the name of a file to write beside ``path``; it becomes ``path`` only if all of it has been written.

    What is no regular file, such as ``/dev/null`` or a pipe, is written to as it is. Raises `FileExistsError`: ``path``
    exists, unless ``overwrite``; `OSError`: the file cannot be written.
    """
    if path.exists():
        if not overwrite:
            raise FileExistsError(path)
        if not path.is_file():
            yield path
            return
    final = Path(os.path.realpath(path))  # a link is kept, and what it points to is replaced
    part = final.with_name(f".{secrets.token_hex(4)}.part{final.suffix}")
    try:
        yield part
        if final.exists():
            shutil.copymode(final, part)
        _publish(part, final, overwrite=overwrite)
    finally:
        part.unlink(missing_ok=True)


def _publish(part: Path, final: Path, *, overwrite: bool) -> None:
    """Give a complete file its final name; one that has appeared in the meantime is not replaced unasked."""
    if not overwrite:
        try:
            os.link(part, final)
        except FileExistsError:
            raise
        except OSError:  # a file system without links
            if final.exists():
                raise FileExistsError(final) from None
        else:
            return
    os.replace(part, final)


@contextlib.contextmanager
def open_new(path: Path, *, overwrite: bool) -> Iterator[BinaryIO]:
    """Open a `new_file` to write."""
    with new_file(path, overwrite=overwrite) as part, part.open("wb") as file:
        yield file


def needs_extra(path: Path, package: str) -> UsageError:
    """Return the error that names the missing extra."""
    return UsageError(f'{path}: {package} is needed for this format: pip install "friction-hil[formats]"')


def damaged(path: Path, what: str, error: Exception) -> RecordingError:
    """Return the error for a file that a library could not read; ``what`` states the consequence."""
    reason = " ".join(str(error).split()) or type(error).__name__
    return RecordingError(f"{path} {what} ({reason})")


def as_column(values: Any) -> Array:
    """Return a numeric vector as contiguous, writeable float64 (n,) in native byte order.

    Arrow's columns are read-only, which is another type to numba: kernels would be compiled for it once more.
    """
    return np.require(np.asarray(values).ravel(), np.float64, ["C", "W"])
