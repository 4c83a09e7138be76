"""Axes of a configuration with their simulated drives, ready to be rehearsed without a bus, alone or coupled."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

from friction_hil.config.drivers import SIMULATED_DRIVES, load_driver
from friction_hil.errors import UsageError
from friction_hil.servo.config import ServoConfig
from friction_hil.servo.mechanisms import Gantry, TwoLinkArm

if TYPE_CHECKING:
    from friction_hil.config import AxisConfig, Configuration
    from friction_hil.drive import AxisFacts


@dataclass(frozen=True, slots=True)
class SimulatedAxis:
    """An axis with its simulated drive.

    Attributes
    ----------
    name : str
    config : AxisConfig
        As in the configuration.
    servo : ServoConfig
        Its ``simulation``.
    facts : AxisFacts
        What the driver finds of this drive: resolution and delays.
    period_s : float
        Period of the loop.
    """

    name: str
    config: "AxisConfig"
    servo: ServoConfig
    facts: "AxisFacts"
    period_s: float

    @property
    def unit(self) -> str:
        """Unit of the position."""
        return "rad" if self.config.model.axis == "rotary" else "m"


@dataclass(frozen=True, slots=True)
class SimulatedMachine:
    """Axes that are simulated together.

    Attributes
    ----------
    axes : tuple of SimulatedAxis
        One, or the two of the mechanism, in its order.
    mechanism : Gantry or TwoLinkArm or None
        What two axes move.
    """

    axes: tuple[SimulatedAxis, ...]
    mechanism: Gantry | TwoLinkArm | None = None


def simulated_machines(configuration: "Configuration") -> tuple[SimulatedMachine, ...]:
    """Return the axes of a configuration that have a simulated drive, in its order; those of a mechanism together.

    Raises
    ------
    UsageError
        No axis has one, or its driver cannot say what it would find of one.
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
    coupled = () if mechanism is None else mechanism.axes
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
