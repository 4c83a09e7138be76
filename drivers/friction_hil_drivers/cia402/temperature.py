"""Temperature of a motor or drive, in the feedback of a cycle that has room for it, else read now and then.

Neither CiA 301 nor CiA 402 has an object for it.
"""

import math
import struct
from collections.abc import Sequence
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from friction_hil.drive.codes import coded
from friction_hil.errors import DriveError
from friction_hil_drivers.cia402 import codes
from friction_hil_drivers.cia402.access import ObjectReader, Reading
from friction_hil_drivers.cia402.codec import Block, place
from friction_hil_drivers.cia402.objects import DataType, Object

Finite = Annotated[float, Field(allow_inf_nan=False)]
_TYPES = {
    "int8": DataType.INTEGER8,
    "int16": DataType.INTEGER16,
    "int32": DataType.INTEGER32,
    "uint8": DataType.UNSIGNED8,
    "uint16": DataType.UNSIGNED16,
    "uint32": DataType.UNSIGNED32,
    "float32": DataType.UNSIGNED32,  # its bits, as a PDO carries them
}
_PATIENCE = 5  # readings that may fail in a row
NEVER_NS = 1 << 62


class TemperatureOptions(BaseModel):
    """Object of the manufacturer that holds a temperature: number times scale plus offset, deg C."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    index: int = Field(ge=0x2000, le=0x9FFF, description="index of the object, e.g. 0x2030")
    subindex: int = Field(0, ge=0, le=255, description="sub-index of the object")
    type: Literal["int8", "int16", "int32", "uint8", "uint16", "uint32", "float32"] = Field(
        "int16", description="data type of the object"
    )
    scale: Finite = Field(1.0, description="deg C per unit of the object, e.g. 0.1")
    offset: Finite = Field(0.0, description="deg C at 0 of the object, e.g. -273.15 for kelvin")
    interval_s: float = Field(1.0, ge=0.1, le=3600.0, description="time between two readings by SDO, s")

    @model_validator(mode="after")
    def _check_scale(self) -> "TemperatureOptions":
        if self.scale == 0.0:
            raise ValueError("scale must not be 0: every reading would be the offset")
        return self

    @property
    def entry(self) -> Object:
        """The object."""
        return Object(self.index, "temperature", _TYPES[self.type], self.subindex)

    @property
    def size(self) -> int:
        """Number of bytes of the object."""
        return self.entry.type.bits // 8

    def decode(self, data: bytes) -> float:
        """Return the temperature, deg C; NaN where the data have another size than the type."""
        if len(data) != self.size:
            return math.nan
        return self.convert(int.from_bytes(data, "little", signed=self.entry.type.is_signed))

    def convert(self, raw: int) -> float:
        """Return the temperature of the object's integer, or of the bits of its float, deg C."""
        number: float = raw
        if self.type == "float32":
            (number,) = struct.unpack("<f", raw.to_bytes(4, "little"))
        return number * self.scale + self.offset


def read_first(access: ObjectReader, options: TemperatureOptions) -> float:
    """Read the temperature before the cyclic phase, deg C; raises a `DriveError` if absent or of another size."""
    data = access.bytes_of(options.entry)
    if data is None:
        text = f"{access.axis}: {access.where} {access.why_absent(options.entry)} object {options.entry}"
        raise DriveError(text, "correct or remove the key temperature of the axis", codes.OBJECT_MISSING)
    if len(data) != options.size:
        text = (
            f"{access.axis}: {options.entry} of {access.where} has {len(data)} bytes, but temperature.type: "
            f"{options.type} has {options.size}"
        )
        raise DriveError(text, "correct temperature.type of the axis", codes.OBJECT_SIZE)
    return options.decode(data)


class MappedTemperature:
    """Temperature from the feedback of each cycle.

    ``blocks``: one of them carries the object.
    """

    __slots__ = ("_convert", "_number", "_place", "_unpack")

    def __init__(self, blocks: Sequence[Block], options: TemperatureOptions) -> None:
        self._number, self._place = place(blocks, options.entry)
        self._unpack = blocks[self._number].layout.unpack_from
        self._convert = options.convert

    def take(self, data: Sequence[bytes]) -> float:
        """Return the temperature in all blocks of a complete cycle, deg C; NaN for a float that is none."""
        return self._convert(self._unpack(data[self._number])[self._place])


class TemperatureRead:
    """Readings in the cyclic phase, one each `TemperatureOptions.interval_s`; without options there is none."""

    __slots__ = ("_failed", "_interval_ns", "_options", "due_ns", "notice", "value")

    def __init__(self, options: TemperatureOptions | None, first: float = math.nan) -> None:
        self._options = options
        self._interval_ns = 0 if options is None else round(options.interval_s * 1e9)
        self._failed = 0
        self.value = first  # deg C; NaN where the last readings failed
        self.due_ns = NEVER_NS  # of the next reading
        self.notice = ""  # for the user, to be taken once

    def start(self, now_ns: int) -> None:
        """Begin to count the time of the readings."""
        if self._options is not None:
            self.due_ns = now_ns + self._interval_ns

    def request(self, now_ns: int) -> Object | None:
        """Return the object whose reading is due."""
        if self._options is None or now_ns < self.due_ns:
            return None
        self.due_ns = now_ns + self._interval_ns
        return self._options.entry

    def take(self, reading: Reading, now_ns: int) -> None:
        """Take a reading once it is over."""
        assert self._options is not None
        value = self._options.decode(reading.data or b"")
        if math.isfinite(value):
            self.value, self._failed = value, 0
            return
        self._failed += 1
        if self._failed == _PATIENCE:
            self.value = math.nan
            answer = "answers with no number" if reading.data is not None else "refuses it"
            why = "does not answer" if reading.is_silent else answer
            text = f"{self._options.entry} was not read {_PATIENCE} times in a row: the drive {why}"
            self.notice = coded(text, codes.OBJECT_MISSING)
