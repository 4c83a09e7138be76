"""Disk space that the recordings of a path may take."""

import re
from collections.abc import Iterator
from pathlib import Path

from friction_hil.daemon.companion.job import say, warn
from friction_hil.recordings.parts import part_of

_STARTED = r"-\d{8}-\d{6}"  # what `free_path` adds to a name


class Budget:
    """Keeps the files of all recordings of a path within a disk space, by removing the oldest.

    Only files that a daemon has written as parts of a recording are removed: not those of faults, nor files that were
    renamed or made by another program. Files of faults count all the same.

    Parameters
    ----------
    path : Path
        First file of the present recording.
    size : int
        Bytes.
    """

    def __init__(self, path: Path, size: int) -> None:
        self._folder, self._size = path.parent, size
        stem = re.escape(re.sub(f"{_STARTED}$", "", path.stem))
        self._own = re.compile(rf"{stem}({_STARTED})?(-\d+)?\.mcap")
        self._of_faults = re.compile(rf"{stem}({_STARTED})?-fault{_STARTED}(-\d+)?\.mcap")
        self._removable: list[tuple[tuple[int, int], Path, int]] = []  # age, file, bytes; the oldest last
        self._others = 0  # bytes
        self._is_warned = False

    def look(self, current: Path) -> None:
        """Look which files are there, ``current`` being written."""
        self._removable, self._others = [], 0
        for path, size in self._files():
            age = part_of(path) if self._own.fullmatch(path.name) else None
            if path == current:
                continue
            if age is None:
                self._others += size
            else:
                self._removable.append((age, path, size))
        self._removable.sort(reverse=True)

    def keep(self, current_size: int) -> None:
        """Remove the oldest files until all fit, with ``current_size`` bytes of the one that is being written."""
        total = current_size + self._others + sum(size for *_, size in self._removable)
        while total > self._size and self._removable:
            _, path, size = self._removable.pop()
            try:
                path.unlink(missing_ok=True)
            except OSError as error:
                self._others += size
                warn(f"{path} cannot be removed, so that recording.budget_mb is exceeded: {error.strerror}")
                continue
            total -= size
            say(removed=str(path))
        if total > self._size and not self._is_warned:
            self._is_warned = True
            warn(
                f"recording.budget_mb is exceeded: {self._others / 1e6:.3g} MB in {self._folder} are files of faults, "
                "which are kept; move them away"
            )

    def _files(self) -> Iterator[tuple[Path, int]]:
        for path in self._folder.iterdir():
            if self._own.fullmatch(path.name) or self._of_faults.fullmatch(path.name):
                try:
                    yield path, path.stat().st_size
                except FileNotFoundError:  # removed meanwhile
                    continue
