"""What learning proposes to hand over."""

from dataclasses import dataclass
from enum import Enum

from friction_hil.friction import FrictionModel


class Step(Enum):
    """What a proposal is."""

    PARAMETERS = "parameters"
    GAIN = "gain"
    LAYER = "residual layer"
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
