"""What the simulated drives of several axes share: the mechanism that they move."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import Field

from friction_hil.checked_yaml.messages import Mistake
from friction_hil.checked_yaml.section import Section, key
from friction_hil.config.arm import ArmFile, Point
from friction_hil.config.axis import Name
from friction_hil.config.drivers import SIMULATED_DRIVES, load_driver
from friction_hil.config.external_torque import external_content, simulated_servo
from friction_hil.errors import ConfigurationError, Problem, UsageError, choices
from friction_hil.servo.config import ServoConfig
from friction_hil.servo.mechanisms import Gantry, Linkage, ToolForces, TwoLinkArm, axis_mistakes

if TYPE_CHECKING:
    from friction_hil.checked_yaml.text import FieldPath
    from friction_hil.config.axis import AxisConfig
    from friction_hil.config.schema import Configuration
    from friction_hil.servo.coupled_servos import CoupledServos
    from friction_hil.servo.servo import Servo


class Tool(Section):
    """Point at which a force acts."""

    position: Point = key("in the frame of the link", "m", default=(0.0, 0.0, 0.0))
    link: str | None = key("link or body that has it; by default that of the last axis", default=None)


class UrdfArm(ArmFile):
    """An arm of any number of joints from a file."""

    kind: Literal["urdf"] = key("urdf: an arm of any number of joints, from a URDF or MJCF file")
    axes: dict[Name, str] = key("joint of the file by axis; joints that are left out are locked", min_length=1)
    tool: Tool = key("point at which tool_force acts", default=Tool())
    tool_force: ToolForces = ()

    def linkage(self) -> Linkage:
        """Read the file and return the arm; errors are those of `friction_hil.dynamics.load`."""
        none = dict.fromkeys(self.axes.values(), 0.0)  # inertia of rotors: `mechanics.inertia` of the axes has theirs
        arm = self.loaded(self.axes, self.payload, rotor_inertia=none)
        alone = self.point_mass(self.axes, self.tool.position, self.tool.link)
        return Linkage(tuple(self.axes), arm, arm.with_parameters(alone), self.tool_force)


Mechanism = Annotated[Gantry | TwoLinkArm | UrdfArm, Field(discriminator="kind")]


class SimulationConfig(Section):
    """What the simulated drives share; each axis has the rest under its own ``simulation``."""

    mechanism: Mechanism = key("mechanism that axes move together: gantry, two_link_arm or urdf")


def mechanism_mistakes(mechanism: Mechanism, axes: "Mapping[str, AxisConfig]") -> Iterator[Mistake]:
    """Check the axes of a mechanism."""
    here = ("simulation", "mechanism", "axes")
    servos: dict[str, ServoConfig] = {}
    for position, name in enumerate(mechanism.axes):
        axis, index = axes.get(name), name if isinstance(mechanism, UrdfArm) else position
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
    if isinstance(mechanism, UrdfArm):  # `check_joints` has the rest, for which its file is needed
        for name in sorted(mechanism.signs.keys() - mechanism.axes.keys()):
            yield (*here[:2], "signs", name), f"is no axis of the mechanism; {choices(name, mechanism.axes)}"
    else:
        for name, servo in servos.items():
            for field, text in axis_mistakes(mechanism, name, servo):
                yield ("axes", name, "simulation", *field.split(".")), text
    rates = {name: servo.integration_hz for name, servo in servos.items()}
    for name, rate in rates.items():
        first, other = next(iter(rates.items()))
        if rate != other:
            text = f"is {rate:g}, but that of {first} is {other:g}: axes of one mechanism need the same"
            yield ("axes", name, "simulation", "integration_hz"), text


def check_joints(configuration: "Configuration", locate: "Callable[[FieldPath, str], Problem]") -> None:
    """Check the axes of an arm against the joints of its file.

    Raises `ConfigurationError`: the file has mistakes, or does not go with the axes or other keys.
    """
    mechanism = None if configuration.simulation is None else configuration.simulation.mechanism
    if not isinstance(mechanism, UrdfArm):
        return
    try:
        linkage = mechanism.linkage()
    except ConfigurationError:
        raise
    except UsageError as error:
        raise ConfigurationError([locate(("simulation", "mechanism"), str(error))]) from None
    problems = [
        locate(("axes", name, "simulation", *field.split(".")), text)
        for name in mechanism.axes
        for field, text in axis_mistakes(linkage, name, _config(configuration.axes[name]))
    ]
    if problems:
        raise ConfigurationError(problems)


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
    mechanism: Mechanism, configs: Sequence[ServoConfig], positions: Sequence[float] | None = None
) -> "CoupledServos":
    """Return the simulated servos of a mechanism, with the files of arm and external torques read.

    Raises `UsageError`: a file cannot be read, or a joint of it does not go with its axis.
    """
    from friction_hil.servo.coupled_servos import CoupledServos

    externals = [external_content(config) for config in configs]
    return CoupledServos(moved(mechanism), configs, positions, externals)


def moved(mechanism: Mechanism) -> Gantry | TwoLinkArm | Linkage:
    """Return a mechanism as the simulated servos take it, with its file read; errors are those of `UrdfArm.linkage`."""
    return mechanism.linkage() if isinstance(mechanism, UrdfArm) else mechanism


def _config(axis: "AxisConfig") -> ServoConfig:
    config: Any = axis.simulation
    assert isinstance(config, ServoConfig)
    return config
