"""Codes of the faults that the daemon detects, appended to their messages: ``x: no usable feedback ... [FH-103]``.

Causes and remedies are in the table of friction_hil/daemon/README.md. FH-1xx is the daemon's range; FH-2xx belongs to
the drivers, whose messages have codes of their own.

>>> FaultCode.LOOP_LATE.append_to("the loop was late")
'the loop was late [FH-113]'
>>> FaultCode.DRIVER_MESSAGE.append_to("no heartbeat from node 5 [FH-230]")
'no heartbeat from node 5 [FH-230]'
"""

import re
from enum import Enum

_ANY_CODE = re.compile(r"\[FH-\d{3}\]")


class FaultCode(Enum):
    """A code and its short title."""

    FIRST_FEEDBACK_MISSING = 101, "no feedback at the start"
    PATH_BEYOND_LIMITS = 102, "trajectory beyond the limits"
    FEEDBACK_MISSING = 103, "feedback missing"
    POSITION_JUMPS = 104, "position jumps"
    DRIVE_IN_FAULT = 105, "drive in fault"
    DRIVE_LEFT_OPERATION = 106, "drive left Operation enabled"
    VELOCITY_LIMIT = 107, "velocity limit"
    POSITION_LIMIT = 108, "position limit"
    FOLLOWING_ERROR = 109, "following error"
    MODEL_NOT_FINITE = 110, "friction model not finite"
    COMPUTATION_FAILED = 111, "computation failed"
    WARMING_FAILED = 112, "warming the caches failed"
    LOOP_LATE = 113, "loop too late"
    NOT_ENABLED = 114, "drive not enabled in time"
    NO_STANDSTILL = 115, "no standstill after quick stop"
    STILL_POWERED = 116, "drive still powered"
    EXCHANGE_FAILED = 117, "exchange with the drives failed"
    DRIVER_MESSAGE = 118, "fault reported by the driver"
    VELOCITY_CONTRADICTS = 119, "velocity contradicts position"
    STATE_UNKNOWN = 120, "state unknown after the stop"
    VELOCITY_UNIT_WRONG = 123, "wrong unit of the velocity"
    AXIS_DOES_NOT_MOVE = 124, "axis does not move"
    WRONG_DIRECTION = 125, "axis moves in the wrong direction"

    def __init__(self, number: int, title: str) -> None:
        self.number = number
        self.title = title

    def __str__(self) -> str:
        return f"FH-{self.number}"

    def append_to(self, message: str) -> str:
        """Return the message with this code at its end; a message that has a code already stays as it is."""
        return message if _ANY_CODE.search(message) else f"{message} [{self}]"


def coded(text: str, code: str) -> str:
    """Append a driver's code to its message: ``no heartbeat from node 5 [FH-230]``."""
    return f"{text} [{code}]"
