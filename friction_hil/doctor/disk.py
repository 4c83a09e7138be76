"""Checks of the disk on which a recording is to be written: rights, space, speed."""

import os
import shutil
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from friction_hil.daemon.companion.budget import Budget
from friction_hil.drive.finding import Finding

_LEAST_FREE_BYTES = 1 << 30
_LEAST_HOURS = 1.0
_PIECES, _PIECE_BYTES = 4, 1 << 20
_FASTER = 4.0  # than the recording: the disk has other work too
_LONGEST_S = 4.0  # to force a piece to the disk: half of what the ring holds meanwhile


def recording_folder(path: Path, rate: float, budget: int | None, series: str | None = None) -> Finding:
    """Check whether a recording can be written to ``path``, whose folder need not exist yet, and for how long.

    ``rate``: bytes per second, without compression. ``budget``: bytes that all recordings may take. ``series``: what
    all recordings of the daemon have in common.
    """
    check, folder = "recording", _existing_folder(path)
    if not (folder.is_dir() and os.access(folder, os.W_OK | os.X_OK)):
        detail = f"{path} cannot be written: {folder} is no folder that the user may write to"
        fix = "change recording.path, or give the user write access to the folder"
        return Finding(check, "fail", detail, fix, "FH-307")
    free = shutil.disk_usage(folder).free
    hours = free / rate / 3600.0
    detail = f"{path} can be written; {free / 1e9:.3g} GB are free, for {hours:.3g} hours or more"
    if budget is None:
        if free < _LEAST_FREE_BYTES or hours < _LEAST_HOURS:
            fix = "free some space, or let recording.budget_mb remove the oldest files: a full disk stops the recording"
            return Finding(check, "warn", detail, fix, "FH-308")
        return Finding(check, "pass", detail)
    files = Budget(path, budget, series)
    if path.parent.exists():
        files.look()
    detail += f"; budget_mb allows {budget / 1e9:.3g} GB, {files.used / 1e9:.3g} GB of them are used"
    if budget - files.used > free:
        fix = "free some space, or reduce recording.budget_mb: the disk is full before the oldest files are removed"
        return Finding(check, "warn", detail, fix, "FH-308")
    return Finding(check, "pass", detail)


def recording_speed(path: Path, rate: float, clock: Callable[[], float] = time.monotonic) -> Finding:
    """Write a few megabytes beside ``path``, force them to the disk as the recording does, and remove them.

    ``rate``: of the recording, bytes per second, without compression. ``clock``: monotonic time, s.
    """
    check, data, longest_s = "disk", os.urandom(_PIECE_BYTES), 0.0
    began_s = clock()
    try:
        with tempfile.TemporaryFile(dir=_existing_folder(path)) as file:
            for _ in range(_PIECES):
                piece_s = clock()
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
                longest_s = max(longest_s, clock() - piece_s)
    except OSError as error:
        detail = f"its speed is unknown: a file could not be written ({error.strerror})"
        return Finding(check, "warn", detail, "free some space, or see the message", "FH-330")
    speed = _PIECES * _PIECE_BYTES / max(clock() - began_s, 1e-9)
    detail = f"{speed / 1e6:.3g} MB/s, at most {1e3 * longest_s:.3g} ms a megabyte"
    detail += f"; the recording needs {rate / 1e6:.3g} MB/s"
    if speed < _FASTER * rate or longest_s > _LONGEST_S:
        fix = "record to a faster disk, a smaller number of axes, or at a longer period_s"
        return Finding(check, "warn", f"{detail}: rows may be lost", fix, "FH-329")
    return Finding(check, "pass", detail)


def _existing_folder(path: Path) -> Path:
    return next(each for each in path.absolute().parents if each.exists())
