"""CiA 402 drives whose master is another controller, as the daemon's drive port has them (``bus.role: sidecar``).

Nothing is sent but the torque offset of each axis in an RPDO of its own, and a heartbeat if one is configured: no
NMT, no SYNC, no SDO. What the drive sends and how it is to be read is stated in the configuration.
"""

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from friction_hil.drive import AxisFacts, Clock, DriveState, Mode
from friction_hil.drive.phase_lock import PhaseLock
from friction_hil.errors import BusError, DriveError
from friction_hil_drivers.canopen import codes
from friction_hil_drivers.canopen.connect.heard_pdos import HeardPdos
from friction_hil_drivers.canopen.connect.mapping import check_bus_load
from friction_hil_drivers.canopen.cycle.bus_drives import BusDrives
from friction_hil_drivers.canopen.cycle.delays import SETPOINT_CYCLES
from friction_hil_drivers.canopen.options import CanopenOptions, canopen_options
from friction_hil_drivers.canopen.sidecar.axis import SidecarAxis, demand_object
from friction_hil_drivers.canopen.sidecar.exchange import SidecarExchange
from friction_hil_drivers.canopen.sidecar.options import SidecarOptions, mapped
from friction_hil_drivers.canopen.wire import cia301
from friction_hil_drivers.canopen.wire.interfaces import bus_name
from friction_hil_drivers.cia402 import objects
from friction_hil_drivers.cia402.units import PER_MILLE, DriveUnits
from friction_hil_drivers.torque_sign import torque_signs

if TYPE_CHECKING:
    import can

    from friction_hil.config import AxisConfig, Configuration
    from friction_hil_drivers.canopen.wire.frames import FrameBus

_SYNCS, _RELOCK_SYNCS = 250, 50
_SYNC_TIMEOUT_S = 5.0
_ATTEMPTS = 3  # a computer that was held up may have stamped SYNC unevenly

# RPDO of type 255: in force as soon as it arrives, some 0.25 periods after SYNC, and held for a period
_REAL_ACTUATION_CYCLES = 0.75
_STEPPED_ACTUATION_CYCLES = 0.5  # simulated time stands still between SYNC and the offset


