"""What the simulated drives of several axes share: the mechanism that two of them move."""

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from friction_hil.checked_yaml.messages import Mistake
from friction_hil.checked_yaml.section import Section, key
from friction_hil.config.drivers import SIMULATED_DRIVES, load_driver
from friction_hil.config.external_torque import external_content, simulated_servo
from friction_hil.errors import choices
from friction_hil.servo.config import ServoConfig
from friction_hil.servo.mechanisms import Gantry, Mechanism, TwoLinkArm, axis_mistakes

if TYPE_CHECKING:
    from friction_hil.config.axis import AxisConfig
    from friction_hil.config.schema import Configuration
    from friction_hil.servo.coupled_servos import CoupledServos
    from friction_hil.servo.servo import Servo


class SimulationConfig(Section):
    """What the simulated drives share; each axis has the rest under its own ``simulation``."""

    mechanism: Mechanism = key("mechanism that two axes move together: gantry or two_link_arm")


def mechanism_mistakes(mechanism: Gantry | TwoLinkArm, axes: "Mapping[str, AxisConfig]") -> Iterator[Mistake]:
    """Check the axes of a mechanism."""
    here = ("simulation", "mechanism", "axes")
    servos: dict[str, ServoConfig] = {}
    for index, name in enumerate(mechanism.axes):
        axis = axes.get(name)
        if axis is None:
            yield (*here, index), f"there is no axis {name!r}; {choices(name, axes)}"
        elif not isinstance(axis.simulation, ServoConfig):
            yield (*here, index), f"{name} has no 'simulation' section, which has the inertia of its motor"
        elif not load_driver(axis.driver, SIMULATED_DRIVES).have_common_time:
            yield (
                (*here, index),
                f"{name} has the driver {axis.driver}: simulated drives on serial lines pass their time request by "
                "request, each on its own, so that they cannot share a mechanism; use the driver canopen",
            )
        else:
            servos[name] = axis.simulation
            for field, text in axis_mistakes(mechanism, name, axis.simulation):
                yield ("axes", name, "simulation", *field.split(".")), text
    if len(servos) == len(mechanism.axes):
        first, second = mechanism.axes
        rate, other = (servos[name].integration_hz for name in mechanism.axes)
        if rate != other:
            text = f"is {other:g}, but that of {first} is {rate:g}: axes of one mechanism need the same"
            yield ("axes", second, "simulation", "integration_hz"), text


def simulated_servos(configuration: "Configuration", axes: "Mapping[str, AxisConfig]") -> "dict[str, Servo]":
    """Return a simulated servo for each of the axes, those of a mechanism coupled.

    ``axes``: those to simulate, each with its ``simulation``. Raises `UsageError`: a file with an external torque
    cannot be read.
    """
    servos = {name: _config(axis) for name, axis in axes.items()}
    shared = configuration.simulation
    if shared is None:
        return {name: simulated_servo(config) for name, config in servos.items()}
    mechanism = shared.mechanism
    coupled = coupled_servos(mechanism, [servos[name] for name in mechanism.axes])
    together = dict(zip(mechanism.axes, coupled.servos, strict=True))
    return {name: together.get(name) or simulated_servo(config) for name, config in servos.items()}


def coupled_servos(
    mechanism: Gantry | TwoLinkArm, configs: Sequence[ServoConfig], positions: Sequence[float] = (0.0, 0.0)
) -> "CoupledServos":
    """Return the simulated servos of a mechanism, with the files of their external torques read.

    Raises `UsageError`: a file cannot be read.
    """
    from friction_hil.servo.coupled_servos import CoupledServos

    return CoupledServos(mechanism, configs, positions, [external_content(config) for config in configs])


def _config(axis: "AxisConfig") -> ServoConfig:
    config: Any = axis.simulation
    assert isinstance(config, ServoConfig)
    return config
