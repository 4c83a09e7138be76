"""A stand-in for a PLC: master of simulated drives, for trying a sidecar (``friction-hil simulate --master``).

It maps the PDOs as the configuration of the sidecar states them, enables the drives and moves them along the
trajectories under ``simulation``, with SYNC, RPDOs, NMT and heartbeat. It clears a torque offset whose sender has
fallen silent, as a master should.
"""

import struct
import time
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Literal

from friction_hil.drive import DriveState, Mode, Request
from friction_hil.drive.encoder import unwrap
from friction_hil.errors import BusError, DriveError, UsageError
from friction_hil.motion.trajectory import (
    Path,
    PathTime,
    Trajectory,
    circle_path,
    sine_path,
    still_path,
    triangle_path,
)
from friction_hil_drivers.canopen import codes
from friction_hil_drivers.canopen.connect.mapping import SYNCHRONOUS, PdoRecord
from friction_hil_drivers.canopen.options import canopen_options
from friction_hil_drivers.canopen.sdo.conversation import Conversation
from friction_hil_drivers.canopen.sdo.dialogue import Download
from friction_hil_drivers.canopen.sidecar.options import SidecarPdo, mapping_words
from friction_hil_drivers.canopen.simulated.options import SimulationOptions
from friction_hil_drivers.canopen.wire import cia301
from friction_hil_drivers.canopen.wire.cia301 import NmtCommand, NmtState
from friction_hil_drivers.canopen.wire.interfaces import bus_name
from friction_hil_drivers.cia402 import objects, profile
from friction_hil_drivers.cia402.access import RefusedError
from friction_hil_drivers.cia402.objects import Object
from friction_hil_drivers.cia402.units import COUNTER_BITS, wrap

if TYPE_CHECKING:
    from friction_hil.config import AxisConfig, Configuration
    from friction_hil.config.trajectories import Trajectory as Motion
    from friction_hil_drivers.canopen.wire.frames import FrameBus

MASTER_NODE = 127
_EVENT_DRIVEN = 255
_OFFSET_RPDO = 3  # RPDO 4
_TO_FAULT = 1  # 6007h
_HEARTBEAT_S = 0.1
_ANSWER_S, _ATTEMPTS = 2.0, 10  # a drive may be booting
_STOP_S = 4.0  # for drives to come to rest and to lose their power; less than `simulate` waits for this process
_SETTLE_S = 0.2  # enabled, before the motion begins
_SILENCE_PERIODS = 20  # without a torque offset, after which the one in force is cleared
_JOIN_S, _LOCKSTEP_S = 1.0, 10.0  # in simulated time: how long a cycle waits for the sidecar, before and after it came
_POSITION_GAIN = 20.0  # 1/s, in csv

_CODES = {8: "b", 16: "h", 32: "i", 64: "q"}  # of `struct`, by the width in bits
_RATES: dict[Mode, Object] = {
    Mode.CSP: objects.TARGET_POSITION,
    Mode.CSV: objects.TARGET_VELOCITY,
}


