"""CiA 402 drives on one CAN bus: connecting through the canopen library, then raw frames in the cyclic phase.

While connecting, the canopen library's own thread reads the bus for its SDO client. That thread is gone before
the cyclic phase begins: a second busy thread would cost 5 ms wake-ups. From then on this module alone reads
and writes the bus, with frames packed by precompiled `struct`.
"""

import contextlib
import time
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from friction_hil.drive import AxisFacts, Clock, Command, Feedback, Request
from friction_hil.errors import BusError, DriveError, FrictionHilError, UsageError
from friction_hil_drivers.canopen import interfaces, objects
from friction_hil_drivers.canopen.axis import CanopenAxis, Handler
from friction_hil_drivers.canopen.bus import bus_name, open_bus
from friction_hil_drivers.canopen.bus_log import read_bus_log
from friction_hil_drivers.canopen.checks import check_connection
from friction_hil_drivers.canopen.configure import configure
from friction_hil_drivers.canopen.eds import load_eds
from friction_hil_drivers.canopen.exclusive import AxisLock
from friction_hil_drivers.canopen.frames import Frame, FrameBus, frame_bus
from friction_hil_drivers.canopen.mapping import check_bus_load
from friction_hil_drivers.canopen.options import CanopenOptions
from friction_hil_drivers.canopen.sdo import ObjectAccess
from friction_hil_drivers.cia402 import profile

if TYPE_CHECKING:
    import can

    from friction_hil.config import AxisConfig, Configuration

_LISTEN_S = 0.1
_COMMAND_SHARE = 0.25  # of a period is left for computing and sending what acts from the next SYNC on
_STEPPED_TIMEOUT_S = 10.0
_STEPPED_TIMEOUTS = 3  # in a row; in simulated time nothing else would ever end a run without drives
_NOTIFIER_TIMEOUT_S = 0.02
_OPERATIONAL = bytes([objects.NmtState.OPERATIONAL])


