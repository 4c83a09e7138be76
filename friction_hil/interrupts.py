"""Signals that end a command at once.

A signal handler of Python runs wherever the main thread happens to be. In a callback from C (LLVM hands over each
compiled function in one) and in a finaliser, an exception is printed and then lost; there it is raised a little later.
"""

import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

_LATER_S = 0.01
_LOSING = frozenset({"__del__", "_raw_object_cache_notify", "_raw_object_cache_getbuffer"})  # the latter of llvmlite
_SHELL_OFFSET = 128


class Interrupted(KeyboardInterrupt):
    """A signal ends the command."""

    def __init__(self, number: int = signal.SIGINT) -> None:
        super().__init__(signal.Signals(number).name)
        self.number = number
        self.exit_status = _SHELL_OFFSET + number  # as a shell reports it: 130 after Ctrl-C, 143 after SIGTERM


def interrupt(number: int, frame: FrameType | None) -> None:
    """Raise `Interrupted`, at once or a little later; this is a signal handler."""
    while frame is not None:
        if frame.f_code.co_name in _LOSING:
            _deliver_later(number)
            return
        frame = frame.f_back
    raise Interrupted(number)


@contextmanager
def interruptible(*, is_last: bool = False) -> Iterator[None]:
    """Let Ctrl-C raise `Interrupted`, and deliver again what was raised where it is lost; main thread only.

    After the last work of a process Ctrl-C is ignored: the result is there, and what the interpreter does at its end
    would only print a traceback.
    """
    handler, hook = signal.getsignal(signal.SIGINT), sys.unraisablehook
    if handler is signal.default_int_handler:
        signal.signal(signal.SIGINT, interrupt)
    sys.unraisablehook = _redelivering(hook)
    try:
        yield
    finally:
        sys.unraisablehook = hook
        if handler is signal.default_int_handler:
            signal.signal(signal.SIGINT, signal.SIG_IGN if is_last else handler)


def _redelivering(hook: Callable[[Any], Any]) -> Callable[[Any], Any]:
    def take(lost: Any) -> None:
        if isinstance(lost.exc_value, Interrupted):
            _deliver_later(lost.exc_value.number)
        else:
            hook(lost)

    return take


def _deliver_later(number: int) -> None:
    # imported here: --help must not wait for it
    import _thread
    import threading

    timer = threading.Timer(_LATER_S, _thread.interrupt_main, (number,))
    timer.daemon = True
    timer.start()
