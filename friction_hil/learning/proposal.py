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
    """What is to be handed over.

    Attributes
    ----------
    step : Step
    model : FrictionModel or None
        None: the model stays.
    gain : float
        Factor on the model's torque.
    text : str
        Why.
    """

    step: Step
    model: FrictionModel | None
    gain: float
    text: str


@dataclass(slots=True)
class Trial:
    """What is in force for a trial.

    Attributes
    ----------
    step : Step
    tried : Used
    before : Work
        With what was in force before, of the same motion.
    former : Used
        What was in force before.
    left : (float, float)
        Of the friction by it, in the window before, and how much of that was a lack of torque, N m.
    text : str
        Why.
    is_whole : bool
        False: only a part of it is in force.
    ticks : int
        Since it is in force.
    """

    step: Step
    tried: Used
    before: Work
    former: Used
    left: tuple[float, float]
    text: str = ""
    is_whole: bool = False
    ticks: int = 0

    @property
    def words(self) -> str:
        """What is tried."""
        return f"family {self.tried.family}" if self.step is Step.FAMILY else self.step.value
