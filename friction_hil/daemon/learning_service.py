"""The process that learns, as the loop sees it: waited for in simulated time, and told when it is given up."""

import time
from collections.abc import Callable

from friction_hil.daemon.learning_board import LearningBoard
from friction_hil.daemon.processes import LEARNING

TICK_S = 0.25  # of rows, after which learning decides
_PATIENCE_S = 120.0  # the process imports and compiles at first
_LOOK_S = 5e-4


class LearningService:
    """The process that learns; nothing depends on it.

    Whoever made the board, where it says what has happened, closes it after this. With ``is_simulated`` the loop waits
    for it at each tick, so that the same run gives the same hand-overs.
    """

    def __init__(self, board: LearningBoard, period_s: float, *, is_simulated: bool) -> None:
        self._board = board
        self._every = round(TICK_S / period_s)
        self._is_awaited = is_simulated
        self._is_given_up = False

    def give_up(self) -> None:
        """Note that the process is not started any more."""
        if not self._is_given_up:
            self._is_given_up = True
            self._board.end("its process died")

    def await_tick(self, cycle: int, has_news: Callable[[], bool], look: Callable[[], None]) -> str:
        """Wait in simulated time until the rows up to the end of a tick are dealt with, or a change is handed over.

        Returns what is to be reported, if anything.
        """
        if not self._is_awaited or (cycle + 1) % self._every:
            return ""
        end_s = time.monotonic() + _PATIENCE_S
        while self._board.done_cycle < cycle and not has_news():
            if self._is_given_up or time.monotonic() > end_s:
                self._is_awaited = False
                is_late = not self._is_given_up
                return f"{LEARNING} has done nothing for {_PATIENCE_S:g} s: the run goes on without it" * is_late
            time.sleep(_LOOK_S)
            look()
        return ""
