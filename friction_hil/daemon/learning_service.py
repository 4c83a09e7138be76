"""The process that learns, as the control process sees it: tended, waited for in simulated time, asked at the end."""

import json
import mmap
import os
import struct
import time
from collections.abc import Callable
from typing import Any

from friction_hil.daemon.spawner.client import Spawn
from friction_hil.daemon.tended_process import TendedProcess

TICK_S = 0.25  # of rows, after which learning decides
_BYTES = 1 << 16
_HEAD = struct.Struct("<qq")  # cycle up to which all rows are dealt with, length of the report
_PATIENCE_S = 120.0  # the process imports and compiles at first
_LOOK_S = 5e-4
_STDERR = 2


class LearningBoard:
    """Shared memory in which the learning process says how far it is, and what has happened.

    Parameters
    ----------
    descriptor : int
        Of an existing board; -1 makes one.
    """

    def __init__(self, descriptor: int = -1) -> None:
        if descriptor < 0:
            descriptor = os.memfd_create("friction_hil-learning")
            os.ftruncate(descriptor, _BYTES)
            os.pwrite(descriptor, _HEAD.pack(-1, 0), 0)
        self.descriptor = descriptor
        self._memory = mmap.mmap(descriptor, _BYTES)

    @property
    def done_cycle(self) -> int:
        """Cycle up to which all rows are dealt with; -1 before the first."""
        return int(_HEAD.unpack_from(self._memory)[0])

    def say(self, cycle: int, report: dict[str, Any]) -> None:
        """Write what has happened up to a cycle."""
        text = json.dumps(report).encode()
        if len(text) > _BYTES - _HEAD.size:
            text = b"{}"
        self._memory[_HEAD.size : _HEAD.size + len(text)] = text
        _HEAD.pack_into(self._memory, 0, cycle, len(text))

    def report(self) -> dict[str, Any]:
        """Return what has happened; empty before the first rows."""
        length = _HEAD.unpack_from(self._memory)[1]
        try:
            found: dict[str, Any] = json.loads(self._memory[_HEAD.size : _HEAD.size + length] or b"{}")
        except ValueError:  # a process that was killed while it wrote
            return {}
        return found

    def close(self) -> None:
        """Give the memory back."""
        self._memory.close()
        os.close(self.descriptor)


class LearningService(TendedProcess):
    """The process that learns; nothing depends on it.

    Parameters
    ----------
    spawn : Spawn
    socket : str
        Path of the control socket, through which it attaches and hands over.
    period_s : float
    is_simulated : bool
        The loop waits for it at each tick, so that the same run gives the same hand-overs.
    """

    def __init__(self, spawn: Spawn, socket: str, period_s: float, *, is_simulated: bool) -> None:
        self._board = LearningBoard()
        self._every = round(TICK_S / period_s)
        self._is_simulated, self._is_awaited = is_simulated, is_simulated
        words = [socket, str(self._board.descriptor), "simulated" if is_simulated else "real"]
        super().__init__(
            spawn,
            "friction_hil.learning.process",
            words,
            title="the process that learns",
            loss="nothing is learned any more",
            descriptors=(self._board.descriptor,),
            stdout=_STDERR,
            severity="notice",
        )

    def await_tick(self, cycle: int, has_news: Callable[[], bool], tend: Callable[[], None]) -> None:
        """Wait in simulated time until the rows up to the end of a tick are dealt with, or a change is handed over."""
        if not self._is_awaited or (cycle + 1) % self._every:
            return
        end_s = time.monotonic() + _PATIENCE_S
        while self._board.done_cycle < cycle and not has_news():
            if self.is_given_up or time.monotonic() > end_s:
                self._is_awaited = False
                return
            time.sleep(_LOOK_S)
            tend()

    def report(self) -> dict[str, Any]:
        """Return what was learned, by axis."""
        return self._board.report()

    def close(self) -> None:
        """End the process."""
        super().close()
        self._board.close()
