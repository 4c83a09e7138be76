"""The arm that axes of a configuration move: its file, and which of its joints each of them is."""

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import Field, PrivateAttr

from friction_hil import dynamics
from friction_hil.checked_yaml.messages import Mistake
from friction_hil.checked_yaml.section import MOST_POSITION, POSITION, Section, key
from friction_hil.config.axis import Name
from friction_hil.dynamics import Arm
from friction_hil.errors import ConfigurationError, Problem, UsageError, choices

if TYPE_CHECKING:
    from friction_hil.checked_yaml.text import FieldPath
    from friction_hil.config.axis import AxisConfig
    from friction_hil.numerics.jit import Array

Coordinate = Annotated[float, Field(ge=-MOST_POSITION, le=MOST_POSITION)]
Point = tuple[Coordinate, Coordinate, Coordinate]
Inertia = Annotated[float, Field(ge=0, le=1e9)]
Ratio = Annotated[float, Field(gt=0, le=1e6)]
_BY_AXIS = ("signs", "rotor_inertia", "gear", "drive_inertia")
_FOLLOWS_MODEL = "follows weight and inertia of the model file, which on an axis of the arm are those of the arm"


class ArmPayload(Section):
    """What the arm carries."""

    mass: float = key("mass", "kg", ge=0, le=1e6)
    center: Point = key("centre of mass in the frame of the link", "m", default=(0.0, 0.0, 0.0))
    inertia: tuple[float, float, float, float, float, float] = key(
        "Ixx, Ixy, Ixz, Iyy, Iyz, Izz about the centre of mass", "kg m^2", default=(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    )
    link: str | None = key("link or body that carries it; by default that of the last joint", default=None)


class ArmFile(Section):
    """An arm from its file."""

    file: Path = key("URDF or MJCF of the arm: a path relative to this file")
    signs: dict[Name, Literal[1, -1]] = key("-1 for an axis that counts against its joint", default={})
    locked: dict[str, Coordinate] = key(
        "position of joints that are left out, by default as the file draws them", POSITION, default={}
    )
    payload: ArmPayload | None = key("what the arm carries", default=None)
    gravity: Point | None = key(
        "acceleration of gravity in the frame of the base; by default that of the file, or [0, 0, -9.81]",
        "m/s^2",
        default=None,
    )

    def loaded(self, joints: Mapping[str, str], payload: ArmPayload | None, **rotors: Mapping[str, float]) -> Arm:
        """Return the dynamics of joints by axis; ``rotors`` and errors are those of `friction_hil.dynamics.load`."""
        return dynamics.load(
            self.file,
            list(joints.values()),
            signs=[self.signs.get(name, 1) for name in joints],
            locked=self.locked,
            payload=None if payload is None else dynamics.Payload(**dict(payload)),
            gravity=self.gravity,
            **rotors,
        )

    def point_mass(self, joints: Mapping[str, str], center: Point, link: str | None) -> "Array":
        """Return the inertial parameters of the joints if there were nothing but 1 kg at a point of a link."""
        one = ArmPayload(mass=1.0, center=center, link=link)
        return self.loaded(joints, one).parameters - self.loaded(joints, None).parameters


class ArmConfig(ArmFile):
    """The arm whose joints are axes: its gravity, inertia and coupling are fed forward, and load the friction."""

    joints: dict[Name, str] = key("joint of the file by axis; joints that are left out are locked", min_length=1)
    rotor_inertia: dict[Name, Inertia] = key(
        "inertia of the motor's rotor by axis, at the motor; by default the file's armature", "kg m^2", default={}
    )
    gear: dict[Name, Ratio] = key(
        "turns of the motor for one of the joint, or rad per m, by axis, for rotor_inertia alone", "1", default={}
    )
    drive_inertia: dict[Name, Inertia] = key(
        "inertia by which a drive in csp or csv itself feeds the acceleration of its set-point forward, by axis; 0: it "
        "does not. The arm's goes without it; by default the joint's own is left to the drive",
        "kg m^2 or kg",
        default={},
    )
    box: tuple[Point, Point] | None = key(
        "space that 'tune' does not leave with the origin of a joint or the centre of the payload: its lower and its "
        "upper corner in the frame of the base",
        "m",
        default=None,
    )

    _dynamics: Arm | None = PrivateAttr(default=None)

    @property
    def dynamics(self) -> Arm:
        """Its dynamics, with the joints in the order of ``joints``; a `UsageError`: its file was not read."""
        if self._dynamics is None:
            raise UsageError(f"the arm {self.file} was not read: load the configuration from its file")
        return self._dynamics

    def ordered(self, axes: "Sequence[str]") -> Arm:
        """Return its dynamics with the joints in the order of ``axes``, which are those of ``joints``."""
        found, names = self.dynamics, list(self.joints)
        links = found.links.copy()
        links["order"] = [axes.index(names[k]) for k in links["order"]]
        return replace(found, joints=tuple(self.joints[name] for name in axes), links=links)

    def read(self) -> None:
        """Read the file; errors are those of `friction_hil.dynamics.load`."""
        by_axis = {"gear": self.gear, "rotor_inertia": self.rotor_inertia}
        rotors = {key: {self.joints[name]: each for name, each in given.items()} for key, given in by_axis.items()}
        self._dynamics = self.loaded(self.joints, self.payload, **rotors)


def arm_mistakes(arm: ArmConfig, axes: "Mapping[str, AxisConfig]") -> Iterator[Mistake]:
    """Check the axes of an arm, as far as that needs no file."""
    for name in arm.joints:
        if name not in axes:
            yield ("arm", "joints", name), f"there is no axis {name!r}; {choices(name, axes)}"
            continue
        mechanics, compensation = axes[name].model.mechanics, axes[name].compensation
        if mechanics.gravity != type(mechanics.gravity)():
            text = f"stands beside arm, whose joint {arm.joints[name]} has the weight already: remove it here"
            yield ("axes", name, "model", "mechanics", "gravity"), text
        for field, is_given in (
            ("velocity", compensation.velocity == "kalman"),
            ("adaptation", compensation.adaptation is not None),
            ("learning", compensation.learning != "off"),
            ("transmission", compensation.transmission is not None),
        ):
            if is_given:
                text = "must not be kalman, which" if field == "velocity" else "must be off, because it"
                yield ("axes", name, "compensation", field), f"{text} {_FOLLOWS_MODEL}"
        if name in arm.drive_inertia and axes[name].mode == "cst":
            yield ("arm", "drive_inertia", name), "is not for mode cst, in which the drive gets no set-point: remove it"
    if arm.box is not None and not all(low < high for low, high in zip(*arm.box, strict=True)):
        yield ("arm", "box"), "the first corner must be below the second one in x, y and z"
    for group in _BY_AXIS:
        for name in getattr(arm, group):
            if name not in arm.joints:
                yield ("arm", group, name), f"is no axis of arm.joints; {choices(name, arm.joints)}"


def read_arm(arm: ArmConfig, axes: "Mapping[str, AxisConfig]", locate: "Callable[[FieldPath, str], Problem]") -> None:
    """Read the file of an arm, whose `ArmConfig.dynamics` it then has.

    Raises `ConfigurationError`: the file has mistakes, or does not go with the axes.
    """
    if not os.path.isfile(arm.file):
        raise ConfigurationError([locate(("arm", "file"), f"there is no file {arm.file}")])
    try:
        arm.read()
    except ConfigurationError:
        raise
    except UsageError as error:
        text = str(error)
        group = text.partition(":")[0]
        steps: FieldPath = ("arm", group if group in ArmConfig.model_fields else "file")
        wrong = [name for name, joint in arm.joints.items() if f"no joint {joint!r} " in text]
        raise ConfigurationError([locate(("arm", "joints", wrong[0]) if wrong else steps, text)]) from None
    problems = []
    for (name, joint), is_linear in zip(arm.joints.items(), arm.dynamics.is_linear, strict=True):
        kind, is_prismatic = axes[name].model.axis, "prismatic" if is_linear else "a hinge"
        if is_linear != (kind == "linear"):
            text = f"joint {joint!r} is {is_prismatic}, but the model of {name} is of a {kind} axis"
            problems.append(locate(("arm", "joints", name), text))
    if problems:
        raise ConfigurationError(problems)
