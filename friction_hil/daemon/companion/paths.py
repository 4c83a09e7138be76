"""Path of a recording: a free name, and whether it can be written."""

import os
import re
import stat
import time
from datetime import datetime, timedelta
from pathlib import Path

from friction_hil.daemon.control.names import default_name
from friction_hil.errors import RecordingError, UsageError


def free_path(path: str | Path, started_unix_ns: int) -> Path:
    """Return ``path``, or if it exists the same with the local time in its name: ``run-20260131-142530.mcap``.

    It also counts as existing while there are later files of its recording, ``run-2.mcap``.

    This is for the path of a configuration, which is the same at every run; a path that the user gives for one run
    is refused if it exists.

    ``started_unix_ns``: wall-clock time of the start, ns since 1970; 0 for now.
    """
    path = Path(path)
    if not os.path.lexists(path) and not any(part_number(each, path) for each in path.parent.glob("*")):
        return path
    started = datetime.fromtimestamp((started_unix_ns or time.time_ns()) * 1e-9).astimezone()
    while os.path.lexists(free := path.with_stem(f"{path.stem}-{started:%Y%m%d-%H%M%S}")):
        started += timedelta(seconds=1)
    return free


def series_name(config: Path | None, path: Path, daemon: str | None = None) -> str:
    """Return what all recordings of a daemon that were started with a path have in common, and no other ones.

    ``config``: file of the configuration, which names the daemon unless ``daemon`` does. ``path``: file wanted, before
    `free_path` made another one of it.
    """
    return f"{daemon or default_name(config or Path())}/{path.name}"


def part_number(path: Path, first: Path) -> int | None:
    """Return the number of a file by its name, in the recording that begins with ``first``; None if it is no part.

    ``run.mcap`` is 1, ``run-2.mcap`` is 2.
    """
    if path == first:
        return 1
    found = re.fullmatch(rf"{re.escape(first.stem)}-(\d{{1,9}}){re.escape(first.suffix)}", path.name)
    return int(found[1]) if found and first.suffix else None


def part_path(first: Path, number: int) -> Path:
    """Return the file of part ``number`` of a recording; it has a higher number if there are such files already."""
    if number == 1:
        return first
    taken = (part_number(each, first) or 0 for each in first.parent.iterdir())
    return first.with_stem(f"{first.stem}-{max(number, 2, *(each + 1 for each in taken))}")


def prepare(path: Path, *, overwrite: bool) -> None:
    """Create the folder of a recording, and check that the recording can be written.

    Raises `UsageError`: the path does not end in ``.mcap``, or is a folder, a pipe or a socket; `RecordingError`: it
    exists already and must not be overwritten, or its folder cannot be created.
    """
    if path.is_dir():
        raise UsageError(f"{path} is a folder: name the file in it, e.g. {path / 'run.mcap'}")
    if path.exists() and (stat.S_ISFIFO(mode := path.stat().st_mode) or stat.S_ISSOCK(mode)):
        raise UsageError(f"{path} is a {'pipe' if stat.S_ISFIFO(mode) else 'socket'}: a recording needs a file")
    if path.suffix.lower() != ".mcap":
        raise UsageError(f"{path}: recordings are written as .mcap; `friction-hil convert` makes other formats of one")
    if path.exists() and not overwrite:
        raise RecordingError(f"{path} exists already; --force replaces it")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        is_in_the_way = isinstance(error, FileExistsError | NotADirectoryError)
        reason = "there is a file of that name" if is_in_the_way else error.strerror
        raise RecordingError(f"the folder {path.parent} cannot be made: {reason}") from None


def state_folder() -> Path:
    """Return the folder of files that outlive a run and have no place of their own.

    That of a systemd service (``StateDirectory=``), or by the XDG base directories; for a user without a home
    ``/var/lib/friction-hil``.
    """
    if service := os.environ.get("STATE_DIRECTORY", "").partition(":")[0]:
        return Path(service)
    base = os.environ.get("XDG_STATE_HOME", "")
    if not os.path.isabs(base):
        home = os.path.expanduser("~")
        base = os.path.join(home, ".local", "state") if os.path.isabs(home) else "/var/lib"
    return Path(base) / "friction-hil"
