"""Encoder at the load: a second position of the drive, received in each cycle beside the motor's.

Its scale is that of the configuration, else it follows from the drive's own objects (CiA 402-2).
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

from friction_hil.drive.encoder import unwrap
from friction_hil.errors import DriveError
from friction_hil_drivers.cia402 import codes, objects
from friction_hil_drivers.cia402.access import ObjectReader
from friction_hil_drivers.cia402.codec import Block, place
from friction_hil_drivers.cia402.objects import DataType, Object
from friction_hil_drivers.cia402.units import LEAST_RESOLUTION, TOLERANCE, Kind

_BITS = 32
_FIX = "correct or remove the key load_encoder of the axis"


class LoadEncoderOptions(BaseModel):
    """Object with the position of the load; CiA 402 has 60E4h, additional position actual value."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    index: int = Field(0x60E4, ge=0x2000, le=0x9FFF, description="index of the object, INTEGER32")
    subindex: int = Field(1, ge=0, le=255, description="sub-index of the object")
    counts_per_unit: Annotated[float, Field(gt=0.0, le=1e15, allow_inf_nan=False)] | None = Field(
        None,
        description="counts of this encoder per rad (m) of the axis, whose position is that of the motor's encoder; by "
        "default from the drive (60E6h and 60EBh)",
    )
    is_inverted: bool = Field(False, description="the counts fall while the position of the motor rises")

    @property
    def entry(self) -> Object:
        """The object."""
        return Object(self.index, "load position", DataType.INTEGER32, self.subindex)


def require_object(access: ObjectReader, options: LoadEncoderOptions) -> Object:
    """Return the object; raises a `DriveError` if the drive lacks it, or it has not 32 bits."""
    entry = options.entry
    bits = access.width(entry)
    if bits is None:
        text = f"{access.axis}: {access.where} {access.why_absent(entry)} object {entry}"
        raise DriveError(text, _FIX, codes.OBJECT_MISSING)
    if bits != _BITS:
        text = f"{access.axis}: {entry} of {access.where} has {bits} bits; a position has {_BITS}"
        raise DriveError(text, _FIX, codes.OBJECT_SIZE)
    return entry


def with_scale(access: ObjectReader, options: LoadEncoderOptions, kind: Kind) -> tuple[LoadEncoderOptions, str]:
    """Return the options with a scale, and a note on where it comes from.

    The drive gives counts per revolution of the motor: 60E6h over 60EBh, of the sub-index of the position. 1/1 is a
    default that says nothing, a metre does not follow from it, and a gear (60E8h over 60EDh) leaves open on which side
    of it the encoder turns.

    Raises `DriveError`: neither the options nor the drive give one.
    """
    per = "m" if kind == "linear" else "rad"
    reported = _reported(access, options) if kind == "rotary" else None
    given = options.counts_per_unit
    if given is None:
        if reported is None:
            text = (
                f"{access.axis}: {access.where} does not report the resolution of the encoder at the load "
                f"({objects.ADDITIONAL_INCREMENTS}): give load_encoder.counts_per_unit (counts per {per} of the axis)"
            )
            raise DriveError(text, code=codes.UNIT_UNKNOWN)
        note = f"encoder at the load: {reported:.7g} counts per {per} (60E6h)"
        return options.model_copy(update={"counts_per_unit": reported}), note
    note = f"encoder at the load: {given:.7g} counts per {per} (load_encoder.counts_per_unit)"
    if reported is not None and not math.isclose(given, reported, rel_tol=TOLERANCE):
        note += f", although 60E6h of the drive says {reported:.7g} where no gear is between motor and encoder"
    return options, note


def _reported(access: ObjectReader, options: LoadEncoderOptions) -> float | None:
    """Return the counts per rad of the motor by the drive's own objects, None where they leave it open."""
    if options.index != objects.ADDITIONAL_POSITION.index:
        return None

    def value(entry: Object) -> int:
        return access.find(replace(entry, subindex=options.subindex)) or 1

    counts = value(objects.ADDITIONAL_INCREMENTS) / value(objects.ADDITIONAL_REVOLUTIONS)
    has_gear = value(objects.ADDITIONAL_GEAR_MOTOR) != value(objects.ADDITIONAL_GEAR_SHAFT)
    return counts / math.tau if counts >= LEAST_RESOLUTION and not has_gear else None


class LoadEncoder:
    """Position of the load from the feedback of each cycle, counted on when the counter wraps.

    ``blocks``: one of them carries the object.
    """

    __slots__ = ("_counts", "_number", "_place", "_scale", "_unpack", "position")

    def __init__(self, blocks: Sequence[Block], options: LoadEncoderOptions) -> None:
        self._number, self._place = place(blocks, options.entry)
        self._unpack = blocks[self._number].layout.unpack_from
        assert options.counts_per_unit is not None  # `with_scale` has set it
        self._scale = (-1.0 if options.is_inverted else 1.0) / options.counts_per_unit
        self._counts: int | None = None
        self.position = math.nan

    def take(self, data: Sequence[bytes]) -> None:
        """Take all blocks of a complete cycle."""
        raw = self._unpack(data[self._number])[self._place]
        self._counts = raw if self._counts is None else unwrap(self._counts, raw, _BITS)
        self.position = self._counts * self._scale
