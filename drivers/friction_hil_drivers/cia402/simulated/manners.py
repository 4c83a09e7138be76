"""Manners of a simulated drive: how it deviates from the drive that does everything well."""

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, field_validator

from friction_hil_drivers.cia402.simulated.units import VelocityUnit

Unsigned8 = Annotated[int, Field(ge=0, le=0xFF)]
Unsigned32 = Annotated[int, Field(ge=0, le=0xFFFFFFFF)]
Index = Annotated[int, Field(ge=0x1000, le=0xFFFF)]
Seconds = Annotated[float, Field(ge=0.0, le=3600.0, allow_inf_nan=False)]


class Preset(BaseModel):
    """Value of an object at power-on."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    index: Index
    subindex: Unsigned8 = 0
    value: int


class DriveManners(BaseModel):
    """What real drives do differently from each other, on any bus. Not given: as the own simulated drive does it."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    faults_without_power: bool = Field(
        False, description="a lost connection leads to Fault (6007h = 1) also while the drive has no power"
    )
    switch_on_s: Seconds = Field(0.0, description="time from the command to Switched On, s")
    enable_s: Seconds = Field(0.0, description="time from the command to Operation Enabled, s, e.g. of a brake")
    controlword: Literal["level", "edge", "twice"] = Field(
        "level",
        description="level: acts as long as it asks for a transition; edge: acts when it changes; twice: acts when it "
        "came twice in a row",
    )
    velocity_unit: str | None = Field(
        None,
        description="unit of 60FFh, 606Ch, 606Bh, 60B1h, e.g. rpm, 0.1 rpm or rad/s, told by 60A9h unless that is "
        "missing; counts/s when not given",
    )
    is_inverted: bool = Field(False, description="the positive direction on the bus is the servo's negative one")
    is_reversed: bool = Field(
        False, description="targets and offsets of velocity and torque act against the direction of the position"
    )
    values: tuple[Preset, ...] = Field(
        (),
        description="values of objects at power-on; 608Fh, 6076h, 60A9h and 6502h are only shown, so that a drive can "
        "report what is not so",
    )

    @field_validator("velocity_unit")
    @classmethod
    def _check_velocity_unit(cls, text: str | None) -> str | None:
        if text is not None:
            VelocityUnit.parse(text)
        return text
