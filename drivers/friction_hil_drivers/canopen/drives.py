"""CiA 402 drives on one CAN bus: connecting through the canopen library, then raw frames in the cyclic phase.

While connecting, the canopen library's own thread reads the bus for its SDO client. That thread is gone before
the cyclic phase begins: a second busy thread would cost 5 ms wake-ups. From then on this module alone reads
and writes the bus, with frames packed by precompiled `struct`.
"""

import contextlib
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from friction_hil.drive import AxisFacts, Clock, Command, Feedback, Request
from friction_hil.errors import BusError, DriveError
from friction_hil_drivers.canopen import objects
from friction_hil_drivers.canopen.axis import CanopenAxis
from friction_hil_drivers.canopen.bus import bus_name, open_bus
from friction_hil_drivers.canopen.configure import configure
from friction_hil_drivers.canopen.exclusive import AxisLock
from friction_hil_drivers.canopen.mapping import check_bus_load
from friction_hil_drivers.canopen.options import CanopenOptions
from friction_hil_drivers.canopen.sdo import ObjectAccess

if TYPE_CHECKING:
    import can

    from friction_hil.config import AxisConfig, Configuration

_LISTEN_S = 0.1
_STEPPED_TIMEOUT_S = 10.0
_NOTIFIER_TIMEOUT_S = 0.02


class CanopenDrives:
    """The drives of some axes, as the loop needs them; see `friction_hil.drive.Drives`."""

    Options = CanopenOptions

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
        self._bus: Any = bus
        self._network: Any = None
        self._locks: list[AxisLock] = []
        self._accesses: dict[str, ObjectAccess] = {}
        self._axes: list[CanopenAxis] = []
        self._handlers: dict[int, Callable[[bytearray], None]] = {}
        self._sync: Any = None
        self._heartbeat: Any = None
        self._heartbeat_ns = 0
        self._next_heartbeat_ns = 0

    def connect(self) -> Sequence[AxisFacts]:
        """Configure every drive; nothing is enabled. See `friction_hil.drive.Drives.connect`."""
        import canopen

        config = self._configuration.bus
        assert config is not None  # the driver's options have checked it
        for name, axis in self._configs.items():
            self._locks.append(AxisLock(config, _options(axis).node, name))
        if self._bus is None:
            self._bus = open_bus(config)
        self._refuse_second_master()

        self._network = canopen.Network(self._bus)
        with self._reading():
            for name, axis in self._configs.items():
                self._axes.append(self._connect_axis(name, axis))
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

    def _refuse_second_master(self) -> None:
        """Listen for another master's SYNC, which a lock on this machine cannot tell of."""
        end = time.monotonic() + _LISTEN_S
        while (left := end - time.monotonic()) > 0.0:
            message = self._receive(left)
            if message is not None and message.arbitration_id == objects.SYNC_ID:
                raise DriveError(
                    f"another master sends SYNC on {self._bus.channel_info}: two daemons must not drive one bus"
                )

    def start(self) -> None:
        """Switch the nodes to Operational and begin the cyclic phase."""
        import can

        options = [_options(axis) for axis in self._configs.values()]
        self._sync = can.Message(arbitration_id=objects.SYNC_ID, is_extended_id=False)
        self._heartbeat = can.Message(
            arbitration_id=objects.HEARTBEAT_BASE + options[0].master_node,
            data=[objects.NmtState.OPERATIONAL],
            is_extended_id=False,
        )
        self._heartbeat_ns = round(min(option.heartbeat_s for option in options) * 1e9)
        for axis in self._axes:
            self._handlers.update(axis.handlers())
            self._write_nmt(objects.NmtCommand.START, axis.node)
        now = self._clock.now_ns()
        for axis in self._axes:
            axis.begin(now)
        self._beat(now)

    def receive(self, feedback: Sequence[Feedback], deadline_ns: int) -> None:
        """Send SYNC and collect the feedback of every drive until it is complete, or until the deadline."""
        clock, axes = self._clock, self._axes
        while (message := self._receive(0.0)) is not None:
            self._dispatch(message)
        now = clock.now_ns()
        for axis in axes:
            axis.expect(now)
        self._send(self._sync)
        while not all(axis.is_complete for axis in axes):
            timeout = (deadline_ns - clock.now_ns()) * 1e-9 if clock.is_real else _STEPPED_TIMEOUT_S
            message = self._receive(timeout) if timeout > 0.0 else None
            if message is None:
                break
            self._dispatch(message)
        for axis, target in zip(axes, feedback, strict=True):
            axis.fill(target, now)

    def send(self, commands: Sequence[Command]) -> None:
        """Write one command an axis; a dry run writes nothing."""
        if not self._dry_run:
            for axis, command in zip(self._axes, commands, strict=True):
                if command.request is not Request.LISTEN:
                    self._send(axis.command_frame(command))
        now = self._clock.now_ns()
        if now >= self._next_heartbeat_ns:
            self._beat(now)

    def _beat(self, now: int) -> None:
        """Send the daemon's heartbeat, by which the drives watch it."""
        if not self._dry_run:
            self._send(self._heartbeat)
        self._next_heartbeat_ns = now + self._heartbeat_ns

    def close(self) -> None:
        """Take the nodes out of Operational, so that no stale command stays in force, and leave the bus."""
        if self._bus is not None:
            try:
                if self._sync is not None and not self._dry_run:
                    self._part()
            finally:
                bus, self._bus = self._bus, None
                bus.shutdown()
        for lock in self._locks:
            lock.release()

    def _part(self) -> None:
        """Stop the exchange and end the drives' watch over the daemon, for it will be silent from now on."""
        for axis in self._axes:
            self._write_nmt(objects.NmtCommand.ENTER_PRE_OPERATIONAL, axis.node)
        with self._reading():
            for access in self._accesses.values():
                access.try_write(objects.CONSUMER_HEARTBEAT, 0)

    @contextlib.contextmanager
    def _reading(self) -> Iterator[None]:
        """Let the canopen library's thread read the bus, for its SDO client."""
        import can

        self._network.notifier = can.Notifier(self._bus, self._network.listeners, _NOTIFIER_TIMEOUT_S)
        try:
            yield
        finally:
            self._network.notifier.stop()

    def _dispatch(self, message: "can.Message") -> None:
        handler = self._handlers.get(message.arbitration_id)
        if handler is not None and not message.is_extended_id and not message.is_error_frame:
            handler(message.data)

    def _write_nmt(self, command: objects.NmtCommand, node: int) -> None:
        self._send(_nmt(command, node))

    def _send(self, message: "can.Message") -> None:
        import can

        try:
            self._bus.send(message)
        except (can.CanError, OSError) as error:
            raise BusError(f"the bus {self._bus.channel_info} cannot send: {error}") from error

    def _receive(self, timeout: float) -> "can.Message | None":
        from friction_hil_drivers.canopen.bus import receive

        return receive(self._bus, timeout)


def _nmt(command: objects.NmtCommand, node: int) -> "can.Message":
    import can

    return can.Message(arbitration_id=objects.NMT_ID, data=[command, node], is_extended_id=False)


def _options(axis: "AxisConfig") -> CanopenOptions:
    assert isinstance(axis.options, CanopenOptions)
    return axis.options
