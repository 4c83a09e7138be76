"""A change as a message to the loop, packed as numbers by the process that prepares it."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from friction_hil.daemon.static_torque import StaticTorque
    from friction_hil.numerics.jit import Array, StructuredArray

TEXT_BYTES = 160
HEAD, AXIS_HEAD = 4, 4  # numbers before the axes, and before the arrays of an axis


class Action(IntEnum):
    """What the run is to do besides."""

    NONE = 0
    START = 1
    STOP = 2
    RESET = 3


@dataclass(frozen=True, slots=True)
class AxisChange:
    """Change of one axis; what is None stays as it is."""

    is_enabled: bool | None = None  # the compensation is to be on or off
    record: "StructuredArray | None" = None  # new settings of the compensator
    friction: "Array | None" = None  # state in which another model begins; None: the model stays
    static: "StaticTorque | None" = None  # new feed-forward of gravity and offset


@dataclass(frozen=True, slots=True)
class Change:
    """A message to the loop: all of it is applied in one cycle, or nothing."""

    number: int  # counts up from 1
    action: Action = Action.NONE
    axes: Sequence[AxisChange | None] = field(default_factory=list)  # one for each axis; None: it stays as it is
    text: str = ""  # who changed what, for the notice


def pack(change: Change) -> bytes:
    """Return a change as bytes."""
    parts: list[Any] = [[change.number, change.action, len(change.axes), 0.0]]
    for axis in change.axes:
        one = axis or AxisChange()
        record = np.empty(0) if one.record is None else one.record.view(np.float64)
        friction = np.empty(0) if one.friction is None else one.friction
        enabled = math.nan if one.is_enabled is None else float(one.is_enabled)
        static = one.static or ()
        parts.append([enabled, record.size, friction.size, len(static)])
        parts += [record, friction, static]
    numbers = np.concatenate([np.asarray(part, np.float64) for part in parts])
    numbers[3] = numbers.size
    text = change.text.encode()[:TEXT_BYTES].decode("utf-8", "ignore").encode()
    return numbers.astype("<f8").tobytes() + text.ljust(TEXT_BYTES, b"\0")