class CanopenDrives:
    """The drives of some axes, as the loop needs them; see `friction_hil.drive.Drives`."""

    Options = CanopenOptions
    read_bus_log = staticmethod(read_bus_log)

    @classmethod
    def check_files(
        cls, configuration: "Configuration", axes: "Mapping[str, AxisConfig]"
    ) -> Iterator[tuple[str, str, FrictionHilError]]:
        """Read the EDS of each axis; see `friction_hil.drive.Driver`."""
        for name, axis in axes.items():
            options = axis.options
            assert isinstance(options, CanopenOptions)
            if options.eds is not None:
                try:
                    load_eds(options.eds, options.node)
                except UsageError as error:
                    yield name, "eds", error

    check_machine = staticmethod(interfaces.check_machine)
    check_connection = staticmethod(check_connection)

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
        self._network: Any = None
        self._locks: list[AxisLock] = []
        self._accesses: dict[str, ObjectAccess] = {}
        self._axes: list[CanopenAxis] = []
        self._double: CanopenAxis | None = None
        self._double_feedback, self._double_command = Feedback(), Command(Request.ENABLE)
        self._handlers: dict[int, Handler] = {}
        self._heartbeat_id = 0  # 0 before the cyclic phase
        self._heartbeat_ns = 0
        self._next_heartbeat_ns = 0
        self._timeouts = 0

    def connect(self) -> Sequence[AxisFacts]:
        """Configure every drive; nothing is enabled. See `friction_hil.drive.Drives.connect`."""
        import canopen

        config = self._configuration.bus
        assert config is not None  # the driver's options have checked it
        for axis in self._configs.values():
            if (eds := _options(axis).eds) is not None:
                load_eds(eds, _options(axis).node)  # a file that is none is found before any drive is touched
        for name, axis in self._configs.items():
            self._locks.append(AxisLock(config, _options(axis).node, name))
        name = bus_name(config)
        self._bus = frame_bus(self._given_bus or open_bus(config), config, name)
        self._refuse_second_master(name)

        self._network = canopen.Network(self._bus.bus)
        with self._reading():
            for name, axis in self._configs.items():
                self._axes.append(self._connect_axis(name, axis))
            self._double = self._axes[0].double()
        if config.bitrate is not None:
            pdos = [pdo for axis in self._axes for pdo in axis.pdos]
            check_bus_load(config.bitrate, self._configuration.period_s, pdos)
        return [axis.facts for axis in self._axes]

    def _connect_axis(self, name: str, config: "AxisConfig") -> CanopenAxis:
        options = _options(config)
        assert self._configuration.bus is not None
        node = self._network.add_node(options.node, object_dictionary=None)
        access = self._accesses[name] = ObjectAccess(
            node, name, f"node {options.node} on {bus_name(self._configuration.bus)}"
        )
        if not self._dry_run:
            # a drive in Operational may refuse new mappings; a listener must not stop somebody else's axis
            self._write_nmt(objects.NmtCommand.ENTER_PRE_OPERATIONAL, options.node)
        drive = configure(access, name, config, self._configuration.period_s, dry_run=self._dry_run)
        return CanopenAxis(drive, options.node, options.heartbeat_s)

    def _refuse_second_master(self, name: str) -> None:
        """Listen for another master's SYNC, which a lock on this machine cannot tell of."""
        end = time.monotonic() + _LISTEN_S
        while (left := end - time.monotonic()) > 0.0:
            frame = self._open_bus.receive(left)
            if frame is not None and frame[0] == objects.SYNC_ID:
                raise DriveError(f"another master sends SYNC on {name}: two daemons must not drive one bus")

    def start(self) -> None:
        """Switch the nodes to Operational and begin the cyclic phase."""
        options = [_options(axis) for axis in self._configs.values()]
        self._heartbeat_id = objects.HEARTBEAT_BASE + options[0].master_node
        self._heartbeat_ns = round(min(option.heartbeat_s for option in options) * 1e9)
        for axis in self._axes:
            self._handlers.update(axis.handlers)
            self._write_nmt(objects.NmtCommand.START, axis.node)
        now = self._clock.now_ns()
        for axis in self._axes:
            axis.begin(now)
        self._beat(now)

    def receive(self, feedback: Sequence[Feedback], end_ns: int) -> None:
        """Send SYNC and collect the feedback of every drive until it is complete, or too late for this cycle."""
        deadline_ns = end_ns - round(_COMMAND_SHARE * self._configuration.period_s * 1e9)
        clock, axes, bus = self._clock, self._axes, self._open_bus
        while (frame := bus.receive(0.0)) is not None:
            self._dispatch(frame)
        now = clock.now_ns()
        missing = 0
        for axis in axes:
            missing += axis.expect(now)
        bus.send(objects.SYNC_ID, b"")
        while missing:
            timeout = (deadline_ns - clock.now_ns()) * 1e-9 if clock.is_real else _STEPPED_TIMEOUT_S
            if timeout <= 0.0:
                break
            if (frame := bus.receive(timeout)) is not None:
                missing -= self._dispatch(frame)
            elif not clock.is_real:
                break
        self._timeouts = self._timeouts + 1 if missing and not clock.is_real else 0
        if self._timeouts >= _STEPPED_TIMEOUTS:
            waited_s = _STEPPED_TIMEOUTS * _STEPPED_TIMEOUT_S
            raise DriveError(f"not every drive has answered SYNC for {waited_s:g} s: do they still run?")
        for axis, target in zip(axes, feedback, strict=True):
            axis.fill(target, now)

    def send(self, commands: Sequence[Command]) -> None:
        """Write one command an axis; a dry run writes nothing."""
        if not self._dry_run:
            for axis, command in zip(self._axes, commands, strict=True):
                if command.request is not Request.LISTEN:
                    self._open_bus.send(*axis.command_frame(command))
        now = self._clock.now_ns()
        if now >= self._next_heartbeat_ns:
            self._beat(now)

    def rehearse(self) -> None:
        """Decode and encode as in a cycle, on a copy of the first axis; see `friction_hil.drive.Drives.rehearse`."""
        axis = self._double
        if axis is not None:
            for tpdo in axis.tpdos:
                axis.handlers[tpdo.cob_id](bytes(tpdo.layout.size))
            axis.fill(self._double_feedback, self._next_heartbeat_ns)
            if not self._dry_run:
                axis.command_frame(self._double_command)
            axis.expect(self._next_heartbeat_ns)

    def _beat(self, now: int) -> None:
        """Send the daemon's heartbeat, by which the drives watch it."""
        if not self._dry_run:
            self._open_bus.send(self._heartbeat_id, _OPERATIONAL)
        self._next_heartbeat_ns = now + self._heartbeat_ns

    def close(self) -> None:
        """Take the nodes out of Operational, so that no stale command stays in force, and leave the bus."""
        if self._bus is not None:
            try:
                if self._heartbeat_id and not self._dry_run:
                    self._part()
            finally:
                bus, self._bus = self._bus, None
                bus.close()
        for lock in self._locks:
            lock.release()

    def _part(self) -> None:
        """Stop the exchange and see that no drive keeps its power; only then end its watch over the daemon."""
        for axis in self._axes:
            self._write_nmt(objects.NmtCommand.ENTER_PRE_OPERATIONAL, axis.node)
        with self._reading():
            for access in self._accesses.values():
                # a drive that does not answer, or keeps its power, goes on watching: the daemon's silence trips it
                with contextlib.suppress(DriveError):
                    # what the last RPDO said takes effect at a SYNC that does not come any more; this does at once
                    access.write(objects.CONTROLWORD, profile.DISABLE_VOLTAGE)
                    if not profile.drive_state(access.read(objects.STATUSWORD)).is_powered:
                        access.try_write(objects.CONSUMER_HEARTBEAT, 0)

    @contextlib.contextmanager
    def _reading(self) -> Iterator[None]:
        """Let the canopen library's thread read the bus, for its SDO client."""
        import can

        self._network.notifier = can.Notifier(self._open_bus.bus, self._network.listeners, _NOTIFIER_TIMEOUT_S)
        try:
            yield
        finally:
            self._network.notifier.stop()

    def _dispatch(self, frame: Frame) -> bool:
        """Hand a frame to its axis; whether it is feedback of this cycle."""
        handler = self._handlers.get(frame[0])
        return handler is not None and handler(frame[1])

    def _write_nmt(self, command: objects.NmtCommand, node: int) -> None:
        self._open_bus.send(objects.NMT_ID, bytes((command, node)))

    @property
    def _open_bus(self) -> FrameBus:
        if self._bus is None:
            raise BusError("the bus is not open: connect first")
        return self._bus


def _options(axis: "AxisConfig") -> CanopenOptions:
    assert isinstance(axis.options, CanopenOptions)
    return axis.options
