"""Axes of a configuration with their simulated drives, ready to be rehearsed without a bus."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

from friction_hil.config.drivers import SIMULATED_DRIVES, load_driver
from friction_hil.errors import UsageError
from friction_hil.servo.config import ServoConfig

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


def simulated_axes(configuration: "Configuration") -> tuple[SimulatedAxis, ...]:
    """Return the axes of a configuration that have a simulated drive of their own, in its order.

    Axes of a common mechanism are left out: each of them moves with the other only.

    Raises
    ------
    UsageError
        No axis has one, or its driver cannot say what it would find of one.
    """
    found = []
    coupled = () if configuration.simulation is None else configuration.simulation.mechanism.axes
    for name, axis in configuration.axes.items():
        if isinstance(axis.simulation, ServoConfig) and name not in coupled:
            facts = _facts(name, axis, configuration.period_s)
            found.append(SimulatedAxis(name, axis, axis.simulation, facts, configuration.period_s))
    if not found and coupled:
        raise UsageError(
            f"{' and '.join(coupled)} move a mechanism together, and one axis cannot be simulated without the other; "
            "'friction-hil run CONFIG --simulate' shows what compensation does on both"
        )
    if not found:
        raise UsageError(
            "no axis has a section 'simulation', which describes the machine to be simulated (config/machines has "
            "examples)"
        )
    return tuple(found)


def _facts(name: str, axis: "AxisConfig", period_s: float) -> "AxisFacts":
    find = getattr(load_driver(axis.driver, SIMULATED_DRIVES), "simulated_facts", None)
    if find is None:
        raise UsageError(
            f"{name}: the delays of simulated drives of the driver {axis.driver} are known only while a line is open, "
            "so that the axis cannot be simulated without one; use driver: canopen"
        )
    facts: AxisFacts = find(name, axis, period_s)
    return facts
