"""The states of learning, and what leads from one to another: the table of `layer.md`, which a test compares."""

from enum import Enum


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
