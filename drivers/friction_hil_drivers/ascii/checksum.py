"""Checksums of lines of text: exclusive or, sum, CRC-8 and CRC-16, appended to the line."""

import functools
import operator
import re
from collections.abc import Callable
from typing import Literal, Self

from pydantic import Field, model_validator

from friction_hil_drivers.serial_line.description import Part

_WIDTHS = {"xor": 8, "sum": 8, "crc8": 8, "crc16": 16}


class Checksum(Part):
    """Kind and format of the checksum, for requests and replies alike.

    The parameters of a CRC are named as in the usual catalogues: CRC-16/MODBUS has the polynomial 8005h, the initial
    value FFFFh and is reflected; CRC-16/XMODEM has only the polynomial 1021h.
    """

    kind: Literal["xor", "sum", "crc8", "crc16"] = Field(
        description="xor and sum are taken over all characters, in 8 bits"
    )
    form: Literal["decimal", "hex"] = Field("hex", description="hex has two or four digits")
    prefix: str = Field("", pattern=r"^[!-~]{0,2}$", description="text before the checksum, e.g. *; it is not included")
    skip: int = Field(0, ge=0, le=8, description="characters at the beginning that are not included, e.g. 1 for a $")
    polynomial: int = Field(0, ge=0, le=0xFFFF, description="polynomial of a CRC, most significant bit first")
    initial: int = Field(0, ge=0, le=0xFFFF, description="initial value of a CRC")
    final_xor: int = Field(0, ge=0, le=0xFFFF, description="value that a CRC is combined with at the end, by xor")
    is_reflected: bool = Field(False, description="a CRC that takes the least significant bit first")

    @model_validator(mode="after")
    def _is_whole(self) -> Self:
        if self.form == "decimal" and not self.prefix:
            raise ValueError("a decimal checksum needs a prefix that marks where it begins")
        is_crc = self.kind.startswith("crc")
        if is_crc != bool(self.polynomial):
            raise ValueError(f"{self.kind} {'needs a' if is_crc else 'has no'} polynomial")
        for name in ("polynomial", "initial", "final_xor"):
            if getattr(self, name) >> _WIDTHS[self.kind]:
                raise ValueError(f"{name} has more than the {_WIDTHS[self.kind]} bits of a {self.kind}")
        return self


def checksum_function(settings: Checksum) -> Callable[[bytes], int]:
    """Return the function that computes the checksum of a line; it skips the characters that are not included."""
    if settings.skip:
        skip, counted = settings.skip, checksum_function(settings.model_copy(update={"skip": 0}))
        return lambda line: counted(line[skip:])
    if settings.kind == "xor":
        return lambda data: functools.reduce(operator.xor, data, 0)
    if settings.kind == "sum":
        return lambda data: sum(data) & 0xFF
    width, final = _WIDTHS[settings.kind], settings.final_xor
    table = _crc_table(settings.polynomial, width, is_reflected=settings.is_reflected)
    if settings.is_reflected:
        start = _reversed(settings.initial, width)

        def reflected(data: bytes) -> int:
            value = start
            for byte in data:
                value = table[(value ^ byte) & 0xFF] ^ value >> 8
            return value ^ final

        return reflected
    shift, mask, begin = width - 8, (1 << width) - 1, settings.initial

    def straight(data: bytes) -> int:
        value = begin
        for byte in data:
            value = table[(value >> shift ^ byte) & 0xFF] ^ value << 8 & mask
        return value ^ final

    return straight


def _reversed(value: int, width: int) -> int:
    return int(f"{value:0{width}b}"[::-1], 2)


def _crc_table(polynomial: int, width: int, *, is_reflected: bool) -> tuple[int, ...]:
    """Compute the CRC of each of the 256 bytes."""
    table = []
    for byte in range(256):
        value = (_reversed(byte, 8) if is_reflected else byte) << (width - 8)
        for _ in range(8):
            value = value << 1 ^ (polynomial if value >> (width - 1) else 0)
            value &= (1 << width) - 1
        table.append(_reversed(value, width) if is_reflected else value)
    return tuple(table)


class Checker:
    """Appends checksums to lines, and checks them."""

    def __init__(self, settings: Checksum) -> None:
        self.compute = checksum_function(settings)
        bits = _WIDTHS[settings.kind]
        is_hex = settings.form == "hex"
        width = bits // 4 if is_hex else len(str((1 << bits) - 1))
        prefix = settings.prefix.encode()
        # of prefix and checksum, for `%`
        self.form = prefix.replace(b"%", b"%%") + (b"%%0%dX" % width if is_hex else b"%d")
        self.base = 16 if is_hex else 10
        number = b"[0-9A-Fa-f]{%d}" % width if is_hex else b"[0-9]{1,%d}" % width
        # of prefix and checksum; the checksum itself is a group
        self.pattern = re.escape(prefix) + b"(" + number + b") *"
        self._split = re.compile(b"(.*)" + self.pattern, re.DOTALL).fullmatch
        self.size = len(prefix) + width  # most characters that the checksum adds to a line

    def remove(self, line: bytes) -> bytes:
        """Return the line without its checksum. Raises `ValueError`: it has none, or a wrong one."""
        found = self._split(line)
        if found is None:
            raise ValueError("has no checksum")
        text, received = found.groups()
        right = self.compute(text)
        if int(received, self.base) != right:
            raise ValueError(f"has a wrong checksum; expected: {(self.form % right).decode()}")
        return text
