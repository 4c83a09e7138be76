"""Shared memory in which the process that learns says how far it is, and what has happened."""

import json
import mmap
import os
import struct
from typing import Any

STARTING = "its process starts, and for the first time on a machine it compiles its code"
_BYTES = 1 << 16
_HEAD = struct.Struct("<qqq")  # number of the writing, odd while it is written; done cycle; length of the report
_TRIES = 100  # of a reader, who meets a writer once in a thousand times


class LearningBoard:
    """The memory, for the process that learns and for the control process; a descriptor of -1 makes a new board."""

    def __init__(self, descriptor: int = -1) -> None:
        if descriptor < 0:
            descriptor = os.memfd_create("friction_hil-learning")
            os.fchmod(descriptor, 0o400)  # whoever gets a descriptor for reading cannot open it again for writing
            os.ftruncate(descriptor, _BYTES)
            os.pwrite(descriptor, _HEAD.pack(0, -1, 0), 0)
        self.descriptor = descriptor
        self._memory = mmap.mmap(descriptor, _BYTES)

    @property
    def done_cycle(self) -> int:
        """Cycle up to which all rows are dealt with; -1 before the first."""
        return read_done_cycle(self.descriptor)

    def say(self, cycle: int, report: dict[str, Any]) -> None:
        """Write what has happened up to a cycle."""
        text = json.dumps(report).encode()
        if len(text) > _BYTES - _HEAD.size:
            text = b"{}"
        number, done, length = _HEAD.unpack_from(self._memory)
        number |= 1  # it is odd already after a process that died while it wrote
        _HEAD.pack_into(self._memory, 0, number, done, length)
        self._memory[_HEAD.size : _HEAD.size + len(text)] = text
        _HEAD.pack_into(self._memory, 0, number + 1, cycle, len(text))

    def end(self, reason: str) -> None:
        """Say that nothing is learned any more, for a process that cannot."""
        report = self.report()
        for axis in report.get("axes", {}).values():
            axis |= {"doing": "ended", "reason": reason}
        self.say(self.done_cycle, report)

    def report(self) -> dict[str, Any]:
        """Return what has happened; empty before the first rows."""
        return read_report(self.descriptor)

    def close(self) -> None:
        """Give the memory back."""
        self._memory.close()
        os.close(self.descriptor)


def read_done_cycle(descriptor: int) -> int:
    """Return the cycle up to which all rows are dealt with; -1 before the first."""
    return int(_HEAD.unpack(os.pread(descriptor, _HEAD.size, 0))[1])


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


def read_report(descriptor: int) -> dict[str, Any]:
    """Return what the process that learns has said last; empty if there is nothing, or half of it."""
    for _ in range(_TRIES):
        head = os.pread(descriptor, _HEAD.size, 0)
        number, _, length = _HEAD.unpack(head)
        text = os.pread(descriptor, length, _HEAD.size)
        if number % 2 == 0 and os.pread(descriptor, _HEAD.size, 0) == head:
            found: dict[str, Any] = json.loads(text or b"{}")
            return found
    return {}  # the process died while it wrote
