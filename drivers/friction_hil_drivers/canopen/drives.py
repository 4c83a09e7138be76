"""CiA 402 drives on one CAN bus, as the daemon's drive port has them.

While connecting, a thread of the canopen library reads the bus for its SDO client. That thread has ended before the
cyclic phase begins: a second busy thread would delay wake-ups by up to 5 ms. From then on `exchange` alone reads and
writes the bus.
"""

import contextlib
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from friction_hil.drive import AxisFacts, Clock, Command, Feedback, Mode
from friction_hil.drive.finding import Finding, failure
from friction_hil.errors import BusError, DriveError, FrictionHilError, UsageError
from friction_hil_drivers.canopen import codes, interfaces, objects
from friction_hil_drivers.canopen.axis import CanopenAxis
from friction_hil_drivers.canopen.checks import check_connection
from friction_hil_drivers.canopen.configure import ConfiguredDrive, configure
from friction_hil_drivers.canopen.eds import load_eds
from friction_hil_drivers.canopen.eds_check import compare_eds
from friction_hil_drivers.canopen.exchange import CyclicExchange
from friction_hil_drivers.canopen.exclusive import AxisLock
from friction_hil_drivers.canopen.interfaces import bus_name
from friction_hil_drivers.canopen.mapping import check_bus_load
from friction_hil_drivers.canopen.options import CanopenOptions, canopen_options
from friction_hil_drivers.canopen.sidecar import SidecarDrives
from friction_hil_drivers.canopen.watchdog_times import WatchdogTimes
from friction_hil_drivers.canopen.watchdogs import watchdog_pdos
from friction_hil_drivers.cia402 import profile

if TYPE_CHECKING:
    import can

    from friction_hil.config import AxisConfig, BusConfig, Configuration
    from friction_hil.recordings import Recording
    from friction_hil_drivers.canopen.frames import FrameBus
    from friction_hil_drivers.canopen.inventory import CanopenInventory
    from friction_hil_drivers.canopen.sdo import SdoClient, SdoNetwork

_LISTEN_S = 0.1


