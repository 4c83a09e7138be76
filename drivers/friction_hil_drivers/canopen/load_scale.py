"""Scale of an encoder at the load: from the configuration, else from the drive's own objects (CiA 402-2)."""

import math
from dataclasses import replace
from typing import TYPE_CHECKING

from friction_hil.errors import DriveError
from friction_hil_drivers.canopen import codes
from friction_hil_drivers.canopen.load_encoder import LoadEncoderOptions
from friction_hil_drivers.canopen.scales import LEAST_RESOLUTION, TOLERANCE, Kind
from friction_hil_drivers.cia402 import objects
from friction_hil_drivers.cia402.objects import Object

if TYPE_CHECKING:
    from friction_hil_drivers.cia402.access import ObjectReader


def with_scale(access: "ObjectReader", options: LoadEncoderOptions, kind: Kind) -> tuple[LoadEncoderOptions, str]:
    """Return the options with a scale, and a note on where it comes from.

    The drive gives counts per revolution of the motor: 60E6h over 60EBh, of the sub-index of the position. 1/1 is a
    default that says nothing, a metre does not follow from it, and a gear (60E8h over 60EDh) leaves open on which side
    of it the encoder turns.

    Raises
    ------
    DriveError
        Neither the options nor the drive give one.
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


def _reported(access: "ObjectReader", options: LoadEncoderOptions) -> float | None:
    """Return the counts per rad of the motor by the drive's own objects, None where they leave it open."""
    if options.index != objects.ADDITIONAL_POSITION.index:
        return None

    def value(entry: Object) -> int:
        return access.find(replace(entry, subindex=options.subindex)) or 1

    counts = value(objects.ADDITIONAL_INCREMENTS) / value(objects.ADDITIONAL_REVOLUTIONS)
    has_gear = value(objects.ADDITIONAL_GEAR_MOTOR) != value(objects.ADDITIONAL_GEAR_SHAFT)
    return counts / math.tau if counts >= LEAST_RESOLUTION and not has_gear else None
