"""Disk space that the recordings of a path may take."""

import os
import re
import stat
from dataclasses import dataclass
from pathlib import Path

from friction_hil.daemon.companion.job import say, warn
from friction_hil.recordings.parts import series_of

_STARTED = r"-\d{8}-\d{6}"  # what `free_path` adds to a name


@dataclass(frozen=True, slots=True)
class _File:
    size: int  # bytes
    age: tuple[int, int] | None = None  # of one that may be removed: start of the run, and number


class Budget:
    """Keeps the files of all recordings of a path within a disk space, by removing the oldest.

    Only files whose content says that this daemon has written them, as the part that their name says, are removed: not
    those of faults, nor files that were renamed, made by another program or cannot be read. Files of faults, and those
    that do not say whose they are, count all the same; those of other daemons do not, nor what is no regular file.

    ``path``: first file of the present recording. ``size``: bytes. ``series``: what the files of this daemon have as
    such.
    """

    def __init__(self, path: Path, size: int, series: str | None = None) -> None:
        self._folder, self._size, self._series = path.parent, size, series
        stem = re.escape(re.sub(f"{_STARTED}$", "", path.stem))
        self._own = re.compile(rf"{stem}({_STARTED})?(?:-(\d+))?\.mcap")
        self._of_faults = re.compile(rf"{stem}({_STARTED})?-fault{_STARTED}(-\d+)?\.mcap")
        self._files: dict[Path, _File] = {}
        self._is_warned = False

    def look(self) -> None:
        """Look which files are there."""
        self._files = {}
        with os.scandir(self._folder) as entries:
            for entry in entries:
                if (found := self._file(entry)) is not None:
                    self._files[self._folder / entry.name] = found

    @property
    def used(self) -> int:
        """Bytes of all files that count."""
        return sum(each.size for each in self._files.values())

    def keep(self, current: Path, written: int) -> None:
        """Remove the oldest files until all fit, with the ``written`` bytes of one that grows."""
        if current.parent.absolute() != self._folder.absolute():  # files of faults may have a folder of their own
            return
        self._files[self._folder / current.name] = _File(written)
        total = self.used
        oldest = sorted((each.age, path) for path, each in self._files.items() if each.age is not None)
        for _, path in oldest:
            if total <= self._size:
                return
            size = self._files[path].size
            try:
                path.unlink(missing_ok=True)
            except OSError as error:
                self._files[path] = _File(size)
                warn(f"{path} cannot be removed, so that recording.budget_mb is exceeded: {error.strerror}")
                continue
            del self._files[path]
            total -= size
            say(removed=str(path))
        if total > self._size and not self._is_warned:
            self._is_warned = True
            warn(
                f"recording.budget_mb is exceeded: besides the file being written, {(total - written) / 1e6:.3g} MB in "
                f"{self._folder} are files of faults or do not say which daemon wrote them, and are kept; move "
                "them away"
            )

    def _file(self, entry: "os.DirEntry[str]") -> _File | None:
        """Return a file that counts; None for any other entry of the folder."""
        own = self._own.fullmatch(entry.name)
        if own is None and self._of_faults.fullmatch(entry.name) is None:
            return None
        try:
            found = entry.stat(follow_symlinks=False)
        except FileNotFoundError:  # removed meanwhile
            return None
        if not stat.S_ISREG(found.st_mode):
            return None
        series, part = series_of(Path(entry.path))
        if series != self._series and series is not None:
            return None
        is_removable = own is not None and series == self._series and part is not None and part[1] == int(own[2] or 1)
        return _File(found.st_size, part if is_removable else None)
