"""Shared memory in which the process that learns says how far it is, and what has happened."""

import os
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


def first_report(mode: str, unit: str, gain: float) -> dict[str, Any]:
    """Return the report on an axis before its process has said anything; all reports have these keys.

    ``mode``: on or propose; ``unit``: rad or m; ``gain``: of the configuration.
    """
    return {
        "mode": mode,
        "unit": unit,
        "doing": "waiting",
        "reason": STARTING,
        "last": "",
        "re_identified": 0,
        "taken_back": 0,
        "stopped": 0,
        "gain": gain,
        "error_before": None,
        "error_after": None,
        "in_use": {},
        "parameters": None,
        "relative_errors": None,
        "proposed": None,
        "residual_layer": {
            "state": "",
            "explained": 0.0,
            "tried": 0,
            "error_before": None,
            "error_after": None,
            "text": "",
        },
        "family": {
            "of_file": "",
            "in_use": "",
            "state": "",
            "tried": 0,
            "text": "",
            "explained": {},
            "error_before": None,
            "error_after": None,
        },
    }
