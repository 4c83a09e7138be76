"""CiA 402 drives on one CAN bus, as the daemon's drive port has them.

While connecting, the SDO client reads the bus. In the cyclic phase `exchange` alone reads and writes it. There is no
second thread: a busy one would delay wake-ups by up to 5 ms.
"""

import contextlib
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from friction_hil.drive import AxisFacts, Clock, Drives, DriveState
from friction_hil.drive.finding import Finding, failure
from friction_hil.errors import BusError, DriveError, FrictionHilError, UsageError
from friction_hil_drivers.canopen import codes
from friction_hil_drivers.canopen.commands.new_keys import new_keys
from friction_hil_drivers.canopen.commands.service import CanopenService
from friction_hil_drivers.canopen.connect.checks import check_bus, check_connection
from friction_hil_drivers.canopen.connect.configure import configure, with_notes
from friction_hil_drivers.canopen.connect.eds_check import compare_axis, read_eds
from friction_hil_drivers.canopen.connect.listening import (
    LISTEN_S,
    Look,
    MasterAlarm,
    OtherMasters,
    ask_identities,
    ask_nmt_state,
    count_sent,
    heard_by,
    kept_out_of_operational,
    look,
    require_one_node,
    unknown_nmt_state,
    would_disturb,
)
from friction_hil_drivers.canopen.connect.mapping import check_bus_load
from friction_hil_drivers.canopen.connect.pdo_journal import CanopenJournal
from friction_hil_drivers.canopen.connect.watchdog_times import WatchdogTimes
from friction_hil_drivers.canopen.connect.watchdogs import watchdog_pdos
from friction_hil_drivers.canopen.cycle.axis import CanopenAxis
from friction_hil_drivers.canopen.cycle.bus_drives import BusDrives
from friction_hil_drivers.canopen.cycle.exchange import CyclicExchange
from friction_hil_drivers.canopen.cycle.passive import PassiveExchange, nothing_to_hear, passive_exchange
from friction_hil_drivers.canopen.options import CanopenOptions, canopen_options
from friction_hil_drivers.canopen.sidecar.drives import SidecarDrives
from friction_hil_drivers.canopen.stop.leaving import read_state, restore, send_nmt, switch_off, watchdog_frames
from friction_hil_drivers.canopen.wire import cia301, interfaces
from friction_hil_drivers.canopen.wire.exclusive import state_path
from friction_hil_drivers.canopen.wire.interfaces import bus_name
from friction_hil_drivers.cia402 import codes as cia402_codes
from friction_hil_drivers.cia402 import objects

if TYPE_CHECKING:
    import can

    from friction_hil.config import AxisConfig, Configuration
    from friction_hil_drivers.canopen.sdo.client import SdoClient, SdoNetwork
    from friction_hil_drivers.canopen.wire.frames import FrameBus

_OF_MAPPING = (
    cia402_codes.SDO_ABORT,
    cia402_codes.OBJECT_MISSING,
    cia402_codes.OBJECT_SIZE,
    codes.MAPPING_NOT_KEPT,
    codes.NO_MAPPING,
    codes.UNKNOWN_ENTRY,
)
_PRE_OPERATIONAL = (cia301.NmtState.BOOT_UP, cia301.NmtState.PRE_OPERATIONAL)  # a node boots into the latter


