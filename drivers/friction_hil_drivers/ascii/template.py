"""Templates of lines of text with numbers in them, compiled for writing and reading the numbers.

A field in braces is a number, as in ``v {axis} {velocity_command:float}``; ``{axis}`` is the name of the axis. Numbers
are written without exponents, because many drives cannot read them.
"""

import functools
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from friction_hil_drivers.ascii.signals import AsciiSignal
from friction_hil_drivers.serial_line.units import saturated

AXIS = "axis"
FLOAT, INTEGER, HEXADECIMAL = "float", "int", "hex"
_TYPES = (FLOAT, INTEGER, HEXADECIMAL)
_BRACES = re.compile(r"\{([^{}]*)\}")
_NEVER = math.inf, -math.inf  # bounds that no number lies in, so that every number is converted
_WRAPPING = ("position", "position_command")
# The repetitions are bounded, and no character matches two adjacent parts: the time to match is linear.
_FLOAT = rb"[-+]?(?:[0-9]{1,40}(?:\.[0-9]{0,40})?|\.[0-9]{1,40})(?:[eE][-+]?[0-9]{1,3})?"
_INTEGER = rb"[-+]?[0-9]{1,20}"
_HEXADECIMAL = rb"[0-9A-Fa-f]{1,16}"


@dataclass(frozen=True, slots=True)
class NumberField:
    """Number in a line: the name of its signal, and its format."""

    name: str
    type: str


Part = str | NumberField  # text, with {axis} not replaced yet, or a number


def parse(template: str) -> tuple[Part, ...]:
    """Split a template into its parts.

    Raises `ValueError`: the text is no template; the message says what a template looks like.
    """
    if not template.isascii() or not template.isprintable():
        raise ValueError("must be printable ASCII; line ends are given by request_end and reply_end")
    parts: list[Part] = []
    for index, piece in enumerate(_BRACES.split(template)):
        if index % 2 == 0 or piece == AXIS:
            text = piece if index % 2 == 0 else f"{{{AXIS}}}"
            if parts and isinstance(parts[-1], str):
                parts[-1] += text
            elif text:
                parts.append(text)
            continue
        name, _, kind = piece.partition(":")
        if kind not in _TYPES:
            raise ValueError(f"{{{piece}}} is no field: {{{AXIS}}} or {{SIGNAL:TYPE}}, TYPE one of {', '.join(_TYPES)}")
        if parts and isinstance(parts[-1], NumberField):
            raise ValueError(f"{{{piece}}} follows a number without text between them: the end of the first is unknown")
        parts.append(NumberField(name, kind))
    names = [part.name for part in parts if isinstance(part, NumberField)]
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"contains {name} twice")
    if any("{" in part.replace(f"{{{AXIS}}}", "") or "}" in part.replace(f"{{{AXIS}}}", "") for part in _texts(parts)):
        raise ValueError("has an unpaired brace")
    return tuple(parts)


def fields(parts: tuple[Part, ...]) -> tuple[NumberField, ...]:
    """Return the numbers in a template, in their order."""
    return tuple(part for part in parts if isinstance(part, NumberField))


def _texts(parts: list[Part]) -> list[str]:
    return [part for part in parts if isinstance(part, str)]


