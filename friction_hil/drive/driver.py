"""Base classes of drivers: what the daemon and the commands call, with defaults for what a driver need not offer.

A driver is a class registered under the entry-point group ``friction_hil.drivers``. One instance serves all
axes of its kind on one bus, because they share each cycle on the bus: one SYNC, the feedback of every drive, the
command to every drive. The class that simulates the drives is registered under ``friction_hil.simulated_drives``
by the same name.
"""

import types
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from friction_hil.drive.inventory import Stop, StopReport
from friction_hil.drive.port import AxisFacts, Clock, Command, DriveState, Feedback

if TYPE_CHECKING:
    from pydantic import BaseModel

    from friction_hil.config import AxisConfig, BusConfig, Configuration
    from friction_hil.config.new_file import DriverKeys, Wanted
    from friction_hil.drive.codes import Explanation
    from friction_hil.drive.finding import Finding
    from friction_hil.drive.inventory import Inventory
    from friction_hil.drive.phase_lock import PhaseLock
    from friction_hil.errors import FrictionHilError
    from friction_hil.recordings import Recording


class Drives(ABC):
    """All drives of one driver on one bus, called from one thread.

    Order of calls: ``connect`` (blocking: identity, parameters, mapping, watchdogs), ``start`` (cyclic phase), then
    ``receive`` and ``send`` in each cycle, and ``close`` in any case. Between ``start`` and ``close`` no other
    thread may use the bus.
    """

    # another controller enables and moves the drives: the loop requests nothing (`Request.LISTEN`), and only the torque
    # of its commands is sent, as offset
    is_follower: bool = False
    is_passive: bool = False  # the feedback comes when another master asks for it
    phase_lock: "PhaseLock | None" = None  # in real time: the loop keeps the pace of the other controller
    remedies: ClassVar[Mapping[str, str]] = {}  # what to do about each code of the driver, for those who show faults
    leftovers: Sequence[str] = ()  # after `close`: what could not be left as it was found, which is exit status 1
    remarks: Sequence[str] = ()  # after `close`: what is not known of that

    @abstractmethod
    def connect(self) -> Sequence[AxisFacts]:
        """Configure every drive, in the order of the axes.

        Raises
        ------
        BusError, DriveError
            The bus does not open, no drive answers, or a drive does not match the configuration.
        """

    @abstractmethod
    def start(self) -> None:
        """Begin the cyclic phase."""

    @abstractmethod
    def receive(self, feedback: Sequence[Feedback], end_ns: int) -> None:
        """Start a cycle on the bus and fill ``feedback``; return when all has arrived, or when it is too late.

        Parameters
        ----------
        feedback : sequence of Feedback
        end_ns : int
            Time at which the next cycle begins; the driver decides how long before it is too late.
        """

    @abstractmethod
    def send(self, commands: Sequence[Command]) -> None:
        """Write one command to each axis."""

    @abstractmethod
    def warm_caches(self) -> None:
        """Run the code of a cycle in the spin before its deadline, to fill the processor's caches.

        Nothing is sent, and no feedback changes; what arrived since the last cycle may be processed.
        """

    @abstractmethod
    def close(self) -> Sequence[DriveState] | None:
        """Disable the drives and leave the bus. May be called at any time, also twice.

        Returns
        -------
        sequence of DriveState or None
            State of each drive as read back after the stop, `DriveState.UNKNOWN` where it was not. A state that is
            powered or unknown is a fault of the run. None: the driver reads nothing back; what counts then is the
            feedback of the last cycle.
        """


