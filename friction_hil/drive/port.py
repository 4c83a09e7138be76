"""Data that pass between the daemon and the drivers in each cycle, and the clock."""

import math
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Protocol

from friction_hil.drive.unit_row import UnitRow


class Mode(IntEnum):
    """Cyclic synchronous modes of operation, numbered as in CiA 402 object 6060h."""

    CSP = 8
    CSV = 9
    CST = 10


class DriveState(IntEnum):
    """State of a drive, in the terms of CiA 402."""

    UNKNOWN = 0
    NOT_READY = 1
    SWITCH_ON_DISABLED = 2
    READY_TO_SWITCH_ON = 3
    SWITCHED_ON = 4
    OPERATION_ENABLED = 5
    QUICK_STOP_ACTIVE = 6
    FAULT_REACTION_ACTIVE = 7
    FAULT = 8

    @property
    def is_powered(self) -> bool:
        """True if the power stage may produce torque."""
        return self in (self.OPERATION_ENABLED, self.QUICK_STOP_ACTIVE, self.FAULT_REACTION_ACTIVE)

    @property
    def is_unpowered(self) -> bool:
        """True for a state that is known, and in which the drive gives no torque."""
        return self is not DriveState.UNKNOWN and not self.is_powered

    @property
    def words(self) -> str:
        """Name of the state for messages: ``switch on disabled``."""
        return self.name.lower().replace("_", " ")


class Request(IntEnum):
    """State that the loop requests; the driver takes the drive there, one step per cycle."""

    LISTEN = 0  # never write anything
    DISABLE = 1
    ENABLE = 2
    QUICK_STOP = 3
    RESET_FAULT = 4  # only on the user's explicit request; ends in the state of DISABLE


@dataclass(slots=True)
class Feedback:
    """Feedback of a drive in this cycle, SI. One object per axis, overwritten each cycle."""

    position: float = 0.0
    velocity: float = 0.0
    torque: float = 0.0
    state: DriveState = DriveState.UNKNOWN
    is_fresh: bool = False  # every frame of this cycle arrived in time
    error: str = ""  # last error code of the drive, in words
    # fault beside the state: a lost heartbeat, a reboot, an emergency; without a code, FH-2xx, it gets FH-118
    message: str = ""
    missing: str = ""  # reason why nothing fresh came, if the driver knows it
    # False: cyclic commands do not reach the drive any more (node rebooted, lost, not Operational)
    is_reachable: bool = True
    # the command of the cycle before was not sent, or the drive cannot have taken it over: it keeps an earlier one. The
    # path then waits for it, and the torque goes on from what the drive may have
    is_setpoint_lost: bool = False
    notices: list[str] = field(default_factory=list)  # to be recorded and shown; the loop empties it
    # of drives that another controller moves (`Drives.is_follower`)
    # the drive's demand after `AxisFacts.setpoint_delay_s`; NaN where none has come since the cycle before
    position_demand: float = math.nan
    is_offset_wanted: bool = True  # mode and controlword are such that a torque offset compensates friction
    temperature: float = math.nan  # deg C, the last one read; NaN where none is measured
    load_position: float = math.nan  # by an encoder at the load, rad or m of the axis; NaN where there is none
    status: str = ""  # statusword of a drive that is not enabled, with what it says beside the state, in words

    @property
    def reason(self) -> str:
        """What the drive says beside its state, in brackets after a space; empty for nothing."""
        said = "; ".join(filter(None, (self.status if self.is_fresh else "", self.error)))
        return f" ({said})" if said else ""


@dataclass(slots=True)
class Command:
    """Command to a drive, SI. One object per axis, overwritten each cycle."""

    request: Request = Request.LISTEN
    position: float = 0.0  # CSP
    velocity: float = 0.0  # CSV
    torque: float = 0.0  # CST: total torque; CSP and CSV: torque offset, added by the drive
    # CSP and CSV, where `AxisFacts.takes_velocity_offset`: added by the drive to the demand of its velocity loop
    velocity_offset: float = 0.0


@dataclass(frozen=True, slots=True)
class AxisFacts:
    """Properties of a drive that the driver found while connecting; recorded, so that replay uses the same.

    The driver states the delays, from its protocol and from measurements while connecting. On a bus paced by SYNC there
    is nothing to measure: the drive samples at SYNC k, takes the command of that cycle at SYNC k + 1 and holds it for a
    period. When the frames went in between does not matter, because the loop sends SYNC k + 1 after that command. An
    exchange longer than the period makes SYNC late by whole cycles, and the loop reports it. Where a command acts when
    it arrives, as on a serial line, the driver measures the duration of an exchange.

    Attributes
    ----------
    name : str
        Name of the axis.
    identity : str
        Vendor, product, serial number, for the user.
    position_resolution, torque_resolution : float
        Smallest step of the position feedback and of the torque command, SI.
    setpoint_delay_s : float
        Time from sending a set-point until the drive's demand equals it; where another controller moves the drive,
        from the sampling of the position until the drive's demand equals `Feedback.position_demand`.
    actuation_delay_s : float
        Time from the sampling of the position to the middle of the time for which the drive holds the torque that
        the loop computed from it.
    notes : tuple of str
        Notes for the user, e.g. which watchdog is armed.
    torque_delay_s : float, optional
        Mean age of the torque of a cycle's feedback relative to the position; None: the drive reports no torque.
    velocity_resolution : float
        Smallest step of a velocity target, SI: in mode CSV the daemon begins with steps of it, to see that its unit is
        right. 0: not known, and not examined.
    units : tuple of UnitRow
        Units of the drive, for the table before anything is enabled.
    has_load_encoder : bool
        `Feedback.load_position` is filled.
    setpoint_age_s : float, optional
        Part of the key ``setpoint_delay_cycles`` that has passed when `Feedback.position_demand` is heard; None: that
        is the drive's own demand, which no key delays.
    takes_torque : bool
        False: the drive has nothing by which it is compensated in this mode, neither a torque offset nor, where the
        configuration asks for that one, a velocity offset.
    takes_velocity_offset : bool
        `Command.velocity_offset` reaches the drive, in place of `Command.torque`.
    """

    name: str
    identity: str
    position_resolution: float
    torque_resolution: float
    setpoint_delay_s: float
    actuation_delay_s: float
    notes: tuple[str, ...] = field(default=())
    torque_delay_s: float | None = 0.0
    velocity_resolution: float = 0.0
    units: tuple[UnitRow, ...] = ()
    has_load_encoder: bool = False
    takes_torque: bool = True
    setpoint_age_s: float | None = 0.0
    takes_velocity_offset: bool = False


class Clock(Protocol):
    """Clock of the loop. ``RealClock`` waits; ``SteppedClock`` advances on request (``--pace sync``)."""

    is_real: bool

    def now_ns(self) -> int:
        """Monotonic time in nanoseconds."""
        ...

    def doze_until(self, deadline_ns: int) -> bool:
        """Sleep until shortly before ``deadline_ns``; return True if there is time left before it."""
        ...

    def sleep_until(self, deadline_ns: int) -> None:
        """Return at ``deadline_ns``, or at once when it has passed."""
        ...
