"""What learning proposes to hand over."""

from dataclasses import dataclass
from enum import Enum

from friction_hil.friction import FrictionModel
from friction_hil.learning.judge import Work
from friction_hil.learning.motions import Used


class Step(Enum):
    """What a proposal is."""

    PARAMETERS = "parameters"
    GAIN = "gain"
    LAYER = "residual layer"
    FAMILY = "family"
    BACK = "back"
    KNOWN = "known"


@dataclass(frozen=True, slots=True)
class Proposal:
    """What is to be handed over."""

    step: Step
    model: FrictionModel | None  # None: the model stays
    gain: float  # factor on the model's torque
    text: str  # why


@dataclass(slots=True)
class Trial:
    """What is in force for a trial."""

    step: Step
    tried: Used
    before: Work  # with what was in force before, of the same motion
    former: Used  # what was in force before
    # of the friction by it, in the window before, and how much of that was a lack of torque, N m
    left: tuple[float, float]
    text: str = ""  # why
    is_whole: bool = False  # False: only a part of it is in force
    ticks: int = 0  # since it is in force

    @property
    def words(self) -> str:
        """What is tried."""
        return f"family {self.tried.family}" if self.step is Step.FAMILY else self.step.value
