"""Files of JSON lines that grow line by line, and survive the end of the process that writes them."""

import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from friction_hil.errors import FrictionHilError


def append(path: Path, lines: Sequence[Mapping[str, Any]]) -> None:
    """Append lines to a file, safe on the disk; a `FrictionHilError`: the file cannot be written."""
    if not lines:
        return
    text = "".join(json.dumps(line, allow_nan=False, separators=(",", ":")) + "\n" for line in lines)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        _cut_open_line(path)
        with path.open("a", encoding="utf-8") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
    except OSError as error:
        raise FrictionHilError(f"{path} cannot be written: {error.strerror}") from None


def _cut_open_line(path: Path) -> None:
    """Remove a last line that was cut off while it was written."""
    if not path.exists():
        return
    with path.open("r+b") as file:
        if not file.seek(0, os.SEEK_END):
            return
        file.seek(-1, os.SEEK_END)
        if file.read(1) != b"\n":
            file.seek(0)
            file.truncate(file.read().rfind(b"\n") + 1)
