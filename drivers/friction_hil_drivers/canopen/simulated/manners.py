"""Manners of a simulated drive: how it deviates from the drive that does everything well."""

from pydantic import BaseModel, ConfigDict, Field


class Manners(BaseModel):
    """What real drives do differently from each other. Not given: as the own simulated drive does it."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    timer_at_sync_only: bool = Field(
        False,
        description="look at the event timer (140xh:05) of a synchronous RPDO only when a SYNC comes, as CANopenNode "
        "does; event-driven RPDOs (254, 255) are always watched",
    )
