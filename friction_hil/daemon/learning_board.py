"""Shared memory in which the process that learns says how far it is, and what has happened."""

import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

from friction_hil.daemon.shared_document import cycle_of, make_document, read_document, write_document

STARTING = "its process starts, and for the first time on a machine it compiles its code"


class LearningBoard:
    """The memory, for the process that learns and for the control process; a descriptor of -1 makes a new board."""

    def __init__(self, descriptor: int = -1) -> None:
        self.descriptor = make_document("learning", {}) if descriptor < 0 else descriptor

    @property
    def done_cycle(self) -> int:
        """Cycle up to which all rows are dealt with; -1 before the first."""
        return cycle_of(self.descriptor)

    def say(self, cycle: int, report: dict[str, Any]) -> None:
        """Write what has happened up to a cycle."""
        write_document(self.descriptor, report, cycle)

    def end(self, reason: str) -> None:
        """Say that nothing is learned any more, for a process that cannot."""
        report = self.report()
        for axis in report.get("axes", {}).values():
            axis |= {"doing": "ended", "reason": reason}
        self.say(self.done_cycle, report)

    def report(self) -> dict[str, Any]:
        """Return what has happened; empty before the first rows."""
        return read_document(self.descriptor)

    def close(self) -> None:
        """Give the memory back."""
        os.close(self.descriptor)


@dataclass(slots=True)
class LayerFigures:
    """What has happened to the residual layer so far."""

    # empty as long as nothing was looked at, then "noise only", "on trial", "no gain", "without a verdict" (the motion
    # changed during the trial), "refused" (by the daemon or the user), "on", "no longer a gain": it was on; or "not
    # proven for this motion"
    state: str = ""
    # share of the mean square of what the model leaves of the torque that the layer explains, of rows that it was not
    # learned from, in the last window
    explained: float = 0.0
    tried: int = 0
    error_before: float | None = None  # root mean square of the following error without the layer in use or tried last
    error_after: float | None = None  # the same with it
    text: str = ""  # what the layer consists of; empty where there is none


@dataclass(slots=True)
class FamilyFigures:
    """What has happened to the family of the model so far."""

    of_file: str = ""  # family of the model file
    in_use: str = ""  # family of the model that the compensator has
    # empty as long as none was compared, then "none explains more", "on trial", "no gain", "without a verdict" (the
    # motion changed during the trial), "refused" (by the daemon or the user) or "kept"
    state: str = ""
    tried: int = 0
    text: str = ""  # family that was tried last
    # by family, the share of the mean square of the torque that the present one leaves which it explains in addition,
    # of windows before it has learned from them, on the average of the last ones
    explained: dict[str, float] = field(default_factory=dict)
    error_before: float | None = None  # root mean square of the following error without the family tried last
    error_after: float | None = None  # the same with it


@dataclass(slots=True)
class Report:
    """What has happened to the learning of an axis so far, as `run --json` has it."""

    mode: str = ""  # on or propose
    unit: str = ""  # of errors: rad or m
    doing: str = "waiting"
    reason: str = STARTING
    last: str = ""  # notice
    re_identified: int = 0  # hand-overs of parameters that were kept
    taken_back: int = 0  # changes that were taken back
    stopped: int = 0  # times that learning stopped because the axis was not what it was
    gain: float = 1.0  # in force
    error_before: float | None = None  # root mean square of the following error with the model file
    error_after: float | None = None  # the same with what was kept last, of the same work
    in_use: Mapping[str, float] = field(default_factory=dict)  # parameters that the compensator has
    parameters: Mapping[str, float] | None = None  # their estimates
    relative_errors: Mapping[str, float] | None = None  # standard errors of these
    proposed: Mapping[str, Any] | None = None  # last proposal of an axis that only proposes
    residual_layer: LayerFigures = field(default_factory=LayerFigures)
    family: FamilyFigures = field(default_factory=FamilyFigures)


def first_report(mode: str, unit: str, gain: float) -> dict[str, Any]:
    """Return the report on an axis before its process has said anything; ``gain``: of the configuration."""
    return asdict(Report(mode, unit, gain=gain))
