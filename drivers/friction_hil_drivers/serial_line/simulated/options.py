"""Options of a simulated drive on a serial line: the keys of ``simulation`` of its axis."""

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

from friction_hil.servo.config import ServoConfig

Probability = Annotated[float, Field(ge=0.0, le=1.0, allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]


class LineFaults(BaseModel):
    """Simulated faults of the line; equal for all simulated axes on one line."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    drop: Probability = Field(0.0, description="fraction of replies that never come")
    delay: Probability = Field(0.0, description="fraction of replies that come late by delay_s")
    delay_s: Positive = Field(
        0.01, le=10.0, description="delay of late replies, s; with pace sync they come after the next request"
    )
    corrupt: Probability = Field(0.0, description="fraction of replies with a flipped bit")
    split: Probability = Field(0.0, description="fraction of replies that come in two pieces")
    noise: Probability = Field(0.0, description="fraction of replies with stray bytes before them")
    reboot_at_s: tuple[Positive, ...] = Field(
        (), description="times after the start at which the drives of the line lose their supply for a moment, s"
    )
    seed: int = Field(0, ge=0, description="seed of the random faults")


class SerialSimulation(ServoConfig):
    """Options of a simulated servo, and of its line."""

    line: LineFaults = LineFaults()
