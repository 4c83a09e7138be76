"""The states of learning, and what leads from one to another: the table of `layer.md`, which a test compares.

Beside the state: what the configuration says, what is in force, and what the record has shown.
"""

import math
from dataclasses import dataclass
from enum import Enum

from friction_hil.learning.estimate import Estimate
from friction_hil.learning.motions import Used
from friction_hil.learning.residual import Finding
from friction_hil.learning.thresholds import TICK_S


class State(Enum):
    """What learning does; there is a trial in `THIRD` and `WHOLE` alone."""

    WATCHING = "watching"
    THIRD = "trying a third"
    WHOLE = "trying all"
    RESTING = "resting"
    STOPPED = "stopped"


class Event(Enum):
    """What leads to another state."""

    PROPOSED = "a change is worth a trial"
    HARMLESS = "a third of it lowers the error"
    KEPT = "all of it lowers the error: it is kept"
    TAKEN_BACK = "it is taken back, or refused"
    WAITS = "this motion has to wait for the next trial"
    WAITED = "the wait is over, or another motion has begun"
    ODD = "the record is not that of the axis"
    OVER = "ten seconds are over"


TRANSITIONS = {
    (State.WATCHING, Event.PROPOSED): State.THIRD,
    (State.WATCHING, Event.WAITS): State.RESTING,
    (State.WATCHING, Event.ODD): State.STOPPED,
    (State.RESTING, Event.PROPOSED): State.THIRD,  # of a residual layer or family, which have waits of their own
    (State.RESTING, Event.WAITED): State.WATCHING,
    (State.RESTING, Event.ODD): State.STOPPED,
    (State.THIRD, Event.HARMLESS): State.WHOLE,
    (State.THIRD, Event.TAKEN_BACK): State.WATCHING,
    (State.WHOLE, Event.KEPT): State.WATCHING,
    (State.WHOLE, Event.TAKEN_BACK): State.WATCHING,
    (State.STOPPED, Event.OVER): State.WATCHING,
    (State.STOPPED, Event.ODD): State.STOPPED,
}


@dataclass(frozen=True, slots=True)
class LearnerSettings:
    """What is given to the learning of an axis."""

    period_s: float
    resolution: float  # step of the position, rad or m
    gain: float  # that of the configuration, the least that is commanded
    fade_s: float  # over which a change is blended
    is_gain_fixed: bool = False
    has_layer: bool = True  # a residual layer is looked for
    has_families: bool = True  # other families of models are considered

    @property
    def fade_ticks(self) -> int:
        """Ticks over which a change is blended."""
        return math.ceil(self.fade_s / TICK_S)


@dataclass(slots=True)
class InForce:
    """What the compensator has, and what it had."""

    used: Used
    former: Used  # before the last proposal
    kept: Used  # proven last
    owed: Used | None = None  # what to go back to, which was refused
    resumed: Used | None = None  # from an earlier run, to be handed over with the first motion
    is_back: bool = False  # the last proposal went back
    ticks: int = 0  # since the last change, as far as they are comparable


@dataclass(slots=True)
class Seen:
    """What the record has shown."""

    estimate: Estimate | None = None
    usual: float = 0.0  # torque that the estimate leaves unexplained, N m
    residual: float = math.inf  # of the last estimate, whatever the motion, N m
    finding: Finding | None = None  # what the last window shows of a residual layer
    unused: int = 0  # ticks that no estimate has used yet
    misled: int = 0  # ticks in which the model file explained the torque better, one after the other


@dataclass(slots=True)
class Halt:
    """Why learning has stopped, and the ticks until it goes on."""

    why: str = ""
    ticks: int = 0
