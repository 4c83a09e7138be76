"""Codes of the faults that the daemon detects, appended to their messages: ``x: no usable feedback ... [FH-103]``.

`friction-hil explain` and the site print these tables. FH-1xx is the daemon's range; FH-2xx belongs to
the drivers, whose messages have codes of their own.

>>> FaultCode.LOOP_LATE.append_to("the loop was late")
'the loop was late [FH-113]'
>>> FaultCode.DRIVER_MESSAGE.append_to("no heartbeat from node 5 [FH-230]")
'no heartbeat from node 5 [FH-230]'
"""

import re
from enum import Enum
from typing import NamedTuple

_ANY_CODE = re.compile(r"\[(FH-\d{3})\]")


class Explanation(NamedTuple):
    """What a message says, where it comes from, and what to do about it."""

    message: str
    cause: str
    remedy: str


class FaultCode(Enum):
    """A code with its message, its cause, and what to do about it."""

    FIRST_FEEDBACK_MISSING = (
        101,
        "no usable feedback within 1 s of the start",
        "the drive sends nothing, or only values that are not finite",
        "check power, wiring, node number and bit rate; `friction-hil doctor FILE`",
    )
    PATH_BEYOND_LIMITS = (
        102,
        "the trajectory would go outside the position limits; or needs more than the velocity limit",
        "the path, which begins where the axis stands, does not fit into its limits",
        "move the axis, make the motion smaller, or widen `limits.position` or `limits.velocity`",
    )
    FEEDBACK_MISSING = (
        103,
        "no usable feedback for more than N cycles",
        "replies are missing or late; the message names the reason where the driver knows it",
        "check cable and line; use a longer `period_s` or a larger `realtime.max_missed`",
    )
    POSITION_JUMPS = (
        104,
        "its position jumps further than limits.velocity allows",
        "wrong word order or type of the position, a slipping encoder, or a velocity limit that is too low",
        "check the description of the position; raise `limits.velocity` if the axis may be that fast",
    )
    DRIVE_IN_FAULT = (
        105,
        "the drive is in fault",
        "the drive has reported a fault; its own error code follows",
        (
            "remove the cause as the drive's manual says, then start with `--reset-fault`, or after `friction-hil "
            "reset CONFIG`"
        ),
    )
    DRIVE_LEFT_OPERATION = (
        106,
        "the drive left Operation enabled",
        "the drive was disabled by an input, a brake, missing power or another master",
        "find out what removed the enable",
    )
    VELOCITY_LIMIT = (
        107,
        "velocity is beyond its limit",
        (
            "the axis runs away, or overshoots its set-point; after missed periods, which the message then names, "
            "the drive may have caught up by itself"
        ),
        "check sign and tuning; allow a margin over the trajectory in `limits.velocity`",
    )
    POSITION_LIMIT = (
        108,
        "position is outside the limits",
        "the axis left `limits.position`",
        "check the motion, and whether something pushed the axis",
    )
    FOLLOWING_ERROR = (
        109,
        "following error is beyond its limit",
        "blocked axis, torque limit of the drive, weak tuning",
        "free the axis; check the drive's limits; raise `limits.following_error` if the error is acceptable",
    )
    MODEL_NOT_FINITE = (
        110,
        "the friction model gave a torque that is not finite",
        "parameters that make the model unstable at this period",
        "check the model with `friction-hil models FILE --draw model.png`; identify again",
    )
    COMPUTATION_FAILED = (
        111,
        "the computation failed",
        "an error in this software",
        "report it with the message and the recording",
    )
    WARMING_FAILED = (
        112,
        "warming the caches failed",
        "an error in this software or in the driver",
        "report it with the message and the recording",
    )
    LOOP_LATE = (
        113,
        "the loop was late by N µs",
        "the computer was busy, or has no real-time scheduling",
        "`friction-hil doctor`; use a longer `period_s` or a larger `realtime.max_missed`",
    )
    NOT_ENABLED = (
        114,
        "not enabled within 5 s",
        "the drive waits for an input, its power stage or a brake",
        (
            "the message names the state of the drive, and its statusword 6041h with what it says: no voltage, not "
            "in remote control; see its manual. A drive that needs longer: `enable_timeout_s`"
        ),
    )
    NO_STANDSTILL = (
        115,
        "no standstill within 5 s of the quick stop",
        "the drive's quick stop deceleration is too low, or something moves the axis",
        "raise the drive's quick stop deceleration; check the brake",
    )
    STILL_POWERED = (
        116,
        "still powered 2 s after the request to disable, or after the stop",
        "the drive ignores the request, or another master enables it",
        "`friction-hil stop CONFIG`; else switch its power off; look for a second master",
    )
    EXCHANGE_FAILED = (
        117,
        "the exchange with the drives failed: the message of the bus or drive that failed",
        "adapter unplugged, bus down, drives gone",
        "follow the message; `friction-hil doctor FILE`",
    )
    DRIVER_MESSAGE = (
        118,
        "a message of the driver without a code of its own",
        "named in the message",
        "follow the message",
    )
    VELOCITY_CONTRADICTS = (
        119,
        "the drive reports a velocity of ..., but its position changes by ...",
        "frozen or slipping encoder, wrong unit of velocity or position",
        "check encoder and units; see the table before the first enable",
    )
    STATE_UNKNOWN = (
        120,
        "the state of the drive after the stop is unknown",
        "the drive did not answer after it was disabled",
        "assume that it has power; check supply and wires; `friction-hil stop CONFIG` says what it reads back",
    )
    VELOCITY_UNIT_WRONG = (
        123,
        (
            "the drive turns N times as fast as the unit of its velocity target says; the drive reports a velocity N "
            "times the derivative of its position"
        ),
        "the unit of the velocity target, or of the reported velocity, is not the assumed one",
        "set `velocity_unit` to the unit that the message names; compare the drive's manual",
    )
    AXIS_DOES_NOT_MOVE = (
        124,
        "the axis does not move although ... is demanded",
        "brake, blocked axis, torque limit in the drive, or a velocity unit much too small",
        "release the axis; check the drive's torque limit and `velocity_unit`",
    )
    WRONG_DIRECTION = (
        125,
        "the axis moves in the wrong direction",
        "encoder or motor of opposite sign in the drive, or a load that it does not hold",
        (
            "correct the sign in the drive; `is_inverted` inverts position, velocity and torque together and does "
            "not help"
        ),
    )
    PROGRAM_ERROR = (
        126,
        "program error: the exception and its place",
        "an error in this software or in a driver",
        "report it with the message and the recording or black box, which has the calls that led to it",
    )
    NO_MEMORY = (
        127,
        "there is no memory left",
        "the computer has no memory left, or the process reached its limit",
        ("end what takes the memory of this computer, or raise the limit of the process (`ulimit -v`, `MemoryMax=`)"),
    )
    TORQUE_LEFT = (
        128,
        "... may hold its last offset and not 0; torque_command stays ...; the drive may still hold its last ...",
        (
            "at the end of a run a serial line was gone, a drive did not take 0, or the drive beside a PLC was not "
            "heard or not Operational any more"
        ),
        ("write the object or register that the message names to 0 before anybody enables the drive, or switch it off"),
    )

    TAKEN_BACK = (
        129,
        "compensation makes the following error larger, ...: it is taken back",
        "the torque has the wrong sign, or the model is that of another axis; the run goes on without compensation",
        (
            "check the sign of the torque (`inverted_torque`, 607Eh), and whether the model is that of this axis; "
            "`enabled: true` by `friction-hil set` tries it again"
        ),
    )

    def __init__(self, number: int, message: str, cause: str, remedy: str) -> None:
        self.number = number
        self.explanation = Explanation(message, cause, remedy)

    @property
    def remedy(self) -> str:
        """What to do about it."""
        return self.explanation.remedy

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
