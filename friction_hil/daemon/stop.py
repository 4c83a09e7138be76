"""Request to a run to come to rest."""

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class StopRequest:
    """Request to stop, set from a signal handler and read by the loop.

    Attributes
    ----------
    is_requested : bool
        By the user, or by the loop itself when its duration is over.
    is_by_user : bool
    """

    __slots__ = ("is_by_user", "is_requested")

    def __init__(self) -> None:
        self.is_requested = False
        self.is_by_user = False


@contextmanager
def stop_on_signals() -> Iterator[StopRequest]:
    """Turn Ctrl-C and the signals that end a process into a request to stop; main thread only."""
    stop = StopRequest()

    def on_signal(number: int, frame: FrameType | None) -> None:
        stop.is_requested = stop.is_by_user = True

    before = {number: signal.signal(number, on_signal) for number in SIGNALS}
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
