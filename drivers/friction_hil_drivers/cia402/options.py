"""Keys of an axis that concern the objects of its drive, whatever bus they are reached by."""

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, field_validator

from friction_hil_drivers.cia402.load_encoder import LoadEncoderOptions
from friction_hil_drivers.cia402.temperature import TemperatureOptions
from friction_hil_drivers.cia402.units import parse_velocity_unit
from friction_hil_drivers.torque_sign import INVERTED_TORQUE, InvertedTorque

Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
_MOST_COUNTS = 1e15  # per rad or m; with the next one far beyond any drive
_MOST_TORQUE = 1e7  # N m or N


class Identity(BaseModel):
    """Content that object 1018h of the drive must have."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    vendor_id: int | None = Field(None, ge=0, le=0xFFFFFFFF, description="1018h:01")
    product_code: int | None = Field(None, ge=0, le=0xFFFFFFFF, description="1018h:02")


class DriveOptions(BaseModel):
    """Options of an axis that any driver of CiA 402 drives has."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    identity: Identity = Field(default=Identity(), description="refuse a drive that is not this one")
    counts_per_unit: Positive | None = Field(
        None,
        le=_MOST_COUNTS,
        description="encoder counts per rad of the motor (per m on a linear axis); from 608Fh when not given",
    )
    rated_torque: Positive | None = Field(
        None,
        le=_MOST_TORQUE,
        description="torque at 1000 per mille, N m (N on a linear axis); from 6076h when not given",
    )
    velocity_unit: str | None = Field(
        None,
        description="unit of the drive's velocities (60FFh, 606Ch), e.g. counts/s, rpm, 0.1 rpm, deg/s, rad/s, mm/s; "
        "from 60A9h when not given, else counts/s",
    )
    trust: tuple[Literal["counts_per_unit", "rated_torque", "velocity_unit"], ...] = Field(
        (), description="keys that stand although the drive contradicts them (608Fh, 6076h, 60A9h)"
    )
    is_inverted: bool = Field(False, description="invert the sign of position, velocity and torque")
    inverted_torque: InvertedTorque = Field("none", description=INVERTED_TORQUE)
    is_mode_check_required: bool = Field(
        True, description="refuse a drive whose 6502h does not list the mode; false: its 6502h may be wrong, try it"
    )
    temperature: TemperatureOptions | None = Field(
        None, description="object with a temperature for the friction model, read by SDO; by default none is read"
    )
    load_encoder: LoadEncoderOptions | None = Field(
        None, description="object with the position of an encoder at the load, recorded; by default there is none"
    )

    @field_validator("velocity_unit")
    @classmethod
    def _check_velocity_unit(cls, text: str | None) -> str | None:
        if text is not None:
            parse_velocity_unit(text)
        return text
