"""Faults and warnings of a run: kept in its result and written to the recording as events."""

import math
from dataclasses import dataclass, field
from typing import Protocol

from friction_hil.daemon.control.state import ERROR_WITHOUT
from friction_hil.daemon.failure import calls_of, fault_of
from friction_hil.daemon.safety import LoopState
from friction_hil.drive import DriveState
from friction_hil.drive.codes import FaultCode
from friction_hil.numerics.jit import Array

_MOST_FAULTS = 20
_MOST_NOTICES = 100  # of drives, and as many of requests; warnings likewise
_BURST, _PER_S = 100.0, 8.0  # notices of drives: with more, a fault could be lost among the events of the ring
_KEPT_EVENTS = 150  # fewer than the ring holds: after so many, what whoever looks later needs is told again
_NAMED_S = 1.0  # after missed periods, in which a fault names them: it may be their consequence


class Sink(Protocol):
    """Receiver of rows and events; neither call may block a real-time loop."""

    def push(self, row: Array) -> None:
        """Take the rows of all axes of one cycle; ``row`` is reused."""
        ...

    def event(self, cycle: int, name: str, text: str) -> None:
        """Take an event of a cycle."""
        ...


@dataclass(slots=True)
class LoopResult:
    """Result of a run."""

    cycles: int = 0
    missed: int = 0
    late_p50_us: float = math.nan  # lateness of the wake-ups, us
    late_p99_us: float = math.nan
    faults: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    # what the drives said beside their feedback, e.g. emergencies, and what was asked for: the first of each kind
    notices: list[str] = field(default_factory=list)
    drive_states: list[DriveState] = field(default_factory=list)  # of each drive after the stop; empty after a dry run
    leftovers: list[str] = field(default_factory=list)  # what the driver could not leave as it was found


