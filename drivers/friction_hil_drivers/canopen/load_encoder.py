"""Encoder at the load: a second position of the drive, carried by its TPDOs beside the motor's."""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated

from pydantic import BaseModel, ConfigDict, Field

from friction_hil.drive.encoder import unwrap
from friction_hil.errors import DriveError
from friction_hil_drivers.canopen import codes
from friction_hil_drivers.canopen.mapping import MappedPdo, place
from friction_hil_drivers.cia402.objects import DataType, Object

if TYPE_CHECKING:
    from friction_hil_drivers.cia402.access import ObjectReader

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


def require_object(access: "ObjectReader", options: LoadEncoderOptions) -> Object:
    """Return the object, which the drive has.

    Raises
    ------
    DriveError
        The drive lacks it, or it has not 32 bits.
    """
    entry = options.entry
    bits = access.width(entry)
    if bits is None:
        text = f"{access.axis}: {access.where} {access.why_absent(entry)} object {entry}"
        raise DriveError(text, _FIX, codes.OBJECT_MISSING)
    if bits != _BITS:
        text = f"{access.axis}: {entry} of {access.where} has {bits} bits; a position has {_BITS}"
        raise DriveError(text, _FIX, codes.OBJECT_SIZE)
    return entry


class LoadEncoder:
    """Position of the load from the TPDOs of each cycle, counted on when the counter wraps.

    Parameters
    ----------
    tpdos : sequence of MappedPdo
        One of them carries the object.
    options : LoadEncoderOptions
    """

    __slots__ = ("_counts", "_number", "_place", "_scale", "_unpack", "position")

    def __init__(self, tpdos: Sequence[MappedPdo], options: LoadEncoderOptions) -> None:
        self._number, self._place = place(tpdos, options.entry)
        self._unpack = tpdos[self._number].layout.unpack_from
        assert options.counts_per_unit is not None  # `with_scale` has set it
        self._scale = (-1.0 if options.is_inverted else 1.0) / options.counts_per_unit
        self._counts: int | None = None
        self.position = math.nan

    def take(self, frames: Sequence[bytes]) -> None:
        """Take the data of all TPDOs of a complete cycle."""
        raw = self._unpack(frames[self._number])[self._place]
        self._counts = raw if self._counts is None else unwrap(self._counts, raw, _BITS)
        self.position = self._counts * self._scale
