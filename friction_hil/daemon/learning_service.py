"""The process that learns, as the control process sees it: tended, waited for in simulated time, asked at the end."""

import time
from collections.abc import Callable
from typing import Any

from friction_hil.daemon.learning_board import LearningBoard
from friction_hil.daemon.spawner.client import Spawn
from friction_hil.daemon.tended_process import TendedProcess

TICK_S = 0.25  # of rows, after which learning decides
_PATIENCE_S = 120.0  # the process imports and compiles at first
_LOOK_S = 5e-4
_STDERR = 2
_TITLE = "the process that learns"


class LearningService(TendedProcess):
    """The process that learns; nothing depends on it.

    Whoever made the board, where it says what has happened, closes it after this. Through ``socket``, the path of the
    control socket, it attaches and hands over. With ``is_simulated`` the loop waits for it at each tick, so that the
    same run gives the same hand-overs.
    """

    def __init__(self, spawn: Spawn, board: LearningBoard, socket: str, period_s: float, *, is_simulated: bool) -> None:
        self._board = board
        self._every = round(TICK_S / period_s)
        self._is_awaited = is_simulated
        self._news: list[str] = []
        words = [socket, str(self._board.descriptor), "simulated" if is_simulated else "real"]
        super().__init__(
            spawn,
            "friction_hil.learning.process",
            words,
            title=_TITLE,
            loss="nothing is learned any more",
            descriptors=(self._board.descriptor,),
            stdout=_STDERR,
            severity="notice",
        )

    def tend(self) -> list[str]:
        """Start the process again if it has died; return what is to be reported. It never waits."""
        was_given_up = self.is_given_up
        problems = [*super().tend(), *self._news]
        self._news.clear()
        if self.is_given_up and not was_given_up:
            self._board.end("its process died")
        return problems

    def await_tick(self, cycle: int, has_news: Callable[[], bool], tend: Callable[[], None]) -> None:
        """Wait in simulated time until the rows up to the end of a tick are dealt with, or a change is handed over."""
        if not self._is_awaited or (cycle + 1) % self._every:
            return
        end_s = time.monotonic() + _PATIENCE_S
        while self._board.done_cycle < cycle and not has_news():
            if self.is_given_up or time.monotonic() > end_s:
                self._is_awaited = False
                if not self.is_given_up:
                    self._news.append(f"{_TITLE} has done nothing for {_PATIENCE_S:g} s: the run goes on without it")
                return
            time.sleep(_LOOK_S)
            tend()

    def report(self) -> dict[str, Any]:
        """Return what was learned, by axis."""
        return self._board.report()
