"""Request to a run to come to rest."""

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

from friction_hil.interrupts import Interrupted, interrupt

# Windows lacks the last one: a study of a machine imports this module there.
SIGNALS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))


class StopRequest:
    """Request to stop, set from a signal handler and read by the loop."""

    __slots__ = ("_is_raised", "_signal", "is_by_user", "is_requested")

    def __init__(self) -> None:
        self.is_requested = False  # by the user, or by the loop itself when its duration is over
        self.is_by_user = False
        self._is_raised = False
        self._signal: int | None = None

    @contextmanager
    def raised(self) -> Iterator[None]:
        """Let signals raise `Interrupted` in this context: nothing moves yet, so that nothing has to come to rest.

        One that came before is raised at the beginning. What follows the context restores drives, and is not
        interrupted.
        """
        if self._signal is not None:
            raise Interrupted(self._signal)
        self._is_raised = True
        try:
            yield
        finally:
            self._is_raised = False

    def take(self, number: int, frame: FrameType | None) -> None:
        """Take a signal; the signature is that of a signal handler."""
        self.is_requested = self.is_by_user = True
        if self._is_raised:
            interrupt(number, frame)
        else:
            self._signal = number


@contextmanager
def stop_on_signals() -> Iterator[StopRequest]:
    """Turn Ctrl-C and the signals that end a process into a request to stop; main thread only."""
    stop = StopRequest()
    before = {number: signal.signal(number, stop.take) for number in SIGNALS}
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