class LineFormat:
    """Template compiled for one axis.

    ``axis``: text for ``{axis}``; without it any name matches, and no line can be written.
    """

    def __init__(self, template: str, signals: Mapping[str, AsciiSignal], axis: str | None) -> None:
        parts = parse(template)
        self.template = template
        self.names = tuple(field.name for field in fields(parts))  # signals in the line, in their order
        self.words = len(template.replace(f"{{{AXIS}}}", "" if axis is None else axis).split())  # parts between blanks
        # characters of the longest line that can be written; for a line that is read, of the longest whose floats have
        # at most `whole_digits` before the point and `digits` after it
        self.size = 0
        written, pattern = b"", rb" *"
        self._writers: list[tuple[str, float, float, Callable[[float], float]]] = []
        self._readers: list[Callable[[bytes], float]] = []
        for index, part in enumerate(parts):
            if isinstance(part, str):
                text = part.replace(f"{{{AXIS}}}", axis or "")
                if index == 0 and axis == "":
                    text = text.lstrip()  # "{axis} g" of a single drive without a name
                self.size += len(text)
                written += text.encode().replace(b"%", b"%%")
                pattern += _text_pattern(part, axis)
                continue
            signal = signals[part.name]
            form, low, high, convert, size = _writer(part, signal)
            written += form
            self.size += size
            self._writers.append((part.name, low, high, convert))
            expression, read = _reader(part, signal)
            pattern += b"(" + expression + b")"
            self._readers.append(read)
        self._written = written
        self.are_floats = all(field.type == FLOAT for field in fields(parts))
        self.pattern = pattern + rb" *"  # of a line that is read; each number is a group
        self._match = re.compile(self.pattern).fullmatch

    def write(self, values: Mapping[str, float]) -> bytes:
        """Return the line with the numbers of ``values``: rounded, limited, and integer positions wrapped.

        Raises `ValueError`: a value is missing or not finite.
        """
        numbers = []  # runs in every cycle: a comprehension would cost one more call
        try:
            for name, low, high, convert in self._writers:
                value = values[name]
                numbers.append(value if low <= value <= high else convert(value))
        except KeyError as error:
            raise ValueError(f"there is no value of {error.args[0]} to be sent yet") from error
        return self._written % tuple(numbers)

    def read(self, line: bytes) -> list[float] | None:
        """Return the numbers in ``line``, in the order of `names`; None if the line does not match the template.

        Raises `ValueError`: a number exceeds the range of its signal.
        """
        found = self._match(line)
        return None if found is None else self.numbers(found.groups())

    def numbers(self, texts: Sequence[bytes]) -> list[float]:
        """Convert the groups that `pattern` matched to numbers.

        Raises `ValueError`: a number exceeds the range of its signal.
        """
        if self.are_floats:
            numbers = list(map(float, texts))
        else:
            numbers = [read(text) for read, text in zip(self._readers, texts, strict=True)]
        if not all(map(math.isfinite, numbers)):
            name, text = next(
                (name, text)
                for name, number, text in zip(self.names, numbers, texts, strict=True)
                if not math.isfinite(number)
            )
            raise ValueError(f"{text.decode()} is too large for {name}")
        return numbers


def _text_pattern(text: str, axis: str | None) -> bytes:
    """Return the expression for the text between numbers; a space matches one space or more."""
    pieces = []
    for index, piece in enumerate(text.split(f"{{{AXIS}}}")):
        if index:
            pieces.append(rb"[!-~]{0,16}" if axis is None else re.escape(axis.encode()))
        words = piece.split(" ")
        pieces.append(rb" {1,8}".join(re.escape(word.encode()) for word in words))
    expression = b"".join(pieces)
    if axis == "" and text.startswith(f"{{{AXIS}}}"):
        expression = expression.removeprefix(rb" {1,8}")
    return expression


def _writer(field: NumberField, signal: AsciiSignal) -> tuple[bytes, float, float, Callable[[float], float], int]:
    """Return %-format, bounds within which no conversion is needed, conversion and largest size of a written number."""
    if field.type == FLOAT:
        digits = signal.digits
        end = 10.0**signal.whole_digits
        limit = min(end - 10.0**-digits, math.nextafter(end, 0.0))  # the difference may be lost in 16 digits
        size = 1 + signal.whole_digits + (digits + 1 if digits else 0)
        return b"%%.%df" % digits, -limit, limit, functools.partial(saturated, low=-limit, high=limit), size
    low, high = _bounds(signal)
    span = high - low + 1
    if field.name in _WRAPPING:

        def convert(value: float) -> int:
            return (_rounded(value) - low) % span + low
    else:

        def convert(value: float) -> int:
            return _rounded(saturated(value, low, high))

    if field.type == INTEGER:
        return b"%d", *_NEVER, convert, max(len(str(low)), len(str(high)))
    width = len(f"{span - 1:X}")
    return b"%%0%dX" % width, *_NEVER, lambda value: convert(value) % span, width


def _rounded(value: float) -> int:
    if not math.isfinite(value):
        raise ValueError(f"{value} cannot be sent to a drive")
    return round(value)


def _reader(field: NumberField, signal: AsciiSignal) -> tuple[bytes, Callable[[bytes], float]]:
    """Return the regular expression of a number that is read, and the function that converts a match."""
    name = field.name
    if field.type == FLOAT:
        return _FLOAT, float
    low, high = _bounds(signal)
    if field.type == HEXADECIMAL:
        span = high - low + 1

        def read_hexadecimal(text: bytes) -> float:
            value = int(text, 16)
            if value >= span:
                raise ValueError(f"{text.decode()} has more bits than {name}")
            return float((value - low) % span + low)

        return _HEXADECIMAL, read_hexadecimal

    def read_integer(text: bytes) -> float:
        value = int(text)
        if not low <= value <= high:
            raise ValueError(f"{text.decode()} is outside the range {low} to {high} of {name}")
        return float(value)

    return _INTEGER, read_integer


def _bounds(signal: AsciiSignal) -> tuple[int, int]:
    assert signal.bounds is not None  # the description refuses integers without bits
    return signal.bounds
