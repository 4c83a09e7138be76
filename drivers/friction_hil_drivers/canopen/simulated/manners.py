"""Manners of a simulated node: how it deviates from the one that does everything well."""

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

from friction_hil_drivers.canopen.simulated.scenario import Event
from friction_hil_drivers.cia402.simulated.manners import DriveManners, Index, Seconds, Unsigned8, Unsigned32


class SdoManner(BaseModel):
    """How one object is answered. Delays pass in real time, also with ``--pace sync``."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    index: Index = Field(description="the object, e.g. 0x60A9")
    subindex: Unsigned8 | None = Field(None, description="one of its sub-indices; all when not given")
    access: Literal["read", "write", "any"] = Field("any", description="the requests that it concerns")
    times: int | None = Field(None, ge=1, description="so many requests, then as usual; all when not given")
    delay_s: Seconds = Field(0.0, description="the answer comes so much later, s; the request takes effect at once")
    abort: Unsigned32 | None = Field(
        None, description="the answer is this abort code, e.g. 0x08000020, and the request has no effect"
    )
    is_silent: bool = Field(False, description="no answer and no effect")

    def fits(self, index: int, subindex: int, access: str) -> bool:
        """Return True for a request that it concerns."""
        return index == self.index and self.subindex in (None, subindex) and self.access in ("any", access)


class Manners(DriveManners):
    """What real drives do differently from each other on CANopen. Not given: as the own simulated drive does it."""

    timer_at_sync_only: bool = Field(
        False,
        description="look at the event timer (140xh:05) of a synchronous RPDO only when a SYNC comes, as CANopenNode "
        "does; event-driven RPDOs (254, 255) are always watched",
    )
    nmt_stops_drive: bool = Field(
        True,
        description="leaving Operational is a lost connection (6007h) to a powered drive; false: it goes on with its "
        "last set-points and heeds no RPDO, as CANopenNode does",
    )
    events: tuple[Event, ...] = Field((), description="what goes wrong, and when")
    sdo_delay_s: Seconds = Field(0.0, description="delay of every SDO answer, s, in real time")
    sdo: tuple[SdoManner, ...] = Field((), description="how some objects are answered; the first that fits counts")
