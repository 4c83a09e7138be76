"""State of one try, as faults see it: its wire, its processes, its random numbers."""

import random
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol, TypeVar

from tools.campaigns.can_wire import CanWire
from tools.campaigns.machine import Machine
from tools.campaigns.processes import ROLES, Process, descendants
from tools.campaigns.serial_wire import SerialWire

Choice = TypeVar("Choice")
PHASES = ("enabling", "running", "stopping")


class Running(Protocol):
    """What is used of `subprocess.Popen`."""

    pid: int
    stdin: Any
    stdout: Any

    def poll(self) -> int | None:
        """Return the exit status, None while it runs."""

    def wait(self, timeout: float | None = None) -> int:
        """Wait for the exit status."""

    def send_signal(self, sig: int, /) -> None:
        """Send a signal."""

    def kill(self) -> None:
        """Send SIGKILL."""


@dataclass
class Attempt:
    """One try.

    Attributes
    ----------
    folder : Path
    random : random.Random
        Of this try alone.
    number : int
        Number of the try, from 0.
    phase : {"enabling", "running", "stopping"}
    at_s, stop_s : float
        Moment of the fault and of the request to stop, from the daemon's first SYNC or command.
    """

    folder: Path
    random: random.Random
    number: int
    phase: str
    at_s: float
    stop_s: float
    machine: Machine = field(init=False)
    wire: CanWire | SerialWire = field(init=False)
    daemon: Running = field(init=False)
    drives: Running = field(init=False)
    environment: dict[str, str] = field(default_factory=dict)
    told: list[str] = field(default_factory=list)
    known: dict[int, Process] = field(default_factory=dict)  # children of the daemon that were seen
    kept: dict[str, Any] = field(default_factory=dict)  # of the fault, between begin and end
    _due: list[tuple[float, Callable[[], None]]] = field(default_factory=list)
    _last_s: float = -1.0

    def tell(self, text: str) -> None:
        """Note what the fault was exactly."""
        self.told.append(text)

    def chosen(self, among: Sequence[Choice]) -> Choice:
        """Return the same one of these at each call of this try."""
        choice = self.kept.setdefault("chosen", self.random.random())
        return among[int(choice * len(among))]

    def is_time(self, period_s: float) -> bool:
        """Return True once in each period."""
        now_s = time.monotonic()
        if now_s - self._last_s < period_s:
            return False
        self._last_s = now_s
        return True

    def later(self, delay_s: float, act: Callable[[], None]) -> None:
        """Call something after a delay."""
        self._due.append((time.monotonic() + delay_s, act))

    def act(self) -> float:
        """Do what is due; return the time until the next is, s."""
        now_s = time.monotonic()
        due = [entry for entry in self._due if entry[0] <= now_s]
        self._due = [entry for entry in self._due if entry[0] > now_s]
        for _, act in due:
            act()
        return min((at_s - now_s for at_s, _ in self._due), default=1.0)

    def look_for_children(self) -> None:
        """Note the processes that the daemon has started."""
        for process in descendants(self.daemon.pid):
            self.known[process.pid] = process

    def children(self, who: str) -> Iterator[Process]:
        """Yield the daemon's supervisor, worker (the companion) or server that live."""
        self.look_for_children()
        for process in self.known.values():
            if f"friction_hil.daemon.{ROLES[who]} " in process.words and process.is_alive:
                yield process
