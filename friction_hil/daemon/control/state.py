"""State of a daemon as the control socket reports it: read from the ring, without any work of the loop."""

import math
import re
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from friction_hil.daemon.ring import RingObserver
from friction_hil.daemon.safety import LoopState
from friction_hil.drive import DriveState, FaultCode
from friction_hil.drive.codes import code_of
from friction_hil.recordings import columns

if TYPE_CHECKING:
    from friction_hil.recordings.recording import Array

_SHOWN = {
    "position": "position",
    "velocity": "velocity",
    "torque": "torque",
    "compensation": "compensation",
    "command": "command",
    "temperature": "temperature_estimate",
}
_MOST_EVENTS = 20
STANDS_S = 1.0  # without a row: the loop stands
_LOOK_S = 1e-3
ERROR_WITHOUT = "error_without"  # event: a time without compensation has ended, with this following error
_ERROR_WITHOUT = re.compile(r"(\S+): RMS (\S+), peak (\S+) (?:rad|m) in (\S+) s")


def error_without(axis: str, unit: str, rms: float, peak: float, seconds: float) -> str:
    """Return the text of the event `ERROR_WITHOUT`, which `Messages` reads."""
    return f"{axis}: RMS {rms:.9g}, peak {peak:.9g} {unit} in {seconds:.6g} s"


@dataclass(slots=True)
class Messages:
    """What a run has said so far; of warnings and notices the last ones."""

    faults: list[str] = field(default_factory=list)  # that nobody has reset
    warnings: list[str] = field(default_factory=list)
    notices: list[str] = field(default_factory=list)
    # by axis, of the last time without compensation that has ended: ``rms``, ``peak`` of the following error, rad or m,
    # and ``seconds`` of steady motion
    error_without: dict[str, dict[str, float]] = field(default_factory=dict)

    def take(self, name: str, text: str) -> None:
        """Take an event of the ring; those of other names are left out."""
        if name == "fault" and text not in self.faults:
            self.faults.append(text)
        elif name == "reset":
            self.faults.clear()
        elif name == ERROR_WITHOUT and (found := _ERROR_WITHOUT.fullmatch(text)):
            figures = zip(("rms", "peak", "seconds"), map(float, found.groups()[1:]), strict=True)
            self.error_without[found[1]] = dict(figures)
        elif name in ("warning", "notice"):
            kept = self.warnings if name == "warning" else self.notices
            kept.append(text)
            del kept[:-_MOST_EVENTS]

    def has_taken_back(self, axis: str) -> bool:
        """Return True if the run has said that it took the compensation of an axis back."""
        code = str(FaultCode.TAKEN_BACK)
        return any(text.startswith(f"{axis}: ") and code_of(text) == code for text in self.warnings)


class DaemonState:
    """Latest rows and events of a daemon; ``state_width``: values of compensator state behind an axis's columns."""

    def __init__(self, ring_descriptor: int, names: Sequence[str], columns: Sequence[str], state_width: int) -> None:
        self._ring = RingObserver(ring_descriptor)
        self._names, self._columns, self._width = names, list(columns), len(columns) + state_width
        self.messages = Messages()
        # the loop wrote no row while `await_row` waited for one: what it read last says nothing about the drives now
        self.stands = False

    def await_row(self) -> None:
        """Wait until the loop has written another row, a second at most."""
        before, end_s = self._ring.rows_written, time.monotonic() + STANDS_S
        while not (is_new := self._ring.rows_written != before) and not self.has_ended and time.monotonic() < end_s:
            time.sleep(_LOOK_S)
        self.stands = not (is_new or self.has_ended)

    @property
    def has_ended(self) -> bool:
        """True once the loop has written its last row."""
        return self._ring.is_closed

    def rows(self, most: int) -> "Array":
        """Return up to ``most`` of the latest rows, oldest first, shape (n, width)."""
        return self._ring.newest(most)

    def look(self) -> None:
        """Take the events since the last look."""
        for _, name, text in self._ring.new_events():
            self.messages.take(name, text)

    def loop_state(self) -> LoopState | None:
        """Return the state of the run; None if it is not known."""
        rows = self.rows(1)
        value = self._value(rows[-1], 0, "state") if len(rows) else math.nan
        return LoopState(int(value)) if math.isfinite(value) else None

    def last_change(self) -> int:
        """Return the number of the last change of settings that the loop has applied."""
        rows = self.rows(1)
        value = self._value(rows[-1], 0, columns.CHANGE) if len(rows) else math.nan
        return int(value) if math.isfinite(value) else 0

    def drive_states(self) -> dict[str, DriveState]:
        """Return the state of each drive as it was read back in the latest cycle; unknown if nothing was."""
        rows = self.rows(1)
        return {name: self._drive_state(rows[-1], k) if len(rows) else DriveState.UNKNOWN for k, name in self._axes()}

    def loop(self) -> dict[str, Any]:
        """Return what is known of the run."""
        rows, state = self.rows(1), self.loop_state()
        has_row = len(rows) > 0
        return {
            "state": "ended" if self.has_ended else "unknown" if state is None or self.stands else state.name.lower(),
            "time_s": self._value(rows[-1], 0, "time_s") if has_row else None,
            "cycle": int(self._value(rows[-1], 0, "cycle")) if has_row else None,
            "changes": self.last_change(),
        }

    def axis(self, name: str) -> dict[str, Any]:
        """Return the values of an axis; None for what is not known."""
        rows, axis = self.rows(1), list(self._names).index(name)
        if not len(rows) or self.has_ended or self.stands:
            return {"drive_state": DriveState.UNKNOWN.words} | dict.fromkeys([*_SHOWN, "following_error"])
        row = rows[-1]
        error = self._value(row, axis, "position_demand") - self._value(row, axis, "position")
        values = {key: _known(self._value(row, axis, column)) for key, column in _SHOWN.items()}
        return {
            "drive_state": self._drive_state(row, axis).words,
            **values,
            "following_error": _known(error),
        }

    def is_taken_back(self, axis: str) -> bool:
        """Return True if the compensation of an axis was taken back, and nobody has switched it on again since then."""
        rows = self.rows(1)
        is_off = not len(rows) or self._value(rows[-1], list(self._names).index(axis), "is_enabled") != 1.0
        return is_off and self.messages.has_taken_back(axis)

    def _axes(self) -> Sequence[tuple[int, str]]:
        return list(enumerate(self._names))

    def _drive_state(self, row: "Array", axis: int) -> DriveState:
        state = self._value(row, axis, "drive_state")
        is_read = self._value(row, axis, "is_fresh") == 1.0
        is_known = is_read and math.isfinite(state) and not (self.has_ended or self.stands)
        return DriveState(int(state)) if is_known else DriveState.UNKNOWN

    def _value(self, row: "Array", axis: int, column: str) -> float:
        return float(row[axis * self._width + self._columns.index(column)])


def _known(value: float) -> float | None:
    return value if math.isfinite(value) else None
