"""What drives on a CAN bus have in common, whether the daemon moves them or another controller does."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Protocol

from friction_hil.drive import Clock, Command, Drives, Feedback
from friction_hil_drivers.canopen.options import canopen_options
from friction_hil_drivers.canopen.wire.exclusive import AxisLock

if TYPE_CHECKING:
    import can

    from friction_hil.config import AxisConfig, Configuration
    from friction_hil_drivers.canopen.wire.frames import FrameBus


class Exchange(Protocol):
    """Frames of every cycle."""

    def start(self) -> None:
        """Begin the cyclic phase."""

    def receive(self, feedback: Sequence[Feedback], end_ns: int) -> None:
        """Collect the feedback of every drive; see `friction_hil.drive.Drives.receive`."""

    def send(self, commands: Sequence[Command]) -> None:
        """Send one command to each axis."""

    def warm_caches(self) -> None:
        """Decode and encode as in a cycle; nothing is sent."""


class BusDrives(Drives):
    """Drives of some axes on one bus; see `friction_hil.drive.Drives`."""

    def __init__(
        self,
        configuration: "Configuration",
        axes: "Mapping[str, AxisConfig]",
        clock: Clock,
        *,
        dry_run: bool,
        bus: "can.BusABC | None" = None,
    ) -> None:
        assert configuration.bus is not None  # the driver's options have checked it
        self._configuration, self._bus_config = configuration, configuration.bus
        self._configs = dict(axes)
        self._clock = clock
        self._dry_run = dry_run
        self._given_bus = bus
        self._bus: FrameBus | None = None
        self._locks: list[AxisLock] = []
        self._exchange: Exchange | None = None
        self._is_started = False
        self.leftovers: list[str] = []

    def _open_bus(self) -> "FrameBus":
        """Take a lock for each node, so that one daemon drives it, and open the bus."""
        # imported here: python-can takes 0.5 s, and reading a configuration does not need it
        from friction_hil_drivers.canopen.wire.bus import open_frame_bus

        nodes = {canopen_options(axis).node: name for name, axis in reversed(self._configs.items())}
        for node, name in nodes.items():
            self._locks.append(AxisLock(self._bus_config, node, name))
        self._bus = open_frame_bus(self._bus_config, self._given_bus)
        return self._bus

    def receive(self, feedback: Sequence[Feedback], end_ns: int) -> None:
        """Collect the feedback of every drive."""
        assert self._exchange is not None, "start first"
        self._exchange.receive(feedback, end_ns)

    def send(self, commands: Sequence[Command]) -> None:
        """Send one command to each axis."""
        assert self._exchange is not None, "start first"
        self._exchange.send(commands)

    def warm_caches(self) -> None:
        """Decode and encode as in a cycle, on a copy of the first axis."""
        assert self._exchange is not None, "start first"
        self._exchange.warm_caches()
