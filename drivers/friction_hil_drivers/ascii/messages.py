"""Messages of a description, compiled for one axis; driver and simulated drives both use them."""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import isfinite

from friction_hil_drivers.ascii.checksum import Checker
from friction_hil_drivers.ascii.description import AsciiDescription
from friction_hil_drivers.ascii.template import LineFormat

LONGEST_LINE = 256  # characters; anything longer is noise
_BLANKS = b"\r\n\0"  # rest of longer line ends, and zero bytes of adapters that are switched on


@dataclass(frozen=True, slots=True)
class CompiledMessage:
    """Message compiled for one axis."""

    request: LineFormat
    replies: tuple[LineFormat, ...]  # any of them may come; none: no reply
    writes: tuple[str, ...]
    reads: tuple[str, ...]
    sets: Mapping[str, float]
    feeds_watchdog: bool


class Language:
    """All messages to one axis and from it. ``axis``: text for ``{axis}``; any name matches when not given."""

    def __init__(self, description: AsciiDescription, axis: str | None) -> None:
        signals = description.signals
        self.messages = tuple(
            CompiledMessage(
                LineFormat(message.request, signals, axis),
                tuple(LineFormat(form, signals, axis) for form in description.replies(message)),
                message.writes,
                message.reads,
                message.sets,
                message.feeds_watchdog,
            )
            for message in description.messages.values()
        )
        self.checker = None if description.checksum is None else Checker(description.checksum)
        self.request_end = description.request_end.encode()
        self.reply_end = description.reply_end.encode()
        self.seal_request = sealer(self.checker, self.request_end)
        self.seal_reply = sealer(self.checker, self.reply_end)
        self.has_echo = description.echo
        self.is_answering_all = description.is_answering_all
        self.has_error_replies = bool(description.error_replies)
        self._meanings = [(re.compile(form.encode()), text) for form, text in description.error_replies.items()]
        errors = b"|".join(b"(?:%s)" % form.pattern for form, _ in self._meanings)
        self.is_error = re.compile(errors).fullmatch if errors else None

    def meaning(self, line: bytes) -> str | None:
        """Return the meaning of an error reply; None if the line is no error reply."""
        return next((text for form, text in self._meanings if form.fullmatch(line)), None)

    def sealed_size(self, size: int, end: bytes) -> int:
        """Return the size of a line of ``size`` characters with checksum and line end."""
        return size + (0 if self.checker is None else self.checker.size) + len(end)


def sealer(checker: Checker | None, end: bytes) -> Callable[[bytes], bytes]:
    """Return the function that appends checksum and line end to a line."""
    if checker is None:
        return lambda line: line + end
    form, compute = checker.form + end, checker.compute  # no line end has a % in it
    return lambda line: line + form % compute(line)


def reader(form: LineFormat, language: Language) -> Callable[[bytes | bytearray], tuple[list[float], int] | None]:
    """Return the function that reads replies of one format: line, checksum and line end.

    It takes the received bytes and returns the numbers, in the order of the names of ``form``, and the size of line,
    checksum and line end; None if the reply is incomplete, of another format, an error reply or has a wrong checksum.
    It raises `ValueError`: a number exceeds the range of its signal.
    """
    checker = language.checker
    end = (b"" if checker is None else checker.pattern) + re.escape(language.reply_end)
    match = re.compile(b"(" + form.pattern + b")" + end).match
    is_error = language.is_error
    number_groups = slice(1, 1 + len(form.names))  # group 0 is the whole line
    numbers, are_floats = form.numbers, form.are_floats
    if checker is None:
        compute, base = None, 0
    else:
        compute, base = checker.compute, checker.base

    # a closure, because it runs when the caches are cold: its variables need no look-up of attributes
    def read(received: bytes | bytearray) -> tuple[list[float], int] | None:
        found = match(received)
        if found is None:
            return None
        texts = found.groups()
        line = texts[0]
        if compute is not None and int(texts[-1], base) != compute(line):
            return None
        if is_error is not None and is_error(line):
            return None
        if are_floats:
            floats = list(map(float, texts[number_groups]))
            if isfinite(sum(floats)):
                return floats, found.end()
        return numbers(texts[number_groups]), found.end()

    return read


def take_line(received: bytearray, end: bytes) -> bytes | None:
    """Remove the first line that is not empty, and return it without its end; None if it is not complete.

    Raises `ValueError`: the line is longer than `LONGEST_LINE`; all received bytes were removed.
    """
    while True:
        index = received.find(end)
        size = len(received) if index < 0 else index
        if size >= LONGEST_LINE + len(end):
            received.clear()
            raise ValueError(f"no line ends within {LONGEST_LINE} characters")
        if index < 0:
            return None
        line = received[:index].strip(_BLANKS)
        del received[: index + len(end)]
        if line:
            return bytes(line)
