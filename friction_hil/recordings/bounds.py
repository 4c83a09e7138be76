"""Bounds of what a file may ask for: memory, columns, axes.

A file of some kilobytes can claim, or expand to, any amount of data. These bounds are far beyond recordings of real
axes and are checked before memory is allocated.
"""

import math
import os
import sys
from collections.abc import Sized
from pathlib import Path

from friction_hil.errors import RecordingError

MOST_COLUMNS = 10_000
MOST_AXES = 256
_ANY_FILE = 10**9  # bytes that the content of even the smallest file may take
_EXPANSION = 64  # times its size that the content of a file may take beyond that
_SHARE = 0.5  # of the available memory
_UNITS = ("bytes", "kB", "MB", "GB", "TB", "PB", "EB")


class Memory:
    """Memory that the content of a file may take: `take` it before it is allocated.

    The limit is 1 GB or 64 times the size of the file, whichever is more, and at most half of the available memory.
    Files that are read as one count together.
    """

    def __init__(self, path: Path, *further: Path) -> None:
        self._path = path
        self._files = (path, *further)
        self._taken = 0
        self._limit: int | None = None
        self._is_machine = False  # True if the machine, not the file, sets the limit

    @property
    def left(self) -> int:
        """Number of bytes that may still be taken."""
        if self._limit is None:
            self._limit, available = max(_ANY_FILE, _EXPANSION * self._size), available_memory()
            if self._limit > _SHARE * available:
                self._limit, self._is_machine = int(_SHARE * available), True
        return self._limit - self._taken

    @property
    def _size(self) -> int:
        return sum(file.stat().st_size for file in self._files)

    def take(self, size: int) -> None:
        """Count ``size`` bytes. Raises `RecordingError`: the content of the file takes more than the limit."""
        if size > self.left:
            raise self.exceeded(self._taken + size)
        self._taken += size

    def exceeded(self, needed: int | None = None) -> RecordingError:
        """Return the error for content of ``needed`` bytes; None if it is not known how many there are."""
        left = self.left  # determines the limit
        limit = amount(self._taken + left)
        what = f"{amount(needed)} of memory" if needed is not None else f"more than {limit} of memory"
        size = amount(self._size)
        if self._is_machine:
            return RecordingError(
                f"{self._path}: its content takes {what}, and at most half of the available memory, {limit}, is used: "
                "split the file into shorter ones, or read it on a machine with more memory"
            )
        return RecordingError(
            f"{self._path}: its content takes {what}, which is refused for a file of {size}; the limit is {limit} "
            f"({_EXPANSION} times the size of the file, at least {amount(_ANY_FILE)}): split the file into shorter "
            "ones, or save it without compression"
        )


def check_columns(path: Path, names: Sized) -> None:
    """Raise a `RecordingError` for a table with more than `MOST_COLUMNS` columns."""
    if len(names) > MOST_COLUMNS:
        raise RecordingError(
            f"{path} has {len(names)} columns; at most {MOST_COLUMNS} are read: split it into tables of fewer columns"
        )


def available_memory() -> float:
    """Return the memory that can be allocated without swapping, bytes; infinity if the system does not say."""
    try:
        with open("/proc/meminfo", encoding="ascii") as file:
            facts = dict(line.split(":", 1) for line in file)
        free = float(facts["MemAvailable"].split()[0]) * 1024.0
    except (OSError, KeyError, ValueError):
        free = _physical_memory()
    try:  # of a container
        with open("/sys/fs/cgroup/memory.max", encoding="ascii") as file:
            return min(free, float(file.read()))
    except (OSError, ValueError):  # none, or `max`
        return free


def _physical_memory() -> float:
    if sys.platform == "win32":  # its `os` does not say
        return math.inf
    try:
        return float(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    except (OSError, ValueError):
        return math.inf


def amount(size: int) -> str:
    """Write a number of bytes, e.g. ``6.4 GB``."""
    value, unit = float(size), 0
    while value >= 1000.0 and unit < len(_UNITS) - 1:
        value, unit = value / 1000.0, unit + 1
    return f"{value:.3g} {_UNITS[unit]}"