class _Slave:
    """One drive as the master sees it."""

    def __init__(self, name: str, axis: "AxisConfig", path_time: PathTime) -> None:
        options = canopen_options(axis)
        simulation = axis.simulation
        if options.sidecar is None or options.counts_per_unit is None or not isinstance(simulation, SimulationOptions):
            raise UsageError(f"{name}: --master needs the keys of a sidecar: sidecar, counts_per_unit, simulation")
        self.name, self.node = name, options.node
        self.sidecar = options.sidecar
        self.mode = Mode[axis.mode.upper()]
        if self.mode not in _RATES:
            raise UsageError(f"{name}: --master moves axes in csp and csv, not in {axis.mode}")
        self._counts_per_unit = (-1.0 if options.is_inverted else 1.0) * options.counts_per_unit
        self._trajectory = Trajectory(make_path(simulation.trajectory), path_time)
        self._tpdos = {pdo.cob_id: _Fields(pdo) for pdo in self.sidecar.tpdos}
        self._rpdos = [_Fields(pdo) for pdo in self.sidecar.rpdos]
        sent = {word >> 16 for fields in self._rpdos for word in fields.words}
        for needed in (objects.CONTROLWORD, _RATES[self.mode]):
            if needed.index not in sent:
                raise UsageError(f"{name}: --master needs {needed} in one of sidecar.rpdos")
        self.state = DriveState.UNKNOWN
        self.counts = 0
        self._has_position = False
        self.missing: set[int] = set()
        self.offset_ns: int | None = None  # time of the last torque offset; None: none is in force
        self.has_offset = False  # one came in this cycle

    def set_up(self, master: "StandInMaster", period_s: float) -> None:
        """Map the PDOs as the configuration states them, and set mode, period and the watch over the master."""
        write = master.write
        for number, pdo in enumerate(self.sidecar.rpdos):
            _map(master, self.node, PdoRecord(True, number, self.node), pdo, SYNCHRONOUS)
        _map(master, self.node, PdoRecord(True, _OFFSET_RPDO, self.node), self.sidecar.offset, _EVENT_DRIVEN)
        for number, pdo in enumerate(self.sidecar.tpdos):
            kind = SYNCHRONOUS if pdo.is_synchronous else _EVENT_DRIVEN
            _map(master, self.node, PdoRecord(False, number, self.node), pdo, kind)
        write(self.node, objects.INTERPOLATION_EXPONENT, -6 if period_s < 1e-3 else -3)
        write(self.node, objects.INTERPOLATION_PERIOD, round(period_s * (1e6 if period_s < 1e-3 else 1e3)))
        write(self.node, objects.MODE, self.mode)
        write(self.node, objects.ABORT_CONNECTION_OPTION, _TO_FAULT)
        write(self.node, cia301.CONSUMER_HEARTBEAT, MASTER_NODE << 16 | round(3e3 * _HEARTBEAT_S))

    def begin_cycle(self) -> None:
        """Wait for the TPDOs of a new SYNC, and for the sidecar's offset."""
        self.missing = {pdo.cob_id for pdo in self.sidecar.tpdos if pdo.is_synchronous}
        self.has_offset = False

    def take(self, can_id: int, data: bytes, now_ns: int) -> None:
        """Take a frame."""
        if can_id == self.sidecar.offset.cob_id:
            self.offset_ns, self.has_offset = now_ns, True
        elif (fields := self._tpdos.get(can_id)) is not None:
            self.missing.discard(can_id)
            values = fields.unpack(data)
            if objects.STATUSWORD.index in values:
                self.state = profile.drive_state(values[objects.STATUSWORD.index])
            if objects.POSITION_ACTUAL.index in values:
                raw = values[objects.POSITION_ACTUAL.index]
                self.counts = unwrap(self.counts, raw, COUNTER_BITS) if self._has_position else raw
                self._has_position = True

    @property
    def position(self) -> float:
        return self.counts / self._counts_per_unit

    def begin_motion(self) -> None:
        """Let the path begin here."""
        self._trajectory.begin_at(self.position)

    def command(self, request: Request, time_s: float, is_moving: bool) -> list[tuple[int, bytes]]:
        """Return the RPDOs of this cycle: one transition towards ``request``, and the target."""
        position, velocity = self.position, 0.0
        if is_moving:
            position, velocity, _ = self._trajectory.at(time_s)
            velocity += _POSITION_GAIN * (position - self.position)
        elif self.state is DriveState.OPERATION_ENABLED and self._held is not None:
            position = self._held
        self._held = position
        values = {
            objects.CONTROLWORD.index: profile.next_controlword(self.state, request),
            objects.TARGET_POSITION.index: wrap(round(position * self._counts_per_unit)),
            objects.TARGET_VELOCITY.index: round(velocity * self._counts_per_unit),
            objects.MODE.index: int(self.mode),
        }
        return [(fields.cob_id, fields.pack(values)) for fields in self._rpdos]

    _held: float | None = None


class _Fields:
    """Layout of one PDO, by index."""

    def __init__(self, pdo: SidecarPdo) -> None:
        self.cob_id = pdo.cob_id
        self.words = mapping_words(pdo)
        self._layout = struct.Struct("<" + "".join(_CODES[word & 0xFF] for word in self.words))

    def unpack(self, data: bytes) -> dict[int, int]:
        if len(data) != self._layout.size:
            return {}
        return {word >> 16: value for word, value in zip(self.words, self._layout.unpack(data), strict=True)}

    def pack(self, values: Mapping[int, int]) -> bytes:
        return self._layout.pack(*(values.get(word >> 16, 0) for word in self.words))