class CanopenDrives:
    """Drives of some axes on one bus; see `friction_hil.drive.Drives`."""

    Options = CanopenOptions
    check_machine = staticmethod(interfaces.check_machine)
    check_connection = staticmethod(check_connection)

    @classmethod
    def check_files(
        cls, configuration: "Configuration", axes: "Mapping[str, AxisConfig]"
    ) -> Iterator[tuple[str, str, FrictionHilError]]:
        """Read the EDS of each axis and compare it with the mode; see `friction_hil.drive.Driver`."""
        for name, axis in axes.items():
            options = canopen_options(axis)
            try:
                reasons = () if options.eds is None else _compare_eds(options.eds, axis)
            except UsageError as error:
                yield name, "eds", error
                continue
            for reason in reasons:
                yield name, "eds", UsageError(f"{options.eds} {reason}")

    @staticmethod
    def open_inventory(config: "BusConfig") -> "CanopenInventory":
        """Open a bus to find, show or stop its drives; see `friction_hil.drive.Driver`."""
        # imported here: python-can takes 0.5 s, and reading a configuration does not need it
        from friction_hil_drivers.canopen.bus import open_frame_bus
        from friction_hil_drivers.canopen.inventory import CanopenInventory

        return CanopenInventory(config, open_frame_bus(config))

    @staticmethod
    def inventory_node(axis: "AxisConfig") -> int:
        """Return the number of an axis's node."""
        return canopen_options(axis).node

    @staticmethod
    def read_bus_log(path: Path, axes: "Mapping[str, AxisConfig]") -> "list[Recording]":
        """Decode a log of CAN frames; see `bus_log.read_bus_log`."""
        # imported here: python-can takes 0.5 s, and only commands that read a log need it
        from friction_hil_drivers.canopen.bus_log import read_bus_log

        return read_bus_log(path, axes)

    @classmethod
    def try_watchdogs(
        cls, configuration: "Configuration", axes: "Mapping[str, AxisConfig]", clock: Clock
    ) -> Iterator[Finding]:
        """Let each watchdog of each drive lapse, one at a time; see `friction_hil.drive.Driver`."""
        if configuration.bus is not None and configuration.bus.role == "sidecar":
            detail = "with bus.role: sidecar the drives are another controller's: their watchdogs are not tried"
            yield Finding("watchdogs", "fail", detail, "leave --try-watchdog out", "FH-445")
            return
        for name, axis in axes.items():
            # one after the other: all drives on the bus would miss the daemon's heartbeat
            drives = cls(configuration, {name: axis}, clock, dry_run=False)
            try:
                drives.connect()
                yield from drives._try_watchdogs(name)
            except FrictionHilError as error:
                yield failure(f"{name}: watchdogs", error, "FH-445")
            finally:
                drives.close()

    def _try_watchdogs(self, name: str) -> Iterator[Finding]:
        # imported here: python-can takes 0.5 s, and reading a configuration does not need it
        from friction_hil_drivers.canopen.watchdog_trial import WatchdogTrial

        [axis], options = self._axes, canopen_options(self._configs[name])
        if not axis.watch.means:
            detail = "the drive does not watch the daemon: if the daemon dies, its last torque stays"
            yield Finding(f"{name}: watchdogs", "fail", detail, "see friction-hil run with --dry-run", "FH-444")
            return
        assert self._bus is not None
        assert self._network is not None
        self._is_started = True
        trial = WatchdogTrial(
            self._bus,
            self._network,
            self._clients[name],
            axis,
            master_node=options.master_node,
            heartbeat_ms=self._times(options).heartbeat_ms,
        )
        yield from trial.run()

    def __new__(cls, configuration: "Configuration", *arguments: Any, **options: Any) -> Any:
        """Return the drives, or where another controller moves them (``bus.role: sidecar``) those of a sidecar."""
        if configuration.bus is not None and configuration.bus.role == "sidecar":
            return SidecarDrives(configuration, *arguments, **options)
        return super().__new__(cls)

    def __init__(
        self,
        configuration: "Configuration",
        axes: "Mapping[str, AxisConfig]",
        clock: Clock,
        *,
        dry_run: bool,
        bus: "can.BusABC | None" = None,
    ) -> None:
        self._configuration = configuration
        self._configs = dict(axes)
        self._clock = clock
        self._dry_run = dry_run
        self._given_bus = bus
        self._bus: FrameBus | None = None
        self._network: SdoNetwork | None = None
        self._locks: list[AxisLock] = []
        self._clients: dict[str, SdoClient] = {}
        self._axes: list[CanopenAxis] = []
        self._identifiers: set[int] = set()  # of all PDOs in use
        self._exchange: CyclicExchange | None = None
        self._is_started = False

    # Connecting

    def connect(self) -> Sequence[AxisFacts]:
        """Configure every drive; nothing is enabled. See `friction_hil.drive.Drives.connect`."""
        # imported here: python-can and canopen take 0.5 s each, and reading a configuration needs neither
        from friction_hil_drivers.canopen.bus import open_frame_bus
        from friction_hil_drivers.canopen.sdo import SdoNetwork

        config = self._configuration.bus
        assert config is not None  # the driver's options have checked it
        for axis in self._configs.values():
            _read_eds(axis)  # an invalid file is found before any drive is configured
        owners = {canopen_options(axis).node: name for name, axis in reversed(self._configs.items())}
        for node, name in owners.items():
            self._locks.append(AxisLock(config, node, name))
        self._bus = open_frame_bus(config, self._given_bus)
        _refuse_second_master(self._bus, bus_name(config))
        self._network = SdoNetwork(self._bus)
        with self._network.reading():
            for name, axis in self._configs.items():
                self._axes.append(self._connect_axis(self._network, name, axis))
        if config.bitrate is not None:
            pdos = [pdo for axis in self._axes for pdo in axis.pdos]
            pdos += watchdog_pdos(axis.watch.feed_cycles for axis in self._axes if axis.watch.rpdo_id)
            check_bus_load(config.bitrate, self._configuration.period_s, pdos)
        self._exchange = self._make_exchange(self._bus)
        return [axis.facts for axis in self._axes]

    def _connect_axis(self, network: "SdoNetwork", name: str, config: "AxisConfig") -> CanopenAxis:
        options = canopen_options(config)
        assert self._configuration.bus is not None
        where = f"node {options.node} on {bus_name(self._configuration.bus)}"
        client = self._clients[name] = network.client(options.node, name, where)
        client.axis_number = options.axis_number
        if not self._dry_run:
            # a drive in Operational may refuse new mappings; a dry run must not stop a drive that another master runs
            self._write_nmt(objects.NmtCommand.ENTER_PRE_OPERATIONAL, options.node)
        times, period_s = self._times(options), self._configuration.period_s
        drive = configure(client, name, config, period_s, times, dry_run=self._dry_run, taken=self._identifiers)
        drive = _with_notes(drive, client.notes)
        return CanopenAxis(drive, options.node, 1e-3 * times.heartbeat_ms)

    def _times(self, options: CanopenOptions) -> WatchdogTimes:
        return options.times(self._configuration.period_s, self._configuration.realtime.max_missed)

    def _make_exchange(self, bus: "FrameBus") -> CyclicExchange:
        options = [canopen_options(axis) for axis in self._configs.values()]
        return CyclicExchange(
            bus,
            self._axes,
            self._clock,
            period_s=self._configuration.period_s,
            heartbeat_s=1e-3 * min(self._times(option).heartbeat_ms for option in options),
            master_node=options[0].master_node,
            dry_run=self._dry_run,
            max_missed=self._configuration.realtime.max_missed,
        )

    # The cyclic phase

    def start(self) -> None:
        """Switch the nodes to Operational and begin the cyclic phase."""
        if self._exchange is None:
            raise BusError("the bus is not open: connect first")
        self._is_started = True
        for axis in self._axes:
            self._write_nmt(objects.NmtCommand.START, axis.node)
        self._exchange.start()

    def receive(self, feedback: Sequence[Feedback], end_ns: int) -> None:
        """Send SYNC and collect the feedback of every drive; see `exchange.CyclicExchange.receive`."""
        assert self._exchange is not None, "start first"
        self._exchange.receive(feedback, end_ns)

    def send(self, commands: Sequence[Command]) -> None:
        """Send one command to each axis; see `exchange.CyclicExchange.send`."""
        assert self._exchange is not None, "start first"
        self._exchange.send(commands)

    def warm_caches(self) -> None:
        """Decode and encode as in a cycle, on a copy of the first axis; see `friction_hil.drive.Drives.warm_caches`."""
        assert self._exchange is not None, "start first"
        self._exchange.warm_caches()

    # Leaving

    def close(self) -> None:
        """Take the nodes out of Operational, so that no old command stays in force, and leave the bus."""
        if self._bus is not None:
            try:
                if self._is_started and not self._dry_run:
                    self._switch_off()
            finally:
                bus, self._bus = self._bus, None
                bus.close()
        for lock in self._locks:
            lock.release()

    def _switch_off(self) -> None:
        """Stop the exchange of PDOs, disable every drive, and end the watch of those that have no power any more."""
        for axis in self._axes:
            self._write_nmt(objects.NmtCommand.ENTER_PRE_OPERATIONAL, axis.node)
        assert self._network is not None
        with self._network.reading():
            for client in self._clients.values():
                # a drive that does not answer, or keeps its power, goes on watching: it trips when the daemon is silent
                with contextlib.suppress(DriveError):
                    # the last RPDO would take effect at the next SYNC, which is not sent any more; this does at once
                    client.write(objects.CONTROLWORD, profile.DISABLE_VOLTAGE)
                    if not profile.drive_state(client.read(objects.STATUSWORD)).is_powered:
                        client.try_write(objects.CONSUMER_HEARTBEAT, 0)

    def _write_nmt(self, command: objects.NmtCommand, node: int) -> None:
        if self._bus is None:
            raise BusError("the bus is not open: connect first")
        self._bus.send(objects.NMT_ID, bytes((command, node)))


