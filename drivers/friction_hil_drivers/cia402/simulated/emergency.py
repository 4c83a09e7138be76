"""Errors of a simulated node: error register, history, error code and emergency messages (CiA 301)."""

import struct
from collections.abc import Callable

from friction_hil_drivers.cia402 import objects
from friction_hil_drivers.cia402.access import Abort, AbortError
from friction_hil_drivers.cia402.simulated.dictionary import Dictionary

_FRAME = struct.Struct("<HB5x")
_HISTORY_LENGTH = 8
_GENERIC, _COMMUNICATION, _PROFILE = 0x01, 0x10, 0x20  # bits of the error register


def _register_bit(code: int) -> int:
    if 0x8100 <= code <= 0x82FF:
        return _COMMUNICATION
    if 0x8300 <= code <= 0x8FFF:
        return _PROFILE
    return 0


class Emergencies:
    """Errors that are present, and the emergency messages that report them.

    ``dictionary``: its entries 1001h, 1003h and 603Fh mirror the errors. ``send``: called with the eight bytes of each
    emergency message.
    """

    def __init__(self, dictionary: Dictionary, send: Callable[[bytes], None]) -> None:
        self._send = send
        self._present: list[int] = []  # oldest first
        self._history: list[int] = []  # newest first
        dictionary.of(objects.ERROR_REGISTER).connect(lambda: self.register, objects.ERROR_REGISTER)
        dictionary.of(objects.ERROR_CODE).connect(lambda: self._present[-1] if self._present else 0, objects.ERROR_CODE)
        count = dictionary.of(objects.ERROR_HISTORY_COUNT)
        count.on_read = lambda: len(self._history)
        count.on_write = self._clear_history
        for age in range(_HISTORY_LENGTH):
            dictionary.at(count.index, age + 1).on_read = lambda age=age: self._past(age)

    @property
    def register(self) -> int:
        """Value of 1001h."""
        bits = _GENERIC if self._present else 0
        for code in self._present:
            bits |= _register_bit(code)
        return bits

    def report(self, code: int) -> None:
        """Report an error; while it stays present it is not reported again."""
        if code in self._present:
            return
        self._present.append(code)
        self._history.insert(0, code)
        del self._history[_HISTORY_LENGTH:]
        self._send(_FRAME.pack(code, self.register))

    def clear(self, *codes: int) -> None:
        """Take back those of the errors that were present."""
        remaining = [code for code in self._present if code not in codes]
        if len(remaining) < len(self._present):
            self._present = remaining
            self._send(_FRAME.pack(0, self.register))

    def reset(self) -> None:
        """Forget all errors without a message, as when the node starts."""
        self._present.clear()
        self._history.clear()

    @property
    def are_present(self) -> bool:
        """True if an error was reported and not taken back."""
        return bool(self._present)

    def _past(self, age: int) -> int:
        if age >= len(self._history):
            raise AbortError(Abort.NO_DATA)
        return self._history[age]

    def _clear_history(self, value: int) -> None:
        if value != 0:
            raise AbortError(Abort.VALUE)
        self._history.clear()
