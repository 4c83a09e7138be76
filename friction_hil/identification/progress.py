"""Progress of an identification, fit by fit."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class FitStep:
    """A fit that begins."""

    stage: str  # of the identification: families, modifiers, age of the torque, refinement or refined modifiers
    number: int  # of the fit in its stage, from 1
    count: int | None  # most fits in the stage, of which results may save some; None: not known
    label: str  # of the candidate
