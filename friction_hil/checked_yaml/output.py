"""Files that will be written, checked before the work for them is done."""

import os
from pathlib import Path

from friction_hil.errors import UsageError


def check_model_path(path: Path, option: str = "") -> None:
    """Check the name of a model file that will be written.

    Raises `UsageError`: it has another suffix than .yaml, or the file cannot be written.
    """
    if path.suffix not in (".yaml", ".yml"):
        raise UsageError(f"{option}{path}: a model file ends in .yaml")
    check_writable(path, option)


def check_writable(path: Path, option: str = "") -> None:
    """Check that a file can be written where an option, e.g. ``--output ``, names it.

    Hours of work must not fail at their last step.

    Raises `UsageError`: there is no such folder, the name is that of a folder, or writing is not permitted.
    """
    folder = path.parent
    if path.is_dir():
        raise UsageError(f"{option}{path} is a folder; name a file")
    if not folder.is_dir():
        raise UsageError(f"{option}{path}: there is no folder {folder}; create it first")
    if not os.access(path if path.exists() else folder, os.W_OK):
        raise UsageError(f"{option}{path} cannot be written: permission denied; name another file")
