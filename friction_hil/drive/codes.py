"""Codes of the faults that the daemon detects, appended to their messages: ``x: no usable feedback ... [FH-103]``.

The table of friction_hil/daemon/README.md has the causes too. FH-1xx is the daemon's range; FH-2xx belongs to
the drivers, whose messages have codes of their own.

>>> FaultCode.LOOP_LATE.append_to("the loop was late")
'the loop was late [FH-113]'
>>> FaultCode.DRIVER_MESSAGE.append_to("no heartbeat from node 5 [FH-230]")
'no heartbeat from node 5 [FH-230]'
"""

import re
from enum import Enum

_ANY_CODE = re.compile(r"\[(FH-\d{3})\]")


class FaultCode(Enum):
    """A code, its short title, and what to do about it."""

    FIRST_FEEDBACK_MISSING = (
        101,
        "no feedback at the start",
        "check power, wiring, node number and bit rate; `friction-hil doctor FILE`",
    )
    PATH_BEYOND_LIMITS = (
        102,
        "trajectory beyond the limits",
        "move the axis, make the motion smaller, or widen `limits.position` or `limits.velocity`",
    )
    FEEDBACK_MISSING = (
        103,
        "feedback missing",
        "check cable and line; use a longer `period_s` or a larger `realtime.max_missed`",
    )
    POSITION_JUMPS = (
        104,
        "position jumps",
        "check the description of the position; raise `limits.velocity` if the axis may be that fast",
    )
    DRIVE_IN_FAULT = (
        105,
        "drive in fault",
        "remove the cause as the drive's manual says, then start with `--reset-fault`, or after "
        "`friction-hil reset CONFIG`",
    )
    DRIVE_LEFT_OPERATION = 106, "drive left Operation enabled", "find out what removed the enable"
    VELOCITY_LIMIT = (
        107,
        "velocity limit",
        "check sign and tuning; allow a margin over the trajectory in `limits.velocity`",
    )
    POSITION_LIMIT = 108, "position limit", "check the motion, and whether something pushed the axis"
    FOLLOWING_ERROR = (
        109,
        "following error",
        "free the axis; check the drive's limits; raise `limits.following_error` if the error is acceptable",
    )
    MODEL_NOT_FINITE = (
        110,
        "friction model not finite",
        "check the model with `friction-hil models FILE --draw model.png`; identify again",
    )
    COMPUTATION_FAILED = 111, "computation failed", "report it with the message and the recording"
    WARMING_FAILED = 112, "warming the caches failed", "report it with the message and the recording"
    LOOP_LATE = 113, "loop too late", "`friction-hil doctor`; use a longer `period_s` or a larger `realtime.max_missed`"
    NOT_ENABLED = (
        114,
        "drive not enabled in time",
        (
            "the message names the state of the drive, and its statusword 6041h with what it says: no voltage, not in "
            "remote control; see its manual. A drive that needs longer: `enable_timeout_s`"
        ),
    )
    NO_STANDSTILL = 115, "no standstill after quick stop", "raise the drive's quick stop deceleration; check the brake"
    STILL_POWERED = (
        116,
        "drive still powered",
        "`friction-hil stop CONFIG`; else switch its power off; look for a second master",
    )
    EXCHANGE_FAILED = 117, "exchange with the drives failed", "follow the message; `friction-hil doctor FILE`"
    DRIVER_MESSAGE = 118, "fault reported by the driver", "follow the message"
    VELOCITY_CONTRADICTS = (
        119,
        "velocity contradicts position",
        "check encoder and units; see the table before the first enable",
    )
    STATE_UNKNOWN = (
        120,
        "state unknown after the stop",
        "assume that it has power; check supply and wires; `friction-hil stop CONFIG` says what it reads back",
    )
    VELOCITY_UNIT_WRONG = (
        123,
        "wrong unit of the velocity",
        "set `velocity_unit` to the unit that the message names; compare the drive's manual",
    )
    AXIS_DOES_NOT_MOVE = (
        124,
        "axis does not move",
        "release the axis; check the drive's torque limit and `velocity_unit`",
    )
    WRONG_DIRECTION = (
        125,
        "axis moves in the wrong direction",
        "correct the sign in the drive; `is_inverted` inverts position, velocity and torque together and does not help",
    )
    PROGRAM_ERROR = (
        126,
        "program error",
        "report it with the message and the recording or black box, which has the calls that led to it",
    )
    NO_MEMORY = (
        127,
        "no memory",
        "end what takes the memory of this computer, or raise the limit of the process (`ulimit -v`, `MemoryMax=`)",
    )

    TORQUE_LEFT = (
        128,
        "torque may be left in a drive",
        "write the object or register that the message names to 0 before anybody enables the drive, or switch it off",
    )

    def __init__(self, number: int, title: str, remedy: str) -> None:
        self.number = number
        self.title = title
        self.remedy = remedy

    def __str__(self) -> str:
        return f"FH-{self.number}"

    def append_to(self, message: str) -> str:
        """Return the message with this code at its end; a message that has a code already stays as it is."""
        return message if _ANY_CODE.search(message) else f"{message} [{self}]"


def coded(text: str, code: str) -> str:
    """Append a driver's code to its message: ``no heartbeat from node 5 [FH-230]``."""
    return f"{text} [{code}]"


def code_of(message: str) -> str:
    """Return the code at the end of a message, ``FH-113``; empty if it has none.

    >>> code_of("the loop was late [FH-113]")
    'FH-113'
    """
    found = _ANY_CODE.findall(message)
    return found[-1] if found else ""
