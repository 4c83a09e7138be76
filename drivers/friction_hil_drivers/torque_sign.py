"""Sign of the torque alone: drives may count it in another direction than position and velocity. Pure."""

from typing import Literal

InvertedTorque = Literal["none", "command", "feedback", "both"]

INVERTED_TORQUE = (
    "torque whose sign is inverted beside position and velocity: command (what is sent acts in the other direction), "
    "feedback (what is reported), or both, as after 607Eh = C0h"
)


def torque_signs(inverted: InvertedTorque) -> tuple[float, float]:
    """Return the signs of the torque that is sent and of the one that is reported.

    >>> torque_signs("command")
    (-1.0, 1.0)
    """
    return -1.0 if inverted in ("command", "both") else 1.0, -1.0 if inverted in ("feedback", "both") else 1.0