class StandInMaster:
    """Master of the simulated drives of a sidecar's configuration; raises a `UsageError` for another one.

    ``pace``: real: cycles by the clock; sync: a cycle begins when the drives and, once it has joined, the sidecar have
    answered the one before; the motion begins when the sidecar joins, so that runs are equal bit for bit.
    """

    def __init__(
        self, configuration: "Configuration", axes: "Mapping[str, AxisConfig]", *, pace: Literal["real", "sync"]
    ) -> None:
        config = configuration.bus
        if config is None or config.role != "sidecar":
            raise UsageError("--master needs bus.role: sidecar; otherwise 'run' itself is the master of the drives")
        if not (config.interface in ("udp_multicast", "virtual") or str(config.channel).startswith("vcan")):
            raise UsageError(
                f"--master moves whatever answers, and {bus_name(config)} may have real drives: take udp_multicast, or "
                "a vcan interface"
            )
        self._config, self._period_s = config, configuration.period_s
        self._is_real = pace == "real"
        self._spin_ns = configuration.realtime.spin_us * 1000
        ramps = [getattr(getattr(axis.simulation, "trajectory", None), "ramp_s", 1.0) for axis in axes.values()]
        self._path_time = PathTime(max(ramps, default=1.0))
        self._slaves = [_Slave(name, axis, self._path_time) for name, axis in axes.items()]
        self._bus: FrameBus | None = None
        self._now_ns = 0  # in simulated time
        self._next_heartbeat_ns = 0
        self._is_joined = self._has_ever_joined = False
        self._moving_since_s: float | None = None
        self._enabled_since_s: float | None = None
        self._stopping_since_s: float | None = None
        self.request = Request.ENABLE

    def run(self, is_stopping: Callable[[], bool]) -> None:
        """Set the drives up, move them until ``is_stopping()``, then bring them to rest and disable them."""
        from friction_hil_drivers.canopen.wire.bus import open_frame_bus

        self._bus = open_frame_bus(self._config)
        try:
            self._set_up()
            start_ns = time.monotonic_ns()
            cycle = 0
            while not self._is_done(is_stopping()):
                due, cycle = cycle, self._wait(start_ns, cycle)
                if cycle > due:
                    self._hold(cycle - due)
                self.cycle()
                cycle += 1
        finally:
            self._bus.close()
            self._bus = None

    def cycle(self) -> None:
        """Run one cycle: SYNC, the drives' answers, targets, heartbeat; in simulated time wait for the sidecar."""
        bus, period_ns = self._open_bus, round(self._period_s * 1e9)
        self._drain()
        for slave in self._slaves:
            slave.begin_cycle()
        bus.send(self._config.sync_cob_id, b"")
        self._collect(lambda: not any(slave.missing for slave in self._slaves), 0.5 * self._period_s, _ANSWER_S)
        time_s = self._now_s()
        self._advance(time_s)
        # in simulated time all is as it was until the sidecar joins, however long that takes
        request = self.request if self._is_real or self._has_ever_joined else Request.DISABLE
        for slave in self._slaves:
            for frame in slave.command(request, time_s, self._moving_since_s is not None):
                bus.send(*frame)
        if self._now() >= self._next_heartbeat_ns:
            bus.send(cia301.HEARTBEAT_BASE + MASTER_NODE, bytes([NmtState.OPERATIONAL]))
            self._next_heartbeat_ns = self._now() + round(_HEARTBEAT_S * 1e9)
        if not self._is_real:
            self._await_sidecar()
            self._now_ns += period_ns
        self._clear_old_offsets()

    # The motion

    def _advance(self, time_s: float) -> None:
        """Begin the motion once every drive is enabled and, in simulated time, the sidecar has joined."""
        is_enabled = all(slave.state is DriveState.OPERATION_ENABLED for slave in self._slaves)
        if not is_enabled:
            self._enabled_since_s = self._moving_since_s = None
            return
        if self._enabled_since_s is None and (self._is_real or self._is_joined):
            self._enabled_since_s = time_s
        since = self._enabled_since_s
        is_waiting = self._moving_since_s is None and self._stopping_since_s is None
        if is_waiting and since is not None and time_s - since >= _SETTLE_S:
            self._moving_since_s = time_s
            for slave in self._slaves:
                slave.begin_motion()
            self._path_time.start(time_s)

    def _hold(self, missed: int) -> None:
        """Let the motion go on from where it was ``missed`` periods before: the drives have stood in the meantime."""
        now_s = self._now_s()
        self._path_time.hold(now_s, missed * self._period_s, now_s + self._period_s)

    def _is_done(self, is_stopping: bool) -> bool:
        """Return True once a stop that was asked for is complete, at rest and disabled, or drives do not answer."""
        if not is_stopping:
            return False
        time_s = self._now_s()
        if self._stopping_since_s is None:
            self._stopping_since_s = time_s
            self._path_time.stop(time_s)
        if self._moving_since_s is None or self._path_time.is_standing(time_s):
            self.request = Request.DISABLE
        is_disabled = not any(slave.state.is_powered for slave in self._slaves)
        is_over = time_s - self._stopping_since_s > _STOP_S
        return (self.request is Request.DISABLE and is_disabled) or is_over or not self._is_real

    # Time

    def _now(self) -> int:
        return time.monotonic_ns() if self._is_real else self._now_ns

    def _now_s(self) -> float:
        return self._now() * 1e-9

    def _wait(self, start_ns: int, cycle: int) -> int:
        """In real time, sleep until ``cycle`` begins; return the cycle in progress."""
        if not self._is_real:
            return cycle
        period_ns = round(self._period_s * 1e9)
        begin_ns = start_ns + cycle * period_ns
        self._collect(lambda: False, (begin_ns - self._spin_ns - time.monotonic_ns()) * 1e-9, 0.0)
        while time.monotonic_ns() < begin_ns:
            pass
        return max(cycle, (time.monotonic_ns() - start_ns) // period_ns)

    # Frames

    def _drain(self) -> None:
        while (frame := self._open_bus.receive(0.0)) is not None:
            self._take(*frame)

    def _collect(self, is_complete: Callable[[], bool], real_s: float, stepped_s: float) -> None:
        """Take frames until ``is_complete()``, or for so long."""
        end = time.monotonic() + (real_s if self._is_real else stepped_s)
        while not is_complete() and (left := end - time.monotonic()) > 0.0:
            frame = self._open_bus.receive(left)
            if frame is not None:
                self._take(*frame)

    def _take(self, can_id: int, data: bytes) -> None:
        for slave in self._slaves:
            slave.take(can_id, data, self._now())

    def _await_sidecar(self) -> None:
        """Wait for the offsets of this cycle; a sidecar that has ended is waited for once, and may join again."""
        self._collect(
            lambda: all(slave.has_offset for slave in self._slaves), 0.0, _LOCKSTEP_S if self._is_joined else _JOIN_S
        )
        self._is_joined = all(slave.has_offset for slave in self._slaves)
        self._has_ever_joined |= self._is_joined

    def _clear_old_offsets(self) -> None:
        """Set a torque offset to zero whose sender has fallen silent."""
        for slave in self._slaves:
            if slave.offset_ns is not None and self._now() - slave.offset_ns > _SILENCE_PERIODS * self._period_s * 1e9:
                slave.offset_ns = None
                size = (mapping_words(slave.sidecar.offset)[0] & 0xFF) // 8
                request = Download(objects.TORQUE_OFFSET, 0, size).first()
                self._open_bus.send(cia301.SDO_REQUEST_BASE + slave.node, request)

    # Setting up

    def _set_up(self) -> None:
        for slave in self._slaves:
            self._nmt(NmtCommand.ENTER_PRE_OPERATIONAL, slave.node)
            slave.set_up(self, self._period_s)
        self._open_bus.send(cia301.HEARTBEAT_BASE + MASTER_NODE, bytes([NmtState.OPERATIONAL]))
        for slave in self._slaves:
            self._nmt(NmtCommand.START, slave.node)

    def _nmt(self, command: NmtCommand, node: int) -> None:
        self._open_bus.send(cia301.NMT_ID, bytes((command, node)))

    def write(self, node: int, entry: Object, value: int) -> None:
        """Write an object by SDO; raises a `DriveError` if the drive does not answer, or refuses."""
        download = Download(entry, value)
        talk = Conversation(self._open_bus, answer_s=_ANSWER_S, attempts=_ATTEMPTS)
        talk.hold({node: (transfer for transfer in (download,))})
        if download.is_silent:
            raise DriveError(f"node {node} does not answer (writing {entry})", code=codes.NO_ANSWER)
        if not download.is_accepted:
            raise RefusedError(f"node {node} refuses {value} for {entry}: abort {download.abort_code:08X}h")

    @property
    def _open_bus(self) -> "FrameBus":
        if self._bus is None:
            raise BusError("the bus is not open")
        return self._bus


def make_path(motion: "Motion | None") -> Path:
    """Return the path of a trajectory under ``simulation``; without one the axis is held."""
    if motion is None:
        return still_path
    if motion.kind == "circle":
        return circle_path(motion.radius, motion.frequency, motion.phase)
    if motion.kind == "sine":
        return sine_path(motion.amplitude, motion.frequency, motion.phase)
    if motion.kind == "triangle":
        return triangle_path(motion.amplitude, motion.frequency, motion.rounding)
    return still_path


def _map(master: StandInMaster, node: int, record: PdoRecord, pdo: SidecarPdo, kind: int) -> None:
    """Map a PDO in the order that CiA 301 prescribes."""
    master.write(node, record.cob_id, cia301.PDO_INVALID | pdo.cob_id)
    for entry, value in record.mapping_steps(mapping_words(pdo)):
        master.write(node, entry, value)
    master.write(node, record.transmission_type, kind)
    master.write(node, record.cob_id, pdo.cob_id)