class Driver(Drives):
    """Class named by an entry point of ``friction_hil.drivers``; it needs `Options` and the methods of `Drives`."""

    Options: "ClassVar[type[BaseModel]]"  # keys of an axis that belong to the driver, perhaps with `OptionChecks`
    explanations: ClassVar["Mapping[str, Explanation]"] = {}  # of each code, for ``friction-hil explain``
    has_inventory: ClassVar[bool] = False  # set by `open_inventory`: that and `inventory_node` may be called

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        offering = (each for each in cls.__mro__ if each is not Driver and "open_inventory" in vars(each))
        cls.has_inventory = next(offering, None) is not None

    @abstractmethod
    def __init__(
        self, configuration: "Configuration", axes: "Mapping[str, AxisConfig]", clock: Clock, *, dry_run: bool
    ) -> None:
        """Take the axes; nothing is opened before `connect`."""

    @classmethod
    def drives_for(
        cls, configuration: "Configuration", axes: "Mapping[str, AxisConfig]", clock: Clock, *, dry_run: bool
    ) -> Drives:
        """Return the drives of some axes, which may be others where another controller moves them."""
        return cls(configuration, axes, clock, dry_run=dry_run)

    @classmethod
    def check_files(
        cls, configuration: "Configuration", axes: "Mapping[str, AxisConfig]"
    ) -> "Iterable[tuple[str, str, FrictionHilError]]":
        """Yield the errors in the files named by its keys as (axis, key, error); no port or bus is opened."""
        return ()

    @classmethod
    def check_bus(cls, config: "BusConfig") -> Iterable[tuple[str, str]]:
        """Yield what is wrong with the section ``bus`` of a configuration as (key, message); nothing is opened."""
        return ()

    @classmethod
    def new_keys(cls, wanted: "Wanted") -> "DriverKeys | None":
        """Return its keys in a new configuration; None: those that `Options` requires."""
        return None

    @classmethod
    def check_machine(cls, root: Path) -> "Iterable[Finding]":
        """Yield a finding for everything that its kind of drive needs of the machine, from the files below ``root``.

        ``root`` is ``/`` of a real machine. Drivers that need the same yield equal findings.
        """
        return ()

    @classmethod
    def check_connection(
        cls, configuration: "Configuration", axes: "Mapping[str, AxisConfig]"
    ) -> "Iterable[Finding] | None":
        """Yield a finding for each part of the connection that can be checked without writing to a drive.

        Not repeated is what `check_files` reports. Ports and buses opened for it are closed at once. None: it has none.
        """
        return None

    @classmethod
    def try_watchdogs(
        cls, configuration: "Configuration", axes: "Mapping[str, AxisConfig]", clock: Clock
    ) -> "Iterable[Finding] | None":
        """Let each watchdog of each drive lapse, without torque and at standstill, and yield what was seen to act.

        None: the driver cannot.
        """
        return None

    @classmethod
    def open_inventory(cls, config: "BusConfig", *, may_disturb: bool = False) -> "Inventory":
        """Open a bus for ``friction-hil drives``; ``may_disturb``: nodes that another master reads may be read."""
        raise NotImplementedError

    @classmethod
    def inventory_node(cls, axis: "AxisConfig") -> int:
        """Return the number under which the inventory finds the drive of an axis."""
        raise NotImplementedError

    @classmethod
    def stop_axes(cls, configuration: "Configuration", axes: "Mapping[str, AxisConfig]") -> StopReport:
        """Take the power of each drive, and return what was read back.

        Nothing is enabled, and a drive that does not answer does not keep the others from being stopped.
        """
        return not_stopped(axes, "its driver can only stop drives within a run: switch the drive off")

    @classmethod
    def reset_axes(cls, configuration: "Configuration", axes: "Mapping[str, AxisConfig]") -> StopReport:
        """Reset the fault of each drive, leave it without power, and return what was read back."""
        return not_stopped(axes, "its driver can only reset faults within a run: switch the drive off and on")

    @classmethod
    def read_bus_log(cls, path: Path, axes: "Mapping[str, AxisConfig]") -> "Sequence[Recording]":
        """Return recordings made from a log of CAN frames."""
        return ()


class SimulatedDriver(ABC):
    """Class named by an entry point of ``friction_hil.simulated_drives``."""

    Options: "ClassVar[type[BaseModel]]"  # keys of ``simulation`` of an axis
    # the drives advance together, so that axes may share a mechanism: their servos are those of
    # `friction_hil.config.simulation.simulated_servos`
    have_common_time: ClassVar[bool] = False

    @abstractmethod
    def __init__(self, configuration: "Configuration", axes: "Mapping[str, AxisConfig]", *, pace: Any) -> None:
        """Take the axes; nothing is opened yet."""

    @abstractmethod
    def open(self) -> str:
        """Open bus or lines; return axes, addresses and ports, as text."""

    @abstractmethod
    def run(self, is_stopping: Callable[[], bool]) -> None:
        """Serve the bus until ``is_stopping()`` is true."""

    @abstractmethod
    def close(self) -> None:
        """Leave the bus."""

    @classmethod
    def make_master(cls, configuration: "Configuration", axes: "Mapping[str, AxisConfig]", *, pace: Any) -> Any:
        """Return a stand-in for another controller (``simulate --master``); None: there is none."""
        return None

    @classmethod
    def make_private(cls, configuration: "Configuration", folder: Path) -> "tuple[Configuration, str] | None":
        """Return the configuration on a bus or lines that nothing else uses, and the name of what it replaces.

        Files of it are in ``folder``. None: ``run --simulate`` is not possible.
        """
        return None

    @classmethod
    def simulated_facts(cls, name: str, axis: "AxisConfig", period_s: float) -> AxisFacts | None:
        """Return the facts that the driver finds of such a drive, for simulations without a bus; None: unknown."""
        return None


class OptionChecks:
    """What `Driver.Options` may check besides each key; all mistakes are (axis, key, message)."""

    @classmethod
    def check(cls, axes: "Mapping[str, AxisConfig]", bus: "BusConfig | None") -> Iterable[tuple[str, str, str]]:
        """Yield mistakes that concern several axes, or the bus."""
        return ()

    @classmethod
    def check_timing(
        cls, axes: "Mapping[str, AxisConfig]", period_s: float, max_missed: int
    ) -> Iterable[tuple[str, str, str]]:
        """Yield mistakes that depend on the period."""
        return ()


def not_stopped(axes: Iterable[str], reason: str) -> StopReport:
    """Return the report on drives that nothing is known of."""
    unknown = DriveState.UNKNOWN
    return StopReport(tuple(Stop(None, unknown, unknown, "unknown", reason, name) for name in axes))


def with_defaults(given: type, base: type) -> type:
    """Return a class with what ``given`` lacks of ``base``: drivers of others need not be derived from it."""
    if issubclass(given, base):
        return given
    return types.new_class(given.__name__, (given, base), None, lambda names: names.update(__module__=given.__module__))
