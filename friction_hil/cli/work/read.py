"""Files that a command line names: patterns of files, and recordings of one axis."""

import glob
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from friction_hil import recordings
from friction_hil.errors import UsageError
from friction_hil.recordings import Recording
from friction_hil.recordings.parts import first_files, without_later_parts

if TYPE_CHECKING:
    from friction_hil.recordings.columns import AxisKind


def expanded(words: Iterable[str | Path]) -> list[str]:
    """Replace each pattern (``*``, ``?``, ``[..]``, ``**``) by the files that it matches, sorted by name.

    The shell does so unless a pattern is quoted. A file whose name looks like a pattern is taken as it is. A folder
    stands for the recordings of the daemon in it. Of the files of one recording only the first remains: it is read with
    those that follow.

    Raises `UsageError`: a pattern matches nothing, or a folder has no recording.
    """
    found: list[str] = []
    for word in map(str, words):
        if Path(word).is_dir():
            found += map(str, first_files(Path(word)))
            continue
        if not glob.has_magic(word) or Path(word).exists():
            found.append(word)
            continue
        matches = sorted(path for path in glob.glob(word, recursive=True) if Path(path).is_file())
        if not matches:
            raise UsageError(f"{word}: no file matches")
        found += matches
    return without_later_parts(dict.fromkeys(found)) if len(found) > 1 else found


def read_recordings(sources: Iterable[Path], axis: str | None, **options: Any) -> list[Recording]:
    """Read the recordings of one axis from files and patterns; ``options`` are those of `recordings.read`.

    Raises `UsageError`: a pattern matches nothing, or a file has several axes and none is chosen; `RecordingError`: a
    file cannot be read.
    """
    return [recordings.read(source, axis, **options) for source in expanded(sources)]


def kind_of(found: Iterable[Recording], *, is_linear: bool) -> "AxisKind":
    """Return the kind of the axis: as the daemon has recorded it, and by the option where the files do not say.

    Raises `UsageError`: the files say that the axis is rotary, and the option that it is linear; or the files differ.
    """
    kind: AxisKind | None = "linear" if is_linear else None
    by = "--linear"
    for each in found:
        own = each.axis_kind
        if own is not None and kind not in (None, own):
            raise UsageError(f"{each.path}: axis {each.axis!r} is {own} by its configuration, and {kind} by {by}")
        if own is not None:
            kind, by = own, each.path
    return kind or "rotary"
