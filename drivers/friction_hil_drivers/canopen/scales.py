"""Scales of a drive: from the configuration, else from the drive's own objects."""

import math
from typing import Literal

from friction_hil.errors import DriveError
from friction_hil_drivers.canopen import codes, objects
from friction_hil_drivers.canopen.object_reader import ObjectReader
from friction_hil_drivers.canopen.objects import Object
from friction_hil_drivers.canopen.options import CanopenOptions
from friction_hil_drivers.canopen.units import CanopenUnits

_TURN = 2.0 * math.pi  # rad


def read_units(access: ObjectReader, options: CanopenOptions, kind: Literal["rotary", "linear"]) -> CanopenUnits:
    """Return the scales of a drive.

    Raises
    ------
    DriveError
        Neither the options nor the drive give them, or the drive's unit of velocity is not known.
    """
    counts = options.counts_per_unit or _counts_per_rad(access)
    rated_torque = options.rated_torque or _rated_torque(access)
    velocity = _velocity_per_unit(access, counts, kind)
    sign = -1.0 if options.is_inverted else 1.0
    return CanopenUnits(sign * counts, sign * velocity, sign * rated_torque)


def _counts_per_rad(access: ObjectReader) -> float:
    increments = _required(
        access, objects.ENCODER_INCREMENTS, "encoder resolution", "give counts_per_unit (counts per rad)"
    )
    revolutions = access.find(objects.MOTOR_REVOLUTIONS) or 1
    return increments / revolutions / _TURN


def _rated_torque(access: ObjectReader) -> float:
    fix = "give rated_torque in N m (rated current times torque constant)"
    return _required(access, objects.RATED_TORQUE, "rated torque", fix) / 1000.0


def _velocity_per_unit(access: ObjectReader, counts: float, kind: str) -> float:
    unit = access.find(objects.VELOCITY_UNIT)
    if unit in (None, 0, objects.COUNTS_PER_SECOND):
        return counts
    if unit != objects.REVOLUTIONS_PER_MINUTE:
        text = (
            f"{access.axis}: {access.where} reports velocity in a unit that is not known here "
            f"({objects.VELOCITY_UNIT} = {unit:08X}h; counts/s is 00B50300h, 1/min is 00B44700h)"
        )
        raise DriveError(text, code=codes.UNIT_UNKNOWN)
    if kind == "linear":
        text = f"{access.axis}: {access.where} reports velocity in 1/min; a linear axis needs counts/s"
        raise DriveError(text, code=codes.UNIT_UNKNOWN)
    return 60.0 / _TURN


def _required(access: ObjectReader, entry: Object, name: str, fix: str) -> int:
    """Return the value of an object that the configuration may replace."""
    value = access.find(entry)
    if not value:
        text = f"{access.axis}: {access.where} does not report its {name} ({entry}): {fix}"
        raise DriveError(text, code=codes.UNIT_UNKNOWN)
    return value
