"""Messages between the control process and the companion."""

import contextlib
import json
import os
import sys
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from friction_hil.printable import printable

if TYPE_CHECKING:
    from friction_hil.recordings.columns import AxisKind

CANNOT_OPEN = 2  # exit status of a first worker that could not open its file and has reported why
_INPUT, _OUTPUT = 0, 1


@dataclass(frozen=True, slots=True)
class Job:
    """Job of the companion.

    A row of the ring holds, for each axis in turn, its ``columns`` and then ``state_width`` values of state.

    Attributes
    ----------
    axes : list of str
        Names of the axes.
    columns : list of str
        Columns of every axis, from `friction_hil.recordings.columns`.
    state_width : int
        Values of compensator state an axis, before the step of the cycle.
    period_s : float
        Period of the loop, s.
    started_unix_ns : int
        Wall-clock time of ``time_s`` = 0, ns since 1970.
    path : str, optional
        File of the recording, ``.mcap``; none when absent.
    overwrite : bool
        True to replace an existing file; otherwise it is an error.
    metadata : dict
        Values that JSON can hold, by name; written to the file before the first row.
    status_line : bool
        True to print a live line to standard error.
    kinds : list of {"rotary", "linear"}
        Kind of each axis, for the units of the status line; all rotary when empty.
    """

    axes: list[str]
    columns: list[str]
    state_width: int
    period_s: float
    started_unix_ns: int
    path: str | None = None
    overwrite: bool = False
    metadata: dict[str, Any] = field(default_factory=dict)
    status_line: bool = False
    kinds: "list[AxisKind]" = field(default_factory=list)

    @property
    def row_width(self) -> int:
        """Number of values in a row of the ring."""
        return len(self.axes) * (len(self.columns) + self.state_width)


def encode(job: Job, ring_descriptor: int) -> bytes:
    """Return the job as one line for the companion's standard input."""
    return json.dumps([ring_descriptor, asdict(job)]).encode() + b"\n"


def receive() -> tuple[Job, int]:
    """Read the job and the descriptor of the ring from standard input, which stays open.

    Raises
    ------
    EOFError
        The control process ended before it sent a job.
    """
    line = bytearray()
    while not line.endswith(b"\n"):
        data = os.read(_INPUT, 1 << 16)
        if not data:
            raise EOFError("no job came")
        line += data
    ring_descriptor, job = json.loads(line)
    return Job(**job), ring_descriptor


def say(**message: Any) -> None:
    """Send the control process a message: ``opened`` (path or None) and ``pid``, ``failed`` or ``problem``."""
    # the control process may be gone: the recording still has to be finished
    with contextlib.suppress(BrokenPipeError):
        os.write(_OUTPUT, json.dumps(message).encode() + b"\n")


def warn(problem: str) -> None:
    """Report a problem to the user now, and to the control process when it reads."""
    with contextlib.suppress(OSError):  # the terminal may be gone; the control process still gets the message
        sys.stderr.write(f"\nfriction-hil: {printable(problem)}\n")
        sys.stderr.flush()
    say(problem=problem)


def segment_path(path: Path, number: int) -> Path:
    """Return the file of the ``number``-th worker: ``path`` for the first, ``run-2.mcap`` beside it for the second."""
    while number > 1:
        candidate = path.with_stem(f"{path.stem}-{number}")
        if not candidate.exists():
            return candidate
        number += 1
    return path
