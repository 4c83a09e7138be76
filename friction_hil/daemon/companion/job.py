"""Messages between the control process and those beside it."""

import contextlib
import json
import os
import signal
import sys
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from friction_hil.printable import printable

if TYPE_CHECKING:
    from friction_hil.recordings.columns import AxisKind

_OUTPUT = 1


@dataclass(frozen=True, slots=True)
class Job:
    """Job of the companion.

    A row of the ring holds, for each axis in turn, its ``columns`` and then ``state_width`` values of state. With
    ``ring_columns``, see `friction_hil.daemon.companion.own_rows`.
    """

    axes: list[str]
    columns: list[str]  # of every axis, from `friction_hil.recordings.columns`
    state_width: int  # values of compensator state an axis, before the step of the cycle
    period_s: float  # of the loop, s
    started_unix_ns: int  # wall-clock time of ``time_s`` = 0, ns since 1970
    path: str | None = None  # file of the recording, ``.mcap``; none when absent
    overwrite: bool = False  # replace an existing file; otherwise it is an error
    # values that JSON can hold, by name; written to the file before the first row
    metadata: dict[str, Any] = field(default_factory=dict)
    status_line: bool = False  # print a live line to standard error
    status_title: str = ""  # what moves and for how long, for that line
    # of each axis, for the units of the status line; all rotary when empty
    kinds: "list[AxisKind]" = field(default_factory=list)
    rotate_s: float | None = None  # duration of a file, s, after which the recording goes on in the next one
    rotate_bytes: int | None = None  # the same by its size
    budget_bytes: int | None = None  # disk space of all recordings of this series
    # the daemon and the path wanted, in every file: what has another one belongs to another daemon
    series: str | None = None
    # where files of faults are written: ``run.mcap`` makes ``run-fault-20260131-142530.mcap``; none when absent
    black_box: str | None = None
    has_joint_states: bool = False  # write each row also as a joint state of ROS 2
    # of axes whose model has known errors, the `friction_hil.daemon.uncertainty.uncertainty_table` of the start
    uncertainty: dict[str, dict[str, list[float]]] = field(default_factory=dict)
    # places in the state of the factors on the model's torque beside the gain
    factors: list[int] = field(default_factory=list)
    # of a loop of the user's own: what its rows hold of each axis, and how many rows share a state behind them
    ring_columns: list[str] = field(default_factory=list)
    rows_between_states: int = 0

    @property
    def row_width(self) -> int:
        """Number of values in a row of the ring."""
        return len(self.axes) * (len(self.ring_columns) or len(self.columns) + self.state_width)


def signal_text(number: int) -> str:
    """Return ``signal SIGKILL``; real-time signals have no names."""
    try:
        return f"signal {signal.Signals(number).name}"
    except ValueError:
        return f"signal {number}"


def say(**message: Any) -> None:
    """Send the control process a message.

    The companion says ``opened`` (path or None), of a first or further file, with ``pid``; ``removed`` and
    ``black_box`` (paths); ``failed``; ``problem``; ``done``; and ``progress``, while the end of the work takes long.
    The supervisor says its number (``supervisor``), ``text`` with its ``severity``, and ``over`` (title of a process
    that is not started any more).
    """
    # the control process may be gone: the recording still has to be finished
    with contextlib.suppress(BrokenPipeError):
        os.write(_OUTPUT, json.dumps(message).encode() + b"\n")


def warn(problem: str) -> None:
    """Report a problem to the user now, and to the control process when it reads."""
    with contextlib.suppress(OSError):  # the terminal may be gone; the control process still gets the message
        sys.stderr.write(f"\nfriction-hil: {printable(problem)}\n")
        sys.stderr.flush()
    say(problem=problem)