class SidecarDrives(BusDrives):
    """Drives of some axes on a bus whose master is another controller; see `friction_hil.drive.Drives`."""

    is_follower = True  # the loop enables nothing and sends torque offsets only
    phase_lock: PhaseLock  # period and phase of the master's SYNC

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
        self._axes: list[SidecarAxis] = []
        self.phase_lock = PhaseLock(configuration.period_s)

    def connect(self) -> Sequence[AxisFacts]:
        """Listen to SYNC and to the PDOs that the configuration names; nothing is sent.

        Raises `BusError`: the bus does not open; `DriveError`: there is no usable SYNC, or a PDO is not as the
        configuration says.
        """
        bus, bitrate = self._open_bus(), self._bus_config.bitrate
        self._axes = [self._make_axis(name, axis) for name, axis in self._configs.items()]
        if bus.is_echoing:
            _count_offsets(bus, {axis.offset_id: axis for axis in self._axes})
        if bitrate is not None:
            pdos = [pdo for axis in self._axes for pdo in axis.pdos]
            check_bus_load(bitrate, self._configuration.period_s, pdos)
        notes: dict[str, list[str]] = {name: [] for name in self._configs}
        if self._clock.is_real:
            heard = self._acquire(_SYNCS)
            for listener in self._axes:
                notes[listener.facts.name] += self._compare(listener, heard)
        self._exchange = self._make_exchange(bus)
        return [replace(axis.facts, notes=(*axis.facts.notes, *notes[axis.facts.name])) for axis in self._axes]

    def start(self) -> None:
        """Lock to SYNC again, because starting has taken seconds, and begin the cyclic phase."""
        if self._exchange is None:
            raise BusError("the bus is not open: connect first")
        self._exchange.start()
        if self._clock.is_real:
            self._acquire(_RELOCK_SYNCS)
        self._is_started = True

    def _sending(self, options: SidecarOptions) -> list[str]:
        """Return a note on what goes out."""
        if not self._dry_run:
            heartbeat = "nothing else" if options.heartbeat_s is None else "its heartbeat"
            return [f"sidecar: sends {objects.TORQUE_OFFSET} as {options.offset.cob_id:03X}h and {heartbeat}"]
        waiting = "; a stand-in master with --pace sync waits in vain for the offset: use --pace real"
        return [f"sidecar: sends nothing in a dry run{'' if self._clock.is_real else waiting}"]

    def close(self) -> list[DriveState]:
        """Send a last torque offset of zero and leave the bus.

        Returns no states: the drives are another controller's, and were not stopped.
        """
        if self._bus is not None:
            try:
                if self._is_started and isinstance(self._exchange, SidecarExchange):
                    self.leftovers += self._exchange.send_zero()
            finally:
                bus, self._bus = self._bus, None
                bus.close()
        for lock in self._locks:
            lock.release()
        return []

    # Connecting

    def _make_axis(self, name: str, config: "AxisConfig") -> SidecarAxis:
        options, period_s = canopen_options(config), self._configuration.period_s
        assert options.sidecar is not None  # the options have checked it
        mode = Mode[config.mode.upper()]
        units = _units(options)
        delay_cycles, age_s = 0.0, None
        if demand_object(options.sidecar) is objects.TARGET_POSITION:
            given = options.setpoint_delay_cycles
            # the sidecar uses a set-point one cycle later
            delay_cycles = (SETPOINT_CYCLES[mode] if given is None else given) - 1.0
            age_s = period_s
        actuation_cycles = _REAL_ACTUATION_CYCLES if self._clock.is_real else _STEPPED_ACTUATION_CYCLES
        facts = AxisFacts(
            name=name,
            identity=f"node {options.node} on {bus_name(self._bus_config)}, moved by another controller",
            position_resolution=1.0 / abs(units.counts_per_unit),
            torque_resolution=abs(units.rated_torque) / PER_MILLE,
            setpoint_delay_s=delay_cycles * period_s,
            setpoint_age_s=age_s,
            actuation_delay_s=actuation_cycles * period_s,
            notes=(*self._sending(options.sidecar), *_notes(options.sidecar), *_frozen(config)),
            torque_delay_s=0.0 if _has(options.sidecar, objects.TORQUE_ACTUAL) else None,
        )
        return SidecarAxis(facts, options.node, mode, units, period_s, options.sidecar)

    def _make_exchange(self, bus: "FrameBus") -> SidecarExchange:
        options = [canopen_options(axis) for axis in self._configs.values()]
        beats = [
            (one.master_node, one.sidecar.heartbeat_s)
            for one in options
            if one.sidecar is not None and one.sidecar.heartbeat_s is not None
        ]
        return SidecarExchange(
            bus,
            self._axes,
            self._clock,
            self.phase_lock,
            period_s=self._configuration.period_s,
            sync_id=self._bus_config.sync_cob_id,
            max_missed=self._configuration.realtime.max_missed,
            heartbeat=min(beats, key=lambda beat: beat[1]) if beats else None,
            dry_run=self._dry_run,
        )

    def _acquire(self, count: int) -> HeardPdos:
        """Lock to SYNC; return what was heard meanwhile.

        Raises `DriveError`: SYNC does not come, or not as it should.
        """
        sync_id, name = self._bus_config.sync_cob_id, bus_name(self._bus_config)
        problem = ""
        for _ in range(_ATTEMPTS):
            heard = self._listen(count)
            if not heard.stamps:
                text = f"no SYNC ({sync_id:03X}h) within {_SYNC_TIMEOUT_S:g} s on {name}"
                fix = "start the master of the bus first; bus.sync_cob_id must be its identifier (1005h)"
                raise DriveError(text, fix, code=codes.SYNC_UNUSABLE)
            problem = self.phase_lock.acquire(heard.stamps)
            if not problem:
                return heard
        text = f"the SYNC ({sync_id:03X}h) on {name} gives no time base: {problem}"
        raise DriveError(text, "period_s must be the master's period", code=codes.SYNC_UNUSABLE)

    def _listen(self, count: int) -> HeardPdos:
        """Listen to ``count`` SYNCs, or as long as they should take."""
        assert self._bus is not None
        heard = HeardPdos(self._bus_config.sync_cob_id)
        end = time.monotonic() + _SYNC_TIMEOUT_S + count * self._configuration.period_s
        while len(heard.stamps) < count and (left := end - time.monotonic()) > 0.0:
            frame = self._bus.receive(left)
            if frame is not None:
                heard.take(frame[0], len(frame[1]), self._clock.now_ns())
        return heard

    def _compare(self, axis: SidecarAxis, heard: HeardPdos) -> list[str]:
        """Compare what was heard with the configuration; return notes.

        Raises `DriveError`: a PDO has another length or another rhythm, two nodes send one, or somebody sends what the
        daemon sends.
        """
        name, sizes = axis.facts.name, heard.sizes
        for own in self._own_identifiers(name, axis):
            if own in sizes:
                text = f"{name}: somebody on {bus_name(self._bus_config)} sends {own:03X}h already"
                fix = "the RPDO of the torque offset, and the number of the heartbeat, must be the sidecar's own"
                raise DriveError(text, fix, code=codes.PDO_NOT_AS_STATED)
        self._compare_rhythm(axis, heard)
        for can_id, size in axis.sizes.items():
            wrong = [length for length in sizes.get(can_id, ()) if length != size]
            if wrong:
                text = f"{name}: {can_id:03X}h comes with {wrong[0]} bytes, but its entries have {size}"
                fix = "write the entries as the master has mapped them"
                raise DriveError(text, fix, code=codes.PDO_NOT_AS_STATED)
        lock = self.phase_lock
        notes = [f"locked to SYNC: {lock.deviation_ppm:+.0f} ppm, jitter {lock.jitter_ns * 1e-3:.0f} µs"]
        if silent := sorted(axis.awaited - set(sizes)):
            listed = ", ".join(f"{can_id:03X}h" for can_id in silent)
            notes.append(f"{listed} has not come yet: the drive may be off, or not Operational")
        return notes

    def _own_identifiers(self, name: str, axis: SidecarAxis) -> list[int]:
        """Return the identifiers of what the daemon sends for an axis."""
        options = canopen_options(self._configs[name])
        has_heartbeat = options.sidecar is not None and options.sidecar.heartbeat_s is not None
        return [axis.offset_id, *([cia301.HEARTBEAT_BASE + options.master_node] if has_heartbeat else [])]

    def _compare_rhythm(self, axis: SidecarAxis, heard: HeardPdos) -> None:
        """Refuse a TPDO that should come once with every SYNC, and does not."""
        name = axis.facts.name
        for can_id in sorted(axis.awaited):
            heard.require_one_sender(can_id, name, axis.node)
            if (syncs := heard.syncs_between(can_id)) > 1:
                text = f"{name}: {can_id:03X}h comes with every {syncs}. SYNC only, but is stated to come with each"
                fix = "let the master set its type to 1 (1800h:02 for TPDO 1), or state is_synchronous: false for one "
                fix += "without the position"
                raise DriveError(text, fix, code=codes.PDO_NOT_AS_STATED)