class CanopenDrives(BusDrives, CanopenService):
    """Drives of some axes on one bus; see `friction_hil.drive.Drives`.

    After `close`, ``leftovers`` says what could not be left as it was found, and ``remarks`` what is not known of that.
    """

    Options = CanopenOptions
    explanations = codes.EXPLANATIONS
    remedies = codes.REMEDIES
    check_machine = staticmethod(interfaces.check_machine)
    check_bus = staticmethod(check_bus)
    check_connection = staticmethod(check_connection)
    new_keys = staticmethod(new_keys)

    @classmethod
    def check_files(
        cls, configuration: "Configuration", axes: "Mapping[str, AxisConfig]"
    ) -> Iterator[tuple[str, str, FrictionHilError]]:
        """Read the EDS of each axis and compare it with the mode; see `friction_hil.drive.Driver`."""
        for name, axis in axes.items():
            options = canopen_options(axis)
            sync_id = 0 if configuration.bus is None else configuration.bus.sync_cob_id
            if sync_id == cia301.EMERGENCY_BASE + options.node:
                yield name, "node", UsageError(f"bus.sync_cob_id {sync_id:#x} is the emergency message of this node")
            try:
                reasons = () if options.eds is None else compare_axis(options.eds, axis)
            except UsageError as error:
                yield name, "eds", error
                continue
            for key, reason in reasons:
                yield name, key, UsageError(f"{options.eds} {reason}")

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
                yield from drives.try_own_watchdogs(name)
            except FrictionHilError as error:
                yield failure(f"{name}: watchdogs", error, "FH-445")
            finally:
                drives.close()
            for text in drives.leftovers:
                yield Finding(f"{name}: left", "fail", text)

    def try_own_watchdogs(self, name: str) -> Iterator[Finding]:
        """Let each watchdog of the one drive lapse, once it is connected."""
        # imported here: python-can takes 0.5 s, and reading a configuration does not need it
        from friction_hil_drivers.canopen.connect.watchdog_trial import WatchdogTrial

        [axis], options = self._axes, canopen_options(self._configs[name])
        if not axis.watch.means:
            detail = "the drive does not watch the daemon: if the daemon dies, its last torque stays"
            yield Finding(f"{name}: watchdogs", "fail", detail, "see friction-hil run with --dry-run", "FH-444")
            return
        assert self._bus is not None
        assert self._network is not None
        self._keep_setpoints()
        self._is_started = True
        trial = WatchdogTrial(
            self._bus,
            self._network,
            self._clients[name],
            axis,
            master_node=options.master_node,
            beat_s=axis.watch.beat_s,
        )
        yield from trial.run()

    @classmethod
    def drives_for(
        cls, configuration: "Configuration", axes: "Mapping[str, AxisConfig]", clock: Clock, *, dry_run: bool
    ) -> Drives:
        """Return the drives; with ``bus.role: sidecar`` those that another controller moves."""
        is_sidecar = configuration.bus is not None and configuration.bus.role == "sidecar"
        return (SidecarDrives if is_sidecar else cls)(configuration, axes, clock, dry_run=dry_run)

    def __init__(
        self,
        configuration: "Configuration",
        axes: "Mapping[str, AxisConfig]",
        clock: Clock,
        *,
        dry_run: bool,
        bus: "can.BusABC | None" = None,
    ) -> None:
        super().__init__(configuration, axes, clock, dry_run=dry_run, bus=bus)
        self._network: SdoNetwork | None = None
        self._clients: dict[str, SdoClient] = {}
        self._looks: dict[str, Look] = {}
        self._journals: dict[int, CanopenJournal] = {}
        self._nmt_states: dict[int, int | None] = {}  # of nodes that were given another one: the state found
        self._states: dict[str, DriveState] = {}  # read back while leaving
        self.is_passive = False
        self._is_reading = True  # nothing was written yet
        self.remarks: list[str] = []
        self._others = OtherMasters((), 0)
        self._axes: list[CanopenAxis] = []
        self._identifiers: set[int] = set()  # of all PDOs in use

    # Connecting

    def connect(self) -> Sequence[AxisFacts]:
        """Configure every drive; nothing is enabled. See `friction_hil.drive.Drives.connect`."""
        # imported here: canopen takes 0.5 s, and reading a configuration does not need it
        from friction_hil_drivers.canopen.sdo.client import SdoNetwork

        config = self._bus_config
        for axis in self._configs.values():
            read_eds(axis)  # an invalid file is found before any drive is configured
        bus = self._open_bus()
        nodes = {canopen_options(axis).node for axis in self._configs.values()}
        self._others = OtherMasters(nodes, self._first_options.master_node, config.sync_cob_id)
        if bus.is_echoing:
            count_sent(bus, self._others)
        heard_by(bus, self._others, time.monotonic() + LISTEN_S, time.monotonic)
        self._refuse_other_masters()
        self._network = SdoNetwork(bus, self._others.take, self._before_request)
        for name, axis in self._configs.items():
            self._clients[name] = self._client(self._network, name, canopen_options(axis).node)
        self._meet(bus)
        self._look()
        for name, axis in self._configs.items():
            self._axes.append(self._connect_axis(name, axis))
        if config.bitrate is not None:
            pdos = [pdo for axis in self._axes for pdo in axis.pdos]
            pdos += watchdog_pdos(axis.watch.feed_cycles for axis in self._axes if axis.watch.rpdo_id)
            check_bus_load(config.bitrate, self._configuration.period_s, pdos)
        self._exchange = self._make_exchange(bus)
        return [axis.facts for axis in self._axes]

    def _client(self, network: "SdoNetwork", name: str, node: int) -> "SdoClient":
        config = self._bus_config
        client = network.client(node, name, f"node {node} on {bus_name(config)}")
        client.axis_number = canopen_options(self._configs[name]).axis_number
        if node not in self._journals:
            self._journals[node] = CanopenJournal(
                client, lambda identity: state_path(config, node, f"-{identity}.json")
            )
        client.journal = self._journals[node]
        return client

    def _before_request(self, can_id: int, data: bytes) -> None:
        """Let a node alone whose only SDO server another master uses, as long as nothing was written to any node."""
        node = can_id - cia301.SDO_REQUEST_BASE
        if self._is_reading and self._others.uses_sdo_of(node):
            self._refuse_other_masters()
            bus = bus_name(self._bus_config)
            raise would_disturb([node], bus, "or take bus.role: sidecar, which needs no SDO")
        self._others.requested(can_id, data)

    def _meet(self, bus: "FrameBus") -> None:
        """Ask every node who it is, and refuse a number that two nodes have.

        Raises `DriveError`: a node does not answer, or two do.
        """
        ask_identities(list(self._clients.values()), bus, self._others)
        for name, client in self._clients.items():
            self._refuse_twins(client, self._node_of(name))

    def _refuse_twins(self, client: "SdoClient", node: int) -> None:
        """Refuse a number that two nodes have; see `listening.require_one_node`."""
        assert self._bus is not None  # it is being connected
        require_one_node(client, self._bus, self._others, node, bus_name(self._bus_config))

    def _look(self) -> None:
        """Read the state of every drive, before anything is written to any of them.

        Raises `DriveError`: a drive has power already, or another master is at work.
        """
        for name, client in self._clients.items():
            node = canopen_options(self._configs[name]).node
            self._looks[name] = look(client, node, self._others)
        refusals = [
            f"{client.axis}: {client.where} {self._looks[name].refusal}"
            for name, client in self._clients.items()
            if self._looks[name].refusal
        ]
        if refusals and not self._dry_run:
            raise DriveError("; ".join(refusals), code=cia402_codes.ALREADY_POWERED)
        self.is_passive = self._dry_run and bool(refusals or self._others.words)
        self._refuse_other_masters()

    def _refuse_other_masters(self) -> None:
        """Refuse to drive what another master drives; a dry run only listens to it.

        Raises `DriveError`: something of another master was heard.
        """
        heard = self._others.words
        if heard and not self._dry_run:
            text = f"another master is at work on {bus_name(self._bus_config)}: {heard}"
            raise DriveError(text, "stop it first, or listen with --dry-run", code=codes.SECOND_MASTER)

    def _connect_axis(self, name: str, config: "AxisConfig") -> CanopenAxis:
        options, client = canopen_options(config), self._clients[name]
        client.is_read_only = self.is_passive
        try:
            drive = configure(
                client,
                name,
                config,
                self._configuration.period_s,
                self._times(options),
                dry_run=self._dry_run,
                taken=self._identifiers,
                before_writing=lambda: self._prepare_nmt(client, options.node),
                sync_id=self._bus_config.sync_cob_id,
            )
        except DriveError as error:
            if self.is_passive and error.code in _OF_MAPPING:
                raise nothing_to_hear(client, self._others, error.detail) from error
            raise
        notes = client.notes if client.journal is None else [*client.notes, *client.journal.notes]
        drive = with_notes(drive, [*notes, *self._passive_notes()])
        return CanopenAxis(drive, options.node, self._heartbeat_s(name, options))

    def _prepare_nmt(self, client: "SdoClient", node: int) -> None:
        """Find out the NMT state of a node, and take it out of Operational, in which it may refuse new mappings."""
        self._refuse_other_masters()
        self._refuse_twins(client, node)
        if self.is_passive:
            return
        self._is_reading = False
        if node in self._nmt_states:
            return
        if self._clock.is_real and self._others.state_of(node) is None:
            assert self._bus is not None
            ask_nmt_state(client, self._bus, self._others, node)
        if not self._dry_run and self._others.state_of(node) not in _PRE_OPERATIONAL:
            self._set_nmt(cia301.NmtCommand.ENTER_PRE_OPERATIONAL, node)

    def _passive_notes(self) -> list[str]:
        if not self.is_passive:
            return []
        heard = self._others.words or "its power is on"
        return [f"another master drives it ({heard}): this dry run only listens to its TPDOs, and reads by SDO"]

    def _heartbeat_s(self, name: str, options: CanopenOptions) -> float:
        """Return the period of a drive's heartbeat, s: in a dry run its own."""
        own_ms = self._looks[name].heartbeat_ms if self._dry_run else 0
        return 1e-3 * max(self._times(options).heartbeat_ms, own_ms)

    @property
    def _first_options(self) -> CanopenOptions:
        return canopen_options(next(iter(self._configs.values())))

    def _times(self, options: CanopenOptions) -> WatchdogTimes:
        realtime = self._configuration.realtime
        times = options.times(self._configuration.period_s, realtime.max_missed)
        return replace(times, is_demanded="max_missed" in realtime.model_fields_set)

    def _make_exchange(self, bus: "FrameBus") -> CyclicExchange | PassiveExchange:
        sync_id = self._bus_config.sync_cob_id
        if self.is_passive:
            period_s = self._configuration.period_s
            return passive_exchange(
                bus, self._axes, self._clients, self._others, self._clock, period_s=period_s, sync_id=sync_id
            )
        options = [canopen_options(axis) for axis in self._configs.values()]
        return CyclicExchange(
            bus,
            self._axes,
            self._clock,
            period_s=self._configuration.period_s,
            heartbeat_s=min(
                axis.watch.beat_s or 1e-3 * self._times(option).heartbeat_ms
                for axis, option in zip(self._axes, options, strict=True)
            ),
            master_node=options[0].master_node,
            dry_run=self._dry_run,
            max_missed=self._configuration.realtime.max_missed,
            alarm=MasterAlarm(self._others),
            sync_id=sync_id,
        )

    # The cyclic phase

    def start(self) -> None:
        """Switch the nodes to Operational and begin the cyclic phase."""
        if self._exchange is None:
            raise BusError("the bus is not open: connect first")
        if not self._dry_run:
            self._keep_setpoints()
        self._is_started = True
        for axis in self._axes:
            if not self.is_passive:
                self._set_nmt(cia301.NmtCommand.START, axis.node)
        self._exchange.start()

    def _keep_setpoints(self) -> None:
        """Keep on disk that the set-points which are written from now on are to be zero in the end."""
        for client in self._clients.values():
            for entry in objects.ACTING_SETPOINTS:
                if (bits := client.width(entry) or client.hidden_width(entry)) and client.journal is not None:
                    client.journal.leave_at_zero(entry.of_axis(client.axis_number), bits // 8)

    # Leaving

    def close(self) -> list[DriveState]:
        """Disable every drive, leave each as it was found, and leave the bus.

        Returns the state of each as it was read back at last, UNKNOWN where it was not.
        """
        with contextlib.ExitStack() as stack:
            for lock in self._locks:
                stack.callback(lock.release)  # also if the bus fails meanwhile
            if self._bus is not None:
                stack.callback(self._bus.close)
                try:
                    if self._network is not None and not self.is_passive:
                        self._leave(self._network)
                finally:
                    self._bus = None
        return [self._states.get(name, DriveState.UNKNOWN) for name in self._configs]

    def _leave(self, network: "SdoNetwork") -> None:
        frames = self._exchange.last_frames() if isinstance(self._exchange, CyclicExchange) else None
        if frames is not None and self._bus is not None:
            network.meanwhile = watchdog_frames(self._bus, frames, self._clock)
        failure: BusError | None = None
        if self._dry_run:
            self._stop_listening()
        elif self._is_started:
            assert self._bus is not None
            axes = [(name, self._node_of(name), client.axis_number) for name, client in self._clients.items()]
            told = {axis.facts.name: state for axis in self._axes if (state := axis.fresh_state)}
            self._states, failure = switch_off(self._bus, axes, network.meanwhile, frames, told)
        for name, client in self._clients.items():
            obstacle = self._obstacle(self._node_of(name))
            self.leftovers += restore(client, self._states.get(name) if obstacle is None else obstacle)
            if frames is not None:
                frames.left(self._node_of(name))
        for node, found in self._nmt_states.items():
            if found == cia301.NmtState.OPERATIONAL:
                if self._is_unpowered(node):
                    self._write_nmt(cia301.NmtCommand.START, node)
                else:
                    self.leftovers.append(kept_out_of_operational(node))
            elif found is None and self._clock.is_real:
                self.remarks.append(unknown_nmt_state(node))
        if failure is not None:
            raise failure

    def _node_of(self, name: str) -> int:
        return canopen_options(self._configs[name]).node

    def _is_unpowered(self, node: int) -> bool:
        """Return True if every axis of a node says that it has no power; one that did not answer is not asked again."""
        clients = [client for name, client in self._clients.items() if self._node_of(name) == node]
        return self._obstacle(node) is None and all(read_state(client).is_unpowered for client in clients)

    def _obstacle(self, node: int) -> DriveState | None:
        """Return the state of an axis of a node that was not read back without power, None for none."""
        states = (state for name, state in self._states.items() if self._node_of(name) == node)
        return next((state for state in states if not state.is_unpowered), None)

    def _stop_listening(self) -> None:
        """Take the nodes that a dry run has started out of Operational, unless somebody drives them meanwhile."""
        for node in list(self._nmt_states):
            if self._others.words or not self._is_unpowered(node):
                del self._nmt_states[node]
            else:
                self._write_nmt(cia301.NmtCommand.ENTER_PRE_OPERATIONAL, node)

    def _set_nmt(self, command: cia301.NmtCommand, node: int) -> None:
        """Change the NMT state of a node, and keep the one that it was found in."""
        self._nmt_states.setdefault(node, self._others.state_of(node))
        self._write_nmt(command, node)

    def _write_nmt(self, command: cia301.NmtCommand, node: int) -> None:
        if self._bus is None:
            raise BusError("the bus is not open: connect first")
        send_nmt(self._bus, command, node)
