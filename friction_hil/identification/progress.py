"""Progress of an identification, fit by fit."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class FitStep:
    """A fit that begins.

    Attributes
    ----------
    stage : str
        Stage of the identification: families, modifiers or refinement.
    number : int
        Number of the fit in its stage, from 1.
    count : int, optional
        Number of fits in the stage; None where it depends on their results.
    label : str
        Label of the candidate.
    """

    stage: str
    number: int
    count: int | None
    label: str
