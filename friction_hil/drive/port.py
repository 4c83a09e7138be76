"""The drive port: the interface between the daemon and the drivers.

A driver is a class registered under the entry-point group ``friction_hil.drivers``. One instance serves all
axes of its kind on one bus, because a cycle on a bus is shared: one SYNC, every drive's feedback, every
drive's command. The counterpart that imitates the drives is registered under
``friction_hil.simulated_drives`` by the same name.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from typing import TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:
    from pydantic import BaseModel

    from friction_hil.config import AxisConfig, Configuration


class Mode(IntEnum):
    """Cyclic synchronous modes of operation, numbered as in CiA 402 object 6060h."""

    CSP = 8
    CSV = 9
    CST = 10


class DriveState(IntEnum):
    """What a drive does with its power stage, in the terms of CiA 402."""

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
        """Whether the power stage may produce torque."""
        return self in (self.OPERATION_ENABLED, self.QUICK_STOP_ACTIVE, self.FAULT_REACTION_ACTIVE)

    @property
    def words(self) -> str:
        """Its name as it stands in a sentence: ``switch on disabled``."""
        return self.name.lower().replace("_", " ")


class Request(IntEnum):
    """What the loop wants a drive to be; the driver finds the way there, one step a cycle."""

    LISTEN = 0  # never write anything
    DISABLE = 1
    ENABLE = 2
    QUICK_STOP = 3
    RESET_FAULT = 4  # only on the user's explicit word; ends where DISABLE does


@dataclass(slots=True)
class Feedback:
    """What a drive said in this cycle, SI. One object an axis, overwritten each cycle."""

    position: float = 0.0
    velocity: float = 0.0
    torque: float = 0.0
    state: DriveState = DriveState.UNKNOWN
    is_fresh: bool = False  # every frame of this cycle arrived in time
    error: str = ""  # the drive's own error code in words, as last heard
    message: str = ""  # what is wrong beside the state: a lost heartbeat, a reboot, an emergency
    missing: str = ""  # why nothing fresh came, where the driver knows


@dataclass(slots=True)
class Command:
    """What to write to a drive, SI. One object an axis, overwritten each cycle."""

    request: Request = Request.LISTEN
    position: float = 0.0  # CSP
    velocity: float = 0.0  # CSV
    torque: float = 0.0  # CST: the whole torque; CSP and CSV: torque offset, added by the drive


@dataclass(frozen=True, slots=True)
class AxisFacts:
    """What the driver learned about a drive while connecting; recorded, so that replay computes with the same.

    The delays are the driver's to state, from its protocol and from what it measured while connecting. On a bus paced
    by SYNC nothing is left to measure: the drive samples at SYNC k, takes the command of that cycle at SYNC k + 1
    and holds it for a period, whenever in between the frames went, for the loop sends SYNC k + 1 after that command.
    An exchange that outlasts the period makes SYNC late, by whole cycles, and the loop says so. Where a command acts
    when it arrives, as on a serial line, the driver measures how long an exchange takes.

    Attributes
    ----------
    name : str
        Of the axis.
    identity : str
        For people: vendor, product, serial number.
    position_resolution, torque_resolution : float
        Smallest step of the position feedback and of the torque command, SI.
    setpoint_delay_s : float
        From sending a set-point to the drive's demand being equal to it.
    actuation_delay_s : float
        From the drive's sampling its position to the middle of the time for which it holds the torque that the loop
        computed from that.
    notes : tuple of str
        What the user should know, e.g. which watchdog is armed.
    torque_delay_s : float, optional
        How much older the torque of a cycle's feedback is than the position, on average; None: the drive tells none.
    """

    name: str
    identity: str
    position_resolution: float
    torque_resolution: float
    setpoint_delay_s: float
    actuation_delay_s: float
    notes: tuple[str, ...] = field(default=())
    torque_delay_s: float | None = 0.0


class Clock(Protocol):
    """Time for the loop. ``RealClock`` waits; ``SteppedClock`` advances when asked (``--pace sync``)."""

    is_real: bool

    def now_ns(self) -> int:
        """Monotonic time in nanoseconds."""
        ...

    def doze_until(self, deadline_ns: int) -> bool:
        """Sleep until shortly before ``deadline_ns``; whether there is time left to get ready."""
        ...

    def sleep_until(self, deadline_ns: int) -> None:
        """Return at ``deadline_ns``, or at once when it has passed."""
        ...


class Drives(Protocol):
    """All drives of one driver on one bus, driven from one thread.

    Life: ``connect`` (blocking: identity, parameters, mapping, watchdogs), ``start`` (cyclic phase), then for
    each cycle ``receive`` and ``send``, and ``close`` whatever happened. Between ``start`` and ``close``
    nothing but the calling thread may touch the bus.
    """

    def connect(self) -> Sequence[AxisFacts]:
        """Configure every drive, in the order of the axes.

        Raises
        ------
        BusError, DriveError
            The bus does not open, nobody answers, or a drive is not what the configuration says.
        """
        ...

    def start(self) -> None:
        """Begin the cyclic phase."""
        ...

    def receive(self, feedback: Sequence[Feedback], end_ns: int) -> None:
        """Start a cycle on the bus and fill ``feedback``; return when all arrived, or when it is too late for it.

        Parameters
        ----------
        feedback : sequence of Feedback
        end_ns : int
            When the next cycle begins; how long before that is too late the driver knows.
        """
        ...

    def send(self, commands: Sequence[Command]) -> None:
        """Write one command an axis."""
        ...

    def warm_caches(self) -> None:
        """Bring the code of a cycle into the caches, in the spin before its deadline.

        Nothing is sent, and no feedback changes; what came since the cycle before may be taken in.
        """
        ...

    def close(self) -> None:
        """Leave the bus. Safe to call at any time, also twice."""
        ...


class Driver(Protocol):
    """The class that an entry point of ``friction_hil.drivers`` names.

    It may have these classmethods:

    ``check_files(configuration, axes)``
        Yields what is wrong with the files that its keys name, and with what can be known from them, as (axis, key,
        error); nothing is opened for that.
    ``check_machine(root)``
        Yields a `friction_hil.drive.Finding` for all that its kind of drive needs of a machine, as the files below
        ``root`` (a Path, of a real machine ``/``) tell it. Drivers that need the same yield equal ones.
    ``check_connection(configuration, axes)``
        Yields a Finding for each thing between the daemon and its drives: what can be told without a byte to them.
        What ``check_files`` tells is not told again. Ports and buses that are opened for it are given back at once.
    """

    Options: "type[BaseModel]"  # the keys of an axis that are the driver's own

    def __call__(
        self, configuration: "Configuration", axes: "Mapping[str, AxisConfig]", clock: Clock, *, dry_run: bool
    ) -> Drives:
        """Make the drives of ``axes``, none of them connected yet."""
        ...


class SimulatedDriver(Protocol):
    """The class that an entry point of ``friction_hil.simulated_drives`` names."""

    Options: "type[BaseModel]"  # the keys of an axis's ``simulation``

    def __call__(self, configuration: "Configuration", axes: "Mapping[str, AxisConfig]", *, pace: str) -> Any:
        """Make simulated drives; ``run(is_stopping)`` serves the bus until ``is_stopping()`` is true."""
        ...