def _with_notes(drive: ConfiguredDrive, notes: Sequence[str]) -> ConfiguredDrive:
    """Return the drive with further notes for the user."""
    further = tuple(note for note in notes if note not in drive.facts.notes)
    return replace(drive, facts=replace(drive.facts, notes=drive.facts.notes + further))


def _refuse_second_master(bus: "FrameBus", name: str) -> None:
    """Listen for SYNC of another master, which may run on another machine.

    Raises
    ------
    DriveError
        There is one.
    """
    end = time.monotonic() + _LISTEN_S
    while (left := end - time.monotonic()) > 0.0:
        frame = bus.receive(left)
        if frame is not None and frame[0] == objects.SYNC_ID:
            text = f"another master sends SYNC on {name}: two daemons must not drive one bus"
            raise DriveError(text, code=codes.SECOND_MASTER)


def _read_eds(axis: "AxisConfig") -> None:
    options = canopen_options(axis)
    if options.eds is not None:
        load_eds(options.eds, options.node)


def _compare_eds(path: Path, axis: "AxisConfig") -> list[str]:
    """Return the reasons for which a drive with this EDS cannot be driven as configured."""
    options = canopen_options(axis)
    mode = Mode[axis.mode.upper()]
    dictionary = load_eds(path, options.node)
    return list(compare_eds(dictionary, mode, options, is_compensated=axis.compensation.enabled))
