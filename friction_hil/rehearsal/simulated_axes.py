"""Axes of a configuration with their simulated drives, ready to be rehearsed without a bus, alone or coupled."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

from friction_hil.config.drivers import SIMULATED_DRIVES, load_driver
from friction_hil.config.simulation import Mechanism
from friction_hil.errors import UsageError
from friction_hil.numerics.readable import POSITION_UNITS
from friction_hil.servo.config import ServoConfig

if TYPE_CHECKING:
    from friction_hil.config import AxisConfig, Configuration
    from friction_hil.drive import AxisFacts


@dataclass(frozen=True, slots=True)
class SimulatedAxis:
    """An axis with its simulated drive."""

    name: str
    config: "AxisConfig"  # as in the configuration
    servo: ServoConfig  # its ``simulation``
    facts: "AxisFacts"  # what the driver finds of this drive: resolution and delays
    period_s: float  # of the loop

    @property
    def unit(self) -> str:
        """Unit of the position."""
        return POSITION_UNITS[self.config.model.axis]


@dataclass(frozen=True, slots=True)
class SimulatedMachine:
    """Axes that are simulated together."""

    axes: tuple[SimulatedAxis, ...]  # one, or those of the mechanism, in its order
    mechanism: Mechanism | None = None  # what the axes move


def simulated_machines(configuration: "Configuration") -> tuple[SimulatedMachine, ...]:
    """Return the axes of a configuration that have a simulated drive, in its order; those of a mechanism together.

    Raises `UsageError`: no axis has one, or its driver cannot say what it would find of one.
    """
    found = {}
    for name, axis in configuration.axes.items():
        if isinstance(axis.simulation, ServoConfig):
            facts = _facts(name, axis, configuration.period_s)
            found[name] = SimulatedAxis(name, axis, axis.simulation, facts, configuration.period_s)
    if not found:
        raise UsageError(
            "no axis has a section 'simulation', which describes the machine to be simulated (config/machines has "
            "examples)"
        )
    mechanism = None if configuration.simulation is None else configuration.simulation.mechanism
    coupled = () if mechanism is None else tuple(mechanism.axes)
    machines = []
    for name, each in found.items():
        if name not in coupled:
            machines.append(SimulatedMachine((each,)))
        elif mechanism is not None and not any(machine.mechanism for machine in machines):
            machines.append(SimulatedMachine(tuple(found[other] for other in coupled), mechanism))
    return tuple(machines)


def _facts(name: str, axis: "AxisConfig", period_s: float) -> "AxisFacts":
    facts = load_driver(axis.driver, SIMULATED_DRIVES).simulated_facts(name, axis, period_s)
    if facts is None:
        raise UsageError(
            f"{name}: the delays of simulated drives of the driver {axis.driver} are known only while a line is open, "
            "so that the axis cannot be simulated without one; use driver: canopen"
        )
    return facts
