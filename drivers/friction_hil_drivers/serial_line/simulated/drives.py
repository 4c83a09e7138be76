"""Simulated drives of some axes on serial lines, in one thread."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal, Protocol

from friction_hil.drive import SimulatedDriver
from friction_hil.errors import BusError, UsageError
from friction_hil_drivers.serial_line.description import Description, load_description
from friction_hil_drivers.serial_line.options import LineOptions, SerialOptions
from friction_hil_drivers.serial_line.protocol import Image, ProtocolFactory
from friction_hil_drivers.serial_line.simulated.drive import SimulatedDrive
from friction_hil_drivers.serial_line.simulated.options import SerialSimulation
from friction_hil_drivers.serial_line.simulated.port import open_port
from friction_hil_drivers.serial_line.simulated.server import Responder, SimulatedLine, serve, serve_in_steps

if TYPE_CHECKING:
    from friction_hil.config import AxisConfig, Configuration


class ResponderFactory(Protocol):
    """Class of the responder of a line; all mappings are by axis."""

    def __call__(
        self, drives: Mapping[str, SimulatedDrive], descriptions: Mapping[str, Any], options: Mapping[str, Any], /
    ) -> Responder:
        """Return the responder for these drives."""
        ...


class SimulatedSerialDrives(SimulatedDriver):
    """Simulated drives of one protocol, on the lines of their axes. A protocol sets the class attributes.

    ``pace`` real: time is that of the monotonic clock, and characters take time on the line; sync: each request that
    reads the position advances the time by one period of the configuration.
    """

    Options = SerialSimulation
    description_type: ClassVar[type[Description]]
    descriptions: ClassVar[Path]  # directory of the descriptions that come with the driver
    responder: ClassVar[ResponderFactory]
    protocol: ClassVar[ProtocolFactory]  # its silence between frames ends a request

    def __init__(
        self, configuration: "Configuration", axes: "Mapping[str, AxisConfig]", *, pace: Literal["real", "sync"]
    ) -> None:
        self._configuration = configuration
        self._axes = dict(axes)
        self._is_real = pace == "real"
        self.lines: list[SimulatedLine] = []

    @staticmethod
    def make_private(configuration: "Configuration", folder: Path) -> "tuple[Configuration, str]":
        """Return the configuration on lines of its own in ``folder``, and the names of its former ports."""
        from friction_hil_drivers.serial_line.simulated.private import private_configuration

        return private_configuration(configuration, folder)

    def open(self) -> str:
        """Compile the simulation and open the ports; return axes, addresses and ports, as text.

        Raises `BusError`: a port does not open; `ConfigurationError` or `UsageError`: a description has mistakes or
        does not fit the axis, the period is not a whole number of integration steps, or axes on one line differ in its
        faults.
        """
        groups: dict[str, list[str]] = {}
        for name in self._axes:
            groups.setdefault(self._line(name).port, []).append(name)
        try:
            return "; ".join([self._open(names) for names in groups.values()])
        except BaseException:
            self.close()
            raise

    def run(self, is_stopping: Callable[[], bool]) -> None:
        """Serve the lines until ``is_stopping()`` is true. Raises `DriveError`: a simulated servo diverged."""
        if not self.lines:
            raise BusError("no port is open: call open() first")
        if not self._is_real:
            serve_in_steps(self.lines, is_stopping)
            return
        spin_ns = self._configuration.realtime.spin_us * 1000
        serve(self.lines, is_stopping, period_ns=round(self._configuration.period_s * 1e9), spin_ns=spin_ns)

    def close(self) -> None:
        """Close the ports. Safe to call twice."""
        for line in self.lines:
            line.port.close()
        self.lines.clear()

    def _open(self, names: list[str]) -> str:
        """Open the line of some axes."""
        descriptions = {name: self._description(name) for name in names}
        drives = {name: self._drive(name, descriptions[name]) for name in names}
        options = {name: self._options(name) for name in names}
        responder = type(self).responder(drives, descriptions, options)
        protocol = type(self).protocol(descriptions, options, {name: Image() for name in names})
        faults = self._simulation(names[0]).line
        for name in names:
            if self._simulation(name).line != faults:
                raise UsageError(
                    f"{name}: simulation.line differs from that of {names[0]}; both are on "
                    f"{self._line(name).port}: make them equal"
                )
        line = self._line(names[0])
        port = open_port(line)
        self.lines.append(
            SimulatedLine(
                port,
                responder,
                list(drives.values()),
                line,
                faults,
                silence_chars=protocol.silence_chars,
                is_real=self._is_real,
            )
        )
        listed = ", ".join(f"{name}={options[name].address}" for name in names)
        return f"{listed} on {port.where}"

    def _drive(self, name: str, description: Description) -> SimulatedDrive:
        from friction_hil.config.external_torque import simulated_servo
        from friction_hil.drive import Mode

        simulation = self._simulation(name)
        period_s = self._configuration.period_s
        servo = simulated_servo(simulation)
        servo.set_period(period_s)
        simulated_servo(simulation).advance(1)  # numba compiles now, before the cyclic phase
        return SimulatedDrive(
            name,
            description,
            servo,
            Mode[self._axes[name].mode.upper()],
            self._options(name).units,
            None if self._is_real else round(period_s * servo.steps_per_second),
        )

    def _description(self, name: str) -> Description:
        kind = type(self)
        given, source = self._options(name).description, self._configuration.source_path
        return load_description(given, source, kind.descriptions, kind.description_type)

    def _options(self, name: str) -> SerialOptions:
        options = self._axes[name].options
        assert isinstance(options, SerialOptions)
        return options

    def _line(self, name: str) -> LineOptions:
        return self._options(name).line

    def _simulation(self, name: str) -> SerialSimulation:
        simulation = self._axes[name].simulation
        assert isinstance(simulation, SerialSimulation)
        return simulation
