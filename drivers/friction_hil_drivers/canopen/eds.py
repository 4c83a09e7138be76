"""Reading EDS and DCF files, including those with faulty comments."""

import configparser
import io
import re
from pathlib import Path
from typing import TYPE_CHECKING

from friction_hil.errors import UsageError

if TYPE_CHECKING:
    from canopen import ObjectDictionary

FOLDER = Path(__file__).parents[1] / "eds"
SIMULATED_SERVO = FOLDER / "friction_hil_servo.eds"

# Many vendors number their comments wrongly, and canopen fails on that; the comments are not needed.
_COMMENTS = re.compile(r"^\[Comments\][^\[]*", re.MULTILINE | re.IGNORECASE)


def load_eds(path: Path, node: int) -> "ObjectDictionary":
    """Read an EDS or DCF file for the node ``node``.

    Raises
    ------
    UsageError
        The file cannot be read or is not an EDS.
    """
    # imported here: canopen takes 0.5 s, and only an axis with an EDS needs it to check a configuration
    import canopen

    if path.suffix.lower() not in (".eds", ".dcf"):
        raise UsageError(f"{path} is not an EDS: its name should end in .eds or .dcf")
    try:
        text = path.read_text(encoding="utf-8-sig", errors="replace")  # Windows tools begin files with a mark
    except OSError as error:
        raise UsageError(f"the EDS {path} cannot be read: {error.strerror or error}") from error
    source = io.StringIO(_COMMENTS.sub("", text))
    source.name = path.name
    try:
        dictionary = canopen.import_od(source, node)
    except (configparser.Error, ValueError, KeyError, TypeError) as error:
        reason = str(error).partition("\n")[0]  # the lines after it quote the file, which may be anything
        raise UsageError(f"{path} is no valid EDS: {reason}") from error
    if len(dictionary) == 0:
        raise UsageError(f"{path} is not an EDS: it has no object")
    return dictionary
