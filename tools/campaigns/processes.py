"""Processes of a try: the daemon, what it starts, the drives; found and ended by their own numbers alone."""

import contextlib
import os
import signal
import time
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

ROLES = {"supervisor": "supervisor", "worker": "companion", "server": "control"}  # with the modules that they run
_LOOK_S = 0.01


@dataclass(frozen=True, slots=True)
class Process:
    """A process, told from a later one of the same number by the time of its start."""

    pid: int
    parent: int
    started: int  # clock ticks since boot
    words: str

    @property
    def is_alive(self) -> bool:
        """True until it has ended, a zombie counts as ended."""
        found = _read(self.pid)
        return found is not None and found.started == self.started

    def signal(self, number: int) -> None:
        """Send a signal, unless it has ended."""
        if self.is_alive:
            with contextlib.suppress(ProcessLookupError):
                os.kill(self.pid, number)


def _read(pid: int) -> Process | None:
    try:
        state, parent, *rest = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        words = Path(f"/proc/{pid}/cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace")
    except (OSError, ValueError):
        return None
    return None if state in "ZX" else Process(pid, int(parent), int(rest[17]), words)


def descendants(pid: int) -> list[Process]:
    """Return the processes that a process has started, and theirs, parents first."""
    of_parent: dict[int, list[Process]] = {}
    for entry in os.listdir("/proc"):
        if entry.isdigit() and (process := _read(int(entry))) is not None:
            of_parent.setdefault(process.parent, []).append(process)
    found: list[Process] = []
    left = [pid]
    while left:
        children = of_parent.get(left.pop(0), [])
        found += children
        left += [child.pid for child in children]
    return found


def wait_for_end(processes: Iterable[Process], timeout_s: float) -> list[Process]:
    """Wait until all have ended; return those that have not."""
    end_s = time.monotonic() + timeout_s
    left = list(processes)
    while (left := [each for each in left if each.is_alive]) and time.monotonic() < end_s:
        time.sleep(_LOOK_S)
    return left


def end(processes: Iterable[Process]) -> None:
    """End processes that are left over, stopped ones too."""
    for process in processes:
        process.signal(signal.SIGKILL)
