"""Exceptions that nobody expects in the loop: each becomes a fault, so that the run ends as after any other fault."""

import contextlib
import mmap
import traceback
from pathlib import Path

from friction_hil.drive.codes import FaultCode
from friction_hil.errors import FrictionHilError

_RESERVE_BYTES = 16 << 20  # enough for the stop, the end of the recording and the summary
_MOST_CHARACTERS = 60  # of an exception's message: an event of the recording holds 188 bytes, with the code at the end
_MOST_CALLS = 8
_FILE_PARTS = 3  # of a path: the package, its folder and the file


class Reserve:
    """Memory that is given back when there is no other, so that what stops the drives does not lack any.

    Where the limit of locked memory leaves no room for it there is none; `realtime.py` reports such a limit (FH-311).
    """

    def __init__(self) -> None:
        self._memory: mmap.mmap | None = None
        with contextlib.suppress(OSError, MemoryError):
            self._memory = mmap.mmap(-1, _RESERVE_BYTES)

    @property
    def is_there(self) -> bool:
        """True until it is released."""
        return self._memory is not None

    def release(self) -> None:
        """Give the memory back to the system; a second call does nothing."""
        if self._memory is not None:
            self._memory.close()
            self._memory = None


def fault_of(error: Exception) -> str:
    """Return the text of the fault for an exception that has ended the loop.

    Errors raised deliberately have their message, others the type, the place and what to do: they are mistakes in this
    software or in a driver.
    """
    if isinstance(error, FrictionHilError):
        return FaultCode.EXCHANGE_FAILED.append_to(str(error))
    where = _places(error)[-1]
    if isinstance(error, MemoryError):
        return FaultCode.NO_MEMORY.append_to(f"there is no memory left ({where})")
    message = " ".join(str(error).split())
    if len(message) > _MOST_CHARACTERS:
        message = f"{message[:_MOST_CHARACTERS]}..."
    said = f"{type(error).__name__}: {message}" if message else type(error).__name__
    # not append_to: a code in the exception's message is not that of this fault
    return f"program error: {said} ({where}); please report it [{FaultCode.PROGRAM_ERROR}]"


def calls_of(error: Exception) -> list[str]:
    """Return the last calls before an exception, outermost first; none for errors raised deliberately."""
    return [] if isinstance(error, FrictionHilError) else _places(error)[-_MOST_CALLS:]


def _places(error: Exception) -> list[str]:
    # without the lines of the source, which would have to be read from files
    frames = traceback.StackSummary.extract(traceback.walk_tb(error.__traceback__), lookup_lines=False)
    places = [f"{'/'.join(Path(each.filename).parts[-_FILE_PARTS:])}:{each.lineno}, {each.name}" for each in frames]
    return places or ["at an unknown place"]
