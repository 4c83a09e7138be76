"""Progress of an identification, fit by fit."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class FitStep:
    """A fit that begins.

    Attributes
    ----------
    stage : str
        Stage of the identification: families, modifiers, age of the torque, refinement or refined modifiers.
    number : int
        Number of the fit in its stage, from 1.
    count : int, optional
        Largest number of fits in the stage, of which results may save some; None where it is not known.
    label : str
        Label of the candidate.
    """

    stage: str
    number: int
    count: int | None
    label: str
