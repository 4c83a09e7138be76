"""Simulated drives of some axes on one bus, in one thread."""

import math
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from friction_hil.drive import AxisFacts, Mode, SimulatedDriver
from friction_hil.errors import BusError
from friction_hil_drivers.canopen.cycle.delays import ACTUATION_CYCLES, SETPOINT_CYCLES
from friction_hil_drivers.canopen.options import canopen_options
from friction_hil_drivers.canopen.simulated.options import SimulationOptions
from friction_hil_drivers.canopen.simulated.presence import Presence
from friction_hil_drivers.canopen.wire.interfaces import bus_name

if TYPE_CHECKING:
    from friction_hil.config import AxisConfig, Configuration
    from friction_hil_drivers.canopen.simulated.master import StandInMaster
    from friction_hil_drivers.canopen.simulated.node import SimulatedNode
    from friction_hil_drivers.canopen.wire.frames import FrameBus

_IDLE_TIMEOUT_S = 2.5e-4  # between frames time passes this often, so that little is left to integrate at a SYNC
_SYNC_TIMEOUT_S = 0.1
_AHEAD_NS = 400_000  # before a SYNC: then the state that it will sample is computed


class SimulatedCanopenDrives(SimulatedDriver):
    """One CANopen node for each axis, each with its ``simulation``.

    ``pace``: real: in step with the monotonic clock; sync: time passes by one period of the configuration at each SYNC
    and not otherwise, so that the drives' behaviour is a function of the frames. ``bus``: an open bus, used instead of
    the configuration's.
    """

    Options = SimulationOptions
    have_common_time = True  # all nodes sample at one SYNC and take set-points before the next: axes may be coupled

    def __init__(
        self,
        configuration: "Configuration",
        axes: "Mapping[str, AxisConfig]",
        *,
        pace: Literal["real", "sync"],
        bus: Any = None,
    ) -> None:
        self._configuration = configuration
        self._axes = dict(axes)
        self._is_real = pace == "real"
        self._given_bus = bus
        self._bus: FrameBus | None = None
        self._presence: Presence | None = None
        self.nodes: list[SimulatedNode] = []
        self._start_ns = 0

    @staticmethod
    def make_master(
        configuration: "Configuration", axes: "Mapping[str, AxisConfig]", *, pace: Literal["real", "sync"]
    ) -> "StandInMaster":
        """Return a stand-in for the controller that moves the drives beside a sidecar; see `StandInMaster`."""
        # imported here: without --master nobody needs it
        from friction_hil_drivers.canopen.simulated.master import StandInMaster

        return StandInMaster(configuration, axes, pace=pace)

    @staticmethod
    def make_private(configuration: "Configuration", folder: Path) -> "tuple[Configuration, str]":
        """Return the configuration on a bus of its own, and the name of its former bus; ``folder`` is not used."""
        from friction_hil_drivers.canopen.simulated.private import private_configuration

        return private_configuration(configuration)

    @staticmethod
    def simulated_facts(name: str, axis: "AxisConfig", period_s: float) -> AxisFacts:
        """Return what the driver finds of the simulated drive of an axis, which takes set-points at SYNC."""
        servo, mode = axis.simulation, Mode[axis.mode.upper()]
        assert isinstance(servo, SimulationOptions)
        turn = math.tau if servo.mechanics.axis == "rotary" else 1.0
        return AxisFacts(
            name,
            identity="",
            position_resolution=turn / servo.encoder.position_counts,
            torque_resolution=servo.motor.rated_torque / 1000.0,
            setpoint_delay_s=SETPOINT_CYCLES[mode] * period_s,
            actuation_delay_s=ACTUATION_CYCLES * period_s,
        )

    def open(self) -> str:
        """Compile the servos, open the bus and let every node send its boot-up message; return nodes and bus in words.

        Raises `BusError`: the bus does not open, or a node of the same number is on it. `UsageError`: an EDS is
        invalid, or the period is not a whole number of integration steps.
        """
        # imported here: python-can, canopen and numba take a second, and reading a configuration needs none of them
        from friction_hil.config.simulation import simulated_servos
        from friction_hil_drivers.canopen.simulated.assembly import compile_servo, make_node
        from friction_hil_drivers.canopen.wire.bus import open_frame_bus

        config = self._configuration.bus
        assert config is not None  # the driver's options have checked it
        if self._given_bus is None and config.interface != "virtual":  # other processes are on it
            self._presence = Presence(config, sorted({canopen_options(axis).node for axis in self._axes.values()}))
        self._bus = open_frame_bus(config, self._given_bus)
        if self._presence is not None:
            self._presence.ask(self._bus)
        for servo in simulated_servos(self._configuration, self._axes).values():
            compile_servo(servo)
        servos = simulated_servos(self._configuration, self._axes)
        nodes = {
            name: make_node(self._configuration, axis, servos[name], self._send, is_real=self._is_real)
            for name, axis in self._axes.items()
        }
        self.nodes = list(nodes.values())
        if self._presence is not None:
            self._presence.require_silence(self._bus)
        self._bus.on_remote = self._take_remote
        for node in self.nodes:
            node.boot()
        listed = ", ".join(f"{name}=node {node.number}" for name, node in nodes.items())
        notes = [f"\nnote: {name}: {note}" for name, node in nodes.items() for note in node.notes]
        return f"{listed} on {bus_name(config)}{''.join(notes)}"

    def run(self, is_stopping: Callable[[], bool]) -> None:
        """Serve the bus until ``is_stopping()`` is true.

        Raises `BusError`: the bus is gone. `DriveError`: a simulated servo diverged.
        """
        if self._is_real:
            self._run_in_real_time(is_stopping)
        else:
            self._run_by_sync(is_stopping)

    def _run_by_sync(self, is_stopping: Callable[[], bool]) -> None:
        bus = self._open_bus
        while not is_stopping():
            if (frame := bus.receive(self._wait_s())) is not None:
                self._take(*frame, 0)
            self._answer()

    def _run_in_real_time(self, is_stopping: Callable[[], bool]) -> None:
        bus = self._open_bus
        period_ns = round(self._configuration.period_s * 1e9)
        spin_ns = self._configuration.realtime.spin_us * 1000
        self._start_ns, now_ns, next_sync_ns = time.monotonic_ns(), 0, 0
        while not is_stopping():
            left_ns = next_sync_ns - now_ns
            frame = bus.receive(_patience_s(left_ns, spin_ns))
            now_ns = time.monotonic_ns() - self._start_ns
            if frame is None:
                self._advance(now_ns, is_sync_near=left_ns < _AHEAD_NS)
            else:
                if any(frame[0] == node.sync_id for node in self.nodes):
                    next_sync_ns = now_ns + period_ns
                self._take(*frame, now_ns)
            self._poll(now_ns)
            self._answer()

    def _wait_s(self) -> float:
        """Return how long to wait for a frame where time passes at SYNC only, s."""
        late = [due_s for node in self.nodes if (due_s := node.answers_in_s) is not None]
        return min(_SYNC_TIMEOUT_S, *late) if late else _SYNC_TIMEOUT_S

    def _answer(self) -> None:
        """Send the late SDO answers that are due."""
        for node in self.nodes:
            node.answer()

    def _advance(self, now_ns: int, *, is_sync_near: bool) -> None:
        """Let time pass, shortly before a SYNC up to the state that it will sample."""
        for node in self.nodes:
            node.advance_to(now_ns)
            if is_sync_near:
                node.prepare()

    def _poll(self, now_ns: int) -> None:
        """Let the nodes whose timers are due act."""
        for node in self.nodes:
            if node.needs_poll(now_ns):
                node.advance_to(now_ns)
                node.poll()

    def _take(self, can_id: int, data: bytes, now_ns: int) -> None:
        """Give a frame to the nodes that it concerns; all answer before any of them does its other work."""
        receivers = [node for node in self.nodes if node.listens_to(can_id)]
        for node in receivers:
            node.advance_to(now_ns)
            node.receive(can_id, data)
        for node in receivers:
            if node.needs_poll(now_ns):
                node.poll()

    def _take_remote(self, can_id: int, _: int) -> None:
        """Give a remote frame to the nodes."""
        for node in self.nodes:
            if self._is_real:
                node.advance_to(time.monotonic_ns() - self._start_ns)
            node.receive_remote(can_id)

    def close(self) -> None:
        """Leave the bus. Safe to call twice."""
        if self._bus is not None:
            self._bus.close()
            self._bus = None
        if self._presence is not None:
            self._presence.release()
            self._presence = None

    def _send(self, can_id: int, data: bytes) -> None:
        self._open_bus.send(can_id, data)

    @property
    def _open_bus(self) -> "FrameBus":
        if self._bus is None:
            raise BusError("the bus is not open: call open() first")
        return self._bus


def _patience_s(left_ns: int, spin_ns: int) -> float:
    """Return how long to wait for a frame, s: around the next SYNC not at all, so that it is answered at once."""
    if left_ns > spin_ns:
        return min((left_ns - spin_ns) * 1e-9, _IDLE_TIMEOUT_S)
    return 0.0 if left_ns >= -spin_ns else _IDLE_TIMEOUT_S