def _count_offsets(bus: "FrameBus", axes: Mapping[int, SidecarAxis]) -> None:
    """Let each axis know of its offsets on a bus that delivers them back."""
    send = bus.send

    def counted(can_id: int, data: bytes | bytearray) -> None:
        send(can_id, data)
        if can_id in axes:
            axes[can_id].sent()

    bus.send = counted  # type: ignore[method-assign]


def _units(options: CanopenOptions) -> DriveUnits:
    counts, rated_torque = options.counts_per_unit, options.rated_torque
    assert counts is not None and rated_torque is not None  # noqa: PT018 - the options have checked both
    sign = -1.0 if options.is_inverted else 1.0
    of_command, of_feedback = torque_signs(options.inverted_torque)
    return DriveUnits(sign * counts, sign * counts, sign * of_feedback * rated_torque, of_command * of_feedback)


def _has(options: SidecarOptions, entry: objects.Object) -> bool:
    return any(entry in mapped(pdo).entries for pdo in (*options.tpdos, *options.rpdos))


def _notes(options: SidecarOptions) -> list[str]:
    """Return notes on what the stated PDOs do not have."""
    notes = []
    demand = demand_object(options)
    if demand is None:
        notes.append("no demand in the stated PDOs (607Ah, 6062h): compensates by the measured velocity alone")
    else:
        notes.append(f"demand from {demand}")
    if not _has(options, objects.MODE_DISPLAY):
        notes.append(f"{objects.MODE_DISPLAY} is in no TPDO: the drive is taken to be in the configured mode")
    return notes


def _frozen(config: "AxisConfig") -> list[str]:
    """Return a note where the last offset of a daemon that was killed could move the axis."""
    limit, level = config.limits.torque, config.model.friction_model.level
    if limit <= level:
        return []
    unit = "N m" if config.model.axis == "rotary" else "N"
    text = f"if the daemon is killed, an offset of up to {limit:g} {unit} stays in force, more than the friction of "
    text += f"{level:g} {unit}"
    return [f"{text}: the master should clear it ('If the daemon dies' in the driver's sidecar.md)"]
