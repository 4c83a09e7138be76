"""Data types of CiA 301 as a simulated drive stores and sends them: all of them, whatever a vendor's file uses."""

import math
import struct
from dataclasses import dataclass

Value = int | float | bytes


@dataclass(frozen=True, slots=True)
class WireType:
    """One data type."""

    bits: int  # on the wire; 0 for strings, domains and types that are not known, whose values are bytes
    code: str = ""  # format character of `struct`, to be used with ``<``; empty where it has none
    is_signed: bool = False
    is_real: bool = False

    @property
    def bounds(self) -> tuple[float, float]:
        """Smallest and largest value of a number."""
        if self.is_real:
            return -math.inf, math.inf
        if self.is_signed:
            return -(1 << (self.bits - 1)), (1 << (self.bits - 1)) - 1
        return 0, (1 << self.bits) - 1

    def fit(self, value: Value) -> Value:
        """Return a value as this type holds it: integers modulo its width."""
        if self.bits == 0:
            return value if isinstance(value, bytes) else _shortest(int(value))
        if self.is_real or isinstance(value, bytes):
            return value
        number = round(value) & ((1 << self.bits) - 1)
        return number - (1 << self.bits) if self.is_signed and number >> (self.bits - 1) else number

    def pack(self, value: Value) -> bytes:
        """Return a value as on the wire."""
        if isinstance(value, bytes):
            return value
        if self.code:
            return struct.pack(f"<{self.code}", value)
        if self.bits == 0:
            return _shortest(int(value))
        return int(value).to_bytes(self.bits // 8, "little", signed=self.is_signed)

    def unpack(self, data: bytes) -> Value:
        """Return the value of bytes on the wire."""
        if self.code:
            number: int | float = struct.unpack(f"<{self.code}", data)[0]
            return number
        return int.from_bytes(data, "little", signed=self.is_signed) if self.bits else bytes(data)


def _shortest(number: int) -> bytes:
    """Return a number in four bytes, or in as many as it needs."""
    number &= (1 << 64) - 1
    return number.to_bytes(4 if number < 1 << 32 else 8, "little")


_BYTES = WireType(0)
_TYPES = {
    0x01: WireType(8, "?"),
    0x02: WireType(8, "b", is_signed=True),
    0x03: WireType(16, "h", is_signed=True),
    0x04: WireType(32, "i", is_signed=True),
    0x05: WireType(8, "B"),
    0x06: WireType(16, "H"),
    0x07: WireType(32, "I"),
    0x08: WireType(32, "f", is_real=True),
    0x0C: WireType(48),  # TIME_OF_DAY
    0x0D: WireType(48),  # TIME_DIFFERENCE
    0x10: WireType(24, is_signed=True),
    0x11: WireType(64, "d", is_real=True),
    0x12: WireType(40, is_signed=True),
    0x13: WireType(48, is_signed=True),
    0x14: WireType(56, is_signed=True),
    0x15: WireType(64, "q", is_signed=True),
    0x16: WireType(24),
    0x18: WireType(40),
    0x19: WireType(48),
    0x1A: WireType(56),
    0x1B: WireType(64, "Q"),
}


def wire_type(kind: int) -> WireType:
    """Return a data type by its index in the object dictionary."""
    return _TYPES.get(kind, _BYTES)
