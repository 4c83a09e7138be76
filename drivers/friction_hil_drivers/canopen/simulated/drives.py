"""Simulated drives of some axes on one bus, in one thread."""

import time
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, Literal

from friction_hil.errors import BusError, UsageError
from friction_hil_drivers.canopen import objects
from friction_hil_drivers.canopen.bus import bus_name, open_bus
from friction_hil_drivers.canopen.frames import FrameBus, frame_bus
from friction_hil_drivers.canopen.simulated.options import SimulationOptions

if TYPE_CHECKING:
    from friction_hil.config import AxisConfig, Configuration
    from friction_hil.servo.servo import Servo
    from friction_hil_drivers.canopen.simulated.dictionary import Dictionary
    from friction_hil_drivers.canopen.simulated.node import SimulatedNode

_IDLE_TIMEOUT_S = 2.5e-4  # between frames time passes this often, so that little is left to integrate at a SYNC
_SYNC_TIMEOUT_S = 0.1
_AHEAD_NS = 400_000  # so long before a SYNC what it will sample is computed


class SimulatedCanopenDrives:
    """One CANopen node an axis.

    Parameters
    ----------
    configuration : Configuration
        Its bus and period.
    axes : mapping of str to AxisConfig
        The axes to simulate, each with its ``simulation``.
    pace : {"real", "sync"}
        real: in step with the monotonic clock. sync: time passes by one period of the configuration at each
        SYNC and not otherwise, so that all that happens is a function of the frames.
    bus : can.BusABC, optional
        An open bus to be used in place of the configuration's.
    """

    Options = SimulationOptions

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
        self._nodes: list[SimulatedNode] = []

    def open(self) -> str:
        """Compile everything, open the bus and let every node say that it is there.

        Returns
        -------
        str
            Which nodes there are and on which bus, for people.

        Raises
        ------
        BusError
            The bus does not open.
        UsageError
            An EDS is none, or the period is not a whole number of integration steps.
        """
        assert self._configuration.bus is not None  # the driver's options have checked it
        nodes = {name: self._make_node(axis) for name, axis in self._axes.items()}
        self._nodes = list(nodes.values())
        config = self._configuration.bus
        where = bus_name(config)
        self._bus = frame_bus(self._given_bus or open_bus(config), config, where)
        for node in self._nodes:
            node.boot()
        listed = ", ".join(f"{name}=node {node.number}" for name, node in nodes.items())
        return f"{listed} on {where}"

    def run(self, is_stopping: Callable[[], bool]) -> None:
        """Serve the bus until ``is_stopping()`` is true.

        Raises
        ------
        BusError
            The bus is gone.
        DriveError
            A simulated servo diverged.
        """
        nodes, bus = self._nodes, self._open_bus
        if not self._is_real:
            while not is_stopping():
                if (frame := bus.receive(_SYNC_TIMEOUT_S)) is not None:
                    self._take(*frame, 0)
            return
        period_ns = round(self._configuration.period_s * 1e9)
        spin_ns = self._configuration.realtime.spin_us * 1000
        start_ns, now_ns, next_sync_ns = time.monotonic_ns(), 0, 0
        while not is_stopping():
            # around the moment of the next SYNC, busy waiting: the answer shall not wait for this process to wake up
            left_ns = next_sync_ns - now_ns
            if left_ns > spin_ns:
                frame = bus.receive(min((left_ns - spin_ns) * 1e-9, _IDLE_TIMEOUT_S))
            else:
                frame = bus.receive(0.0 if left_ns >= -spin_ns else _IDLE_TIMEOUT_S)
            now_ns = time.monotonic_ns() - start_ns
            if frame is not None:
                if frame[0] == objects.SYNC_ID:
                    next_sync_ns = now_ns + period_ns
                self._take(*frame, now_ns)
            for node in nodes:
                if frame is None:
                    node.advance_to(now_ns)
                    if left_ns < _AHEAD_NS:
                        node.prepare()
                if node.needs_poll(now_ns):
                    node.advance_to(now_ns)
                    node.poll()

    def _take(self, can_id: int, data: bytes, now_ns: int) -> None:
        """Give a frame to the nodes; all answer before any of them does what else there is to do."""
        concerned = [node for node in self._nodes if node.listens_to(can_id)]
        for node in concerned:
            node.advance_to(now_ns)
            node.receive(can_id, data)
        for node in concerned:
            if node.needs_poll(now_ns):
                node.poll()

    def close(self) -> None:
        """Leave the bus. Safe to call twice."""
        if self._bus is not None:
            self._bus.close()
            self._bus = None

    def _make_node(self, axis: "AxisConfig") -> "SimulatedNode":
        from friction_hil.drive import Mode
        from friction_hil.servo.servo import Servo
        from friction_hil_drivers.canopen.simulated.drive import SimulatedCia402Drive
        from friction_hil_drivers.canopen.simulated.node import SimulatedNode

        simulation = axis.simulation
        assert isinstance(simulation, SimulationOptions)
        number: int = getattr(axis.options, "node")  # noqa: B009 - the driver's options, known to it alone
        servo = Servo(simulation)
        modes = [Mode[name.upper()] for name in simulation.canopen.supported_modes]
        _compile(Servo(simulation))
        steps = self._steps_per_period(servo)
        return SimulatedNode(
            number,
            self._dictionary(number, simulation),
            lambda dictionary, emergencies: SimulatedCia402Drive(servo, dictionary, emergencies, modes),
            self._send,
            sync_steps=None if self._is_real else steps,
            lock_steps=steps if self._is_real else None,
        )

    def _dictionary(self, number: int, simulation: SimulationOptions) -> "Dictionary":
        from friction_hil_drivers.canopen.eds import SIMULATED_SERVO
        from friction_hil_drivers.canopen.simulated.dictionary import Dictionary

        shown = simulation.canopen
        path = SIMULATED_SERVO
        if shown.eds is not None:
            source = self._configuration.source_path
            path = shown.eds if source is None else source.parent / shown.eds
        dictionary = Dictionary.from_eds(path, number, shown.missing)
        for known, value in (
            (objects.VENDOR_ID, shown.vendor_id),
            (objects.PRODUCT_CODE, shown.product_code),
            (objects.REVISION_NUMBER, shown.revision),
            (objects.SERIAL_NUMBER, number if shown.serial is None else shown.serial),
        ):
            if value is not None:
                dictionary.set_default(known, value)
        return dictionary

    def _steps_per_period(self, servo: "Servo") -> int:
        exact = self._configuration.period_s * servo.steps_per_second
        steps = round(exact)
        if steps < 1 or abs(exact - steps) > 1e-6:
            raise UsageError(
                f"the period must be a whole number of integration steps of the simulated servo; "
                f"{self._configuration.period_s:g} s is {exact:g} of them (integration_hz)"
            )
        return steps

    def _send(self, can_id: int, data: bytes) -> None:
        self._open_bus.send(can_id, data)

    @property
    def _open_bus(self) -> FrameBus:
        if self._bus is None:
            raise BusError("the bus is not open: call open() first")
        return self._bus


def _compile(servo: "Servo") -> None:
    """Let numba compile what the servo runs through, in each mode, before time counts."""
    for mode in (8, 9, 10):
        servo.command(mode, 0.0)
        servo.advance(1)
    servo.quick_stop(1.0)
    servo.advance(1)
