"""What learning proposes to hand over, and the notices about it."""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum

from friction_hil.daemon.control.message import TEXT_BYTES
from friction_hil.friction import FrictionModel
from friction_hil.learning import thresholds as th
from friction_hil.learning.estimate import Uncompensated
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
    left: Uncompensated  # by it, in the window before
    text: str = ""  # why


def described(
    proposal: Proposal, before: Mapping[str, float], after: Mapping[str, float], axis: str, *, is_tried: bool
) -> str:
    """Return what a proposal changes and why; as many parameters are named as there is room for.

    ``before``, ``after``: parameters in use, and those of the proposal. ``axis``: its name is put before the text.
    ``is_tried``: False for an axis that only proposes.
    """
    if proposal.step is Step.BACK:
        return f"learning takes back: {proposal.text}"
    if proposal.step is Step.KNOWN:
        return f"learning goes on with {proposal.text}"
    words = "learning tries" if is_tried else "learning would try"
    for most in range(th.MOST_NAMED, 0, -1):
        shown = _changes(before, after, most)
        text = f"{words} {shown}: {proposal.text}" if shown else f"{words} {proposal.text}"
        if len(f"{axis}: {text}".encode()) <= TEXT_BYTES:
            return text
    return f"{words} {proposal.text}"


def fitting(texts: list[str]) -> str:
    """Take the first of some texts, and as many more as a notice has room for; return them in one."""
    text = texts.pop(0)
    while texts and len(f"{text}; {texts[0]}".encode()) <= TEXT_BYTES:
        text = f"{text}; {texts.pop(0)}"
    return text


def _changes(before: Mapping[str, float], after: Mapping[str, float], most: int) -> str:
    """Return by how much parameters change, the largest changes first: ``coulomb +42 %, viscous -7 %``.

    Nothing where they are those of another family.
    """
    if before.keys() != after.keys():
        return ""
    relative = {name: (after[name] - value) / abs(value) for name, value in before.items() if value}
    named = sorted(
        (name for name in relative if abs(relative[name]) >= th.NAMED_CHANGE), key=lambda name: -abs(relative[name])
    )
    words = [f"{name} {100.0 * relative[name]:+.0f} %" for name in named[:most]]
    others = len(named) - len(words)
    return ", ".join([*words, *([f"{others} more"] if others else [])])
