"""Faults and warnings of a run: kept in its result and written to the recording as events."""

import math
from dataclasses import dataclass, field
from typing import Protocol

from friction_hil.daemon.safety import LoopState
from friction_hil.drive.codes import FaultCode
from friction_hil.numerics.jit import Array

_MOST_FAULTS = 20


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
    """Result of a run. The lateness is that of the wake-ups, us."""

    cycles: int = 0
    missed: int = 0
    late_p50_us: float = math.nan
    late_p99_us: float = math.nan
    faults: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)


class RunLog:
    """Keep faults and warnings, and hand them to the sink.

    Attributes
    ----------
    result : LoopResult
    """

    def __init__(self, sink: Sink) -> None:
        self._sink = sink
        self.result = LoopResult()

    def fault(self, cycle: int, text: str) -> None:
        """Keep a fault; the same text counts once."""
        if text not in self.result.faults and len(self.result.faults) < _MOST_FAULTS:
            self.result.faults.append(text)
            self._sink.event(cycle, "fault", text)

    def missed(self, cycle: int, skipped: int, overslept_ns: int, max_missed: int) -> None:
        """Count the periods missed before ``cycle``; ``max_missed`` of them in a row are a fault."""
        self.result.missed += skipped
        if skipped >= max_missed:
            text = f"the loop was late by {overslept_ns / 1000:.0f} us ({skipped} periods)"
            self.fault(cycle - skipped, FaultCode.LOOP_LATE.append_to(text))

    def state(self, cycle: int, state: LoopState) -> None:
        """Record the state that the run enters."""
        self._sink.event(cycle, "state", state.name.lower())

    def warn(self, cycle: int, text: str) -> None:
        """Keep a warning."""
        self.result.warnings.append(text)
        self._sink.event(cycle, "warning", text)