class RunLog:
    """Keep faults and warnings, and hand them to the sink."""

    def __init__(self, sink: Sink, period_s: float) -> None:
        self._sink = sink
        self._period_s = period_s
        self._said: set[str] = set()  # faults, as they came
        self._listed: set[str] = set()  # what drives said, in the result
        self._acts = 0  # in the result
        self._room, self._room_cycle = _BURST, 0  # for notices of drives
        self._is_flooded = False
        self.has_fault = False  # there is a fault that nobody has reset
        self._missed = 0  # periods
        self._missed_cycle = -1  # that followed them
        self._error_without: dict[str, str] = {}
        self._events = 0  # since all of these were told
        self.result = LoopResult()

    def event(self, cycle: int, name: str, text: str) -> None:
        """Record an event; now and then, the errors without compensation again."""
        self._sink.event(cycle, name, text)
        self._events += 1
        if self._events == _KEPT_EVENTS:
            self._events = 0
            for each in self._error_without.values():
                self._sink.event(cycle, ERROR_WITHOUT, each)

    def fault(self, cycle: int, text: str, gaps: str = "") -> None:
        """Keep a fault, with what was missing shortly before: periods, and feedback (``gaps``).

        The same text counts once. Of many, the first ones are kept, and after a reset the first ones again.
        """
        self.has_fault = True
        if len(self._said) < _MOST_FAULTS:
            self._keep_fault(cycle, text, gaps)

    def _keep_fault(self, cycle: int, text: str, gaps: str = "") -> None:
        if text not in self._said:
            self._said.add(text)
            self.has_fault = True
            if len(self._said) == 1:
                text = _ahead_of_code(text, self._missed_before(cycle) + gaps)
            self.result.faults.append(text)
            self.event(cycle, "fault", text)

    def _missed_before(self, cycle: int) -> str:
        """Return words on the periods that were missed shortly before a cycle; none: empty."""
        ago_s = (cycle - self._missed_cycle) * self._period_s
        if not self._missed or ago_s < 0.0 or ago_s > _NAMED_S:
            return ""
        periods = "1 period was" if self._missed == 1 else f"{self._missed} periods were"
        when = "right" if ago_s == 0.0 else f"{1e3 * ago_s:.3g} ms"
        return f"; {periods} missed {when} before"

    def failure(self, cycle: int, error: Exception) -> None:
        """Keep an exception that has ended the loop as a fault; the recording gets the calls that led to it too."""
        self.fault(cycle, fault_of(error))
        for call in calls_of(error):
            self.event(cycle, "traceback", call)

    def reset(self, cycle: int) -> None:
        """Forget that there is a fault; it stays in the result. If it comes again, it counts again."""
        if self.has_fault:
            self.event(cycle, "reset", "the fault is reset")
        self.has_fault = False
        self._said.clear()

    def act(self, cycle: int, text: str) -> None:
        """Keep what somebody asked for while the daemon runs; unlike `notice` each time."""
        self.event(cycle, "notice", text)
        self._acts += 1
        if self._acts <= _MOST_NOTICES:
            self.result.notices.append(text)

    def notice(self, cycle: int, text: str) -> None:
        """Keep what a drive said; it counts each time, but for a drive that talks without end."""
        if text not in self._listed and len(self._listed) < _MOST_NOTICES:
            self._listed.add(text)
            self.result.notices.append(text)
        passed_s = (cycle - self._room_cycle) * self._period_s
        self._room, self._room_cycle = min(self._room + _PER_S * max(passed_s, 0.0), _BURST), cycle
        if self._room < 1.0:
            return
        self._is_flooded = self._is_flooded and self._room < 0.5 * _BURST
        self._room -= 1.0
        self.event(cycle, "notice", text)
        if self._room < 1.0 and not self._is_flooded:
            self._is_flooded = True
            more = f"the drives said {_BURST:g} things in a row: of the next ones, {_PER_S:g} a second are recorded"
            self.event(cycle, "notice", more)

    def drive_state(self, cycle: int, name: str, state: DriveState, *, is_read_back: bool) -> None:
        """Keep the state of a drive after the stop; one that may have power is a fault, however many there were before.

        Where the driver reads nothing back, a run that failed already gets a warning: its fault says what happened.
        """
        self.result.drive_states.append(state)
        self.event(cycle, "drive_state", f"{name}: {state.words}")
        if state is DriveState.UNKNOWN:
            text = f"{name}: the state of the drive after the stop is unknown: it may have power"
            tell = self._keep_fault if is_read_back or not self.result.faults else self.warn
            tell(cycle, FaultCode.STATE_UNKNOWN.append_to(text))
        elif state.is_powered and not any(fault.startswith(f"{name}: still powered") for fault in self.result.faults):
            text = f"{name}: still powered after the stop: the drive is in {state.words}"
            self._keep_fault(cycle, FaultCode.STILL_POWERED.append_to(text))

    def leftover(self, cycle: int, text: str) -> None:
        """Keep what the driver could not leave as it was found."""
        self.result.leftovers.append(text)
        self.event(cycle, "warning", text)

    def missed(self, cycle: int, skipped: int, overslept_ns: int, max_missed: int) -> None:
        """Count the periods missed before ``cycle``; ``max_missed`` of them in a row are a fault."""
        self.result.missed += skipped
        self._missed, self._missed_cycle = skipped, cycle
        if skipped >= max_missed:
            text = f"the loop was late by {overslept_ns / 1000:.0f} µs ({skipped} periods)"
            self.fault(cycle - skipped, FaultCode.LOOP_LATE.append_to(text))

    def state(self, cycle: int, state: LoopState) -> None:
        """Record the state that the run enters."""
        self.event(cycle, "state", state.name.lower())

    def error_without(self, cycle: int, axis: str, text: str) -> None:
        """Record the following error of a time without compensation that has ended, for those who look later too."""
        self._error_without[axis] = text
        self.event(cycle, ERROR_WITHOUT, text)

    def warn(self, cycle: int, text: str) -> None:
        """Keep a warning."""
        if len(self.result.warnings) < _MOST_NOTICES:
            self.result.warnings.append(text)
        self.event(cycle, "warning", text)


def _ahead_of_code(text: str, more: str) -> str:
    """Return the text of a fault with more words ahead of its code."""
    words, bracket, code = text.rpartition(" [FH-")
    return f"{words}{more}{bracket}{code}" if bracket else text + more
