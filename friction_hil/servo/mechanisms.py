"""Configuration of a mechanism that several simulated servos share, its record and its links."""

from collections.abc import Iterator
from itertools import pairwise
from typing import Annotated, Literal, NamedTuple

import numpy as np
from pydantic import AfterValidator, Field, field_validator

from friction_hil.dynamics import inertial
from friction_hil.dynamics.arm import Arm
from friction_hil.dynamics.newton_euler import LINK, PARAMETERS
from friction_hil.numerics.jit import Array, StructuredArray
from friction_hil.servo.config import ServoConfig
from friction_hil.servo.parts import Finite, NotNegative, Part, Positive
from friction_hil.servo.records import ARM, GANTRY, MECHANISM, MOST_TIMES

__all__ = [
    "Gantry",
    "Linkage",
    "ToolForces",
    "TwoLinkArm",
    "axis_mistakes",
    "hanging_gravity",
    "mechanism_record",
    "planar",
    "reflected_inertias",
]

AxisName = Annotated[str, Field(min_length=1)]


class _Shared(Part):
    """A mechanism that two axes move."""

    axes: tuple[AxisName, AxisName] = Field(description="names of its two axes")

    @field_validator("axes")
    @classmethod
    def _are_two(cls, axes: tuple[str, str]) -> tuple[str, str]:
        if axes[0] == axes[1]:
            raise ValueError(f"needs two different axes, not {axes[0]} twice")
        return axes


class Beam(Part):
    """Beam of a gantry, with its middle halfway between the two motors."""

    mass: Positive = Field(description="kg, with the carriages at its ends")
    inertia: NotNegative = Field(description="rotary inertia about its middle, kg m^2")


class Payload(Part):
    """Mass on the beam of a gantry."""

    mass: NotNegative = Field(description="kg")
    position: Finite = Field(0.0, description="from the middle of the beam towards the second axis, m")


class Gantry(_Shared):
    """A beam that two linear motors move; small yaw."""

    kind: Literal["gantry"] = Field(description="a beam that two linear axes move: translation and yaw")
    span: Positive = Field(description="distance between the two motors, m")
    beam: Beam = Field(description="the beam")
    payload: Payload = Field(Payload(mass=0.0), description="mass on the beam")
    yaw_stiffness: NotNegative = Field(0.0, description="stiffness of the guides against yaw of the beam, N m/rad")
    yaw_damping: NotNegative = Field(0.0, description="damping of the yaw, N m s/rad")


class Link(Part):
    """One link of an arm."""

    length: Positive = Field(description="from its joint to the next joint, or to the tool, m")
    mass: Positive = Field(description="kg, with all that it carries; the motor of the elbow belongs to the first link")
    center: Finite = Field(description="from its joint to its centre of mass, m; negative behind the joint")
    inertia: NotNegative = Field(0.0, description="about its centre of mass, kg m^2")


class ToolForce(Part):
    """Force at the tool from a time on."""

    time_s: NotNegative = Field(description="since the start of the simulation, s")
    x: Finite = Field(0.0, description="horizontal force on the tool, N; of an arm in space along x of its base")
    y: Finite = Field(0.0, description="upward force on the tool, N; of an arm in space along y of its base")
    z: Finite = Field(0.0, description="along z of the base, N; the bearings of a planar arm take it")


def _rising(forces: tuple[ToolForce, ...]) -> tuple[ToolForce, ...]:
    times = [force.time_s for force in forces]
    if any(after <= before for before, after in pairwise(times)):
        raise ValueError(f"the times of tool_force must rise, not {', '.join(f'{time:g}' for time in times)}")
    return forces


ToolForces = Annotated[
    tuple[ToolForce, ...],
    Field(max_length=MOST_TIMES, description="force at the tool, constant between the times, e.g. of cutting"),
    AfterValidator(_rising),
]


class TwoLinkArm(_Shared):
    """A planar arm of two links; its axes are shoulder and elbow."""

    kind: Literal["two_link_arm"] = Field(description="a planar arm; its rotary axes are shoulder and elbow")
    links: tuple[Link, Link] = Field(description="upper arm and forearm")
    payload: NotNegative = Field(0.0, description="point mass at the tool, kg")
    gravity: Finite = Field(9.81, description="m/s^2; 0: the arm moves in a horizontal plane")
    tool_force: ToolForces = ()


class Linkage(NamedTuple):
    """An arm whose joints are axes, without the rotors of their motors."""

    axes: tuple[str, ...]  # their names, in the order of the joints
    arm: Arm
    tool: Arm  # the same links with one mass alone: 1 kg at the tool
    tool_force: tuple[ToolForce, ...] = ()


def axis_mistakes(mechanism: Gantry | TwoLinkArm | Linkage, name: str, servo: ServoConfig) -> Iterator[tuple[str, str]]:
    """Yield key and message of each setting of a servo that does not go with the mechanism."""
    mechanics, gear = servo.mechanics, servo.gear
    if isinstance(mechanism, Linkage):
        index = mechanism.axes.index(name)
        wanted = "linear" if mechanism.arm.is_linear[index] else "rotary"
        mine = f"arm, with the joint {mechanism.arm.joints[index]!r},"
    else:
        wanted, mine = ("linear", "gantry") if mechanism.kind == "gantry" else ("rotary", "two-link arm")
    if mechanics.axis != wanted:
        yield "mechanics.axis", f"must be {wanted}: {name} is an axis of the {mine} of simulation.mechanism"
    behind = f"is not for an axis of simulation.mechanism, which {name} moves through a rigid joint"
    for key, is_given in (
        ("mechanics.load", mechanics.load is not None),
        ("mechanics.inertia_variation", bool(mechanics.inertia_variation)),
        ("gear.transmission_error", bool(gear.transmission_error)),
        ("gear.hysteresis", gear.hysteresis is not None),
    ):
        if is_given:
            yield key, behind


def mechanism_record(mechanism: Gantry | Linkage) -> StructuredArray:
    """Return the `MECHANISM` record."""
    record = np.zeros(1, MECHANISM)
    k = record[0]
    if isinstance(mechanism, Gantry):
        k["kind"], k["span"], k["inertia"] = GANTRY, mechanism.span, _inertia(mechanism).ravel()
        k["yaw_stiffness"], k["yaw_damping"] = mechanism.yaw_stiffness, mechanism.yaw_damping
        return record
    k["kind"], k["tool_forces"][0] = ARM, len(mechanism.tool_force)
    for i, force in enumerate(mechanism.tool_force):
        k["tool_forces"][1 + 4 * i : 5 + 4 * i] = force.time_s, -force.x, -force.y, -force.z
    return record


def _inertia(gantry: Gantry) -> Array:
    """Return J' diag(mass, inertia) J with translation and yaw J = [[1/2, 1/2], [-1/span, 1/span]]."""
    beam, payload, span = gantry.beam, gantry.payload, gantry.span
    mass = beam.mass + payload.mass
    moment = payload.mass * payload.position
    inertia = beam.inertia + moment * payload.position
    along, around, across = 0.25 * mass, inertia / span**2, moment / span
    return np.array([[along - across + around, along - around], [along - around, along + across + around]])


def planar(arm: TwoLinkArm) -> Linkage:
    """Return the links of a planar arm, with x to the right, y upwards, and both joints about z."""
    links = np.zeros(2, LINK)
    links["parent"], links["order"], links["sign"] = (-1, 0), (0, 1), 1.0
    links["rotation"], links["axis"] = np.eye(3).ravel(), (0.0, 0.0, 1.0)
    links["origin"][1] = 0.0, -arm.links[0].length, 0.0
    for link, part in zip(links, arm.links, strict=True):
        around = np.diag([0.0, 0.0, part.inertia])
        link["parameters"] = inertial.parameters_of(part.mass, np.array([0.0, -part.center, 0.0]), around)
    tool = np.zeros((2, PARAMETERS))
    tool[1] = inertial.parameters_of(1.0, np.array([0.0, -arm.links[1].length, 0.0]), np.zeros((3, 3)))
    links["parameters"] += arm.payload * tool
    found = Arm(arm.axes, np.array([0.0, -arm.gravity, 0.0]), links)
    return Linkage(arm.axes, found, found.with_parameters(tool), arm.tool_force)


def reflected_inertias(mechanism: Gantry | TwoLinkArm | Linkage) -> tuple[float, ...]:
    """Return what the mechanism adds to the inertia of each motor, kg or kg m^2.

    Those by which a drive is commissioned: of a gantry the share of its mass in a motion without yaw, of a two-link arm
    the diagonal of the inertia matrix at an elbow of 90 degrees, the mean over its positions, of another arm that at 0.
    """
    if isinstance(mechanism, Gantry):
        return tuple(map(float, _inertia(mechanism).sum(axis=1)))
    at = np.zeros(len(mechanism.axes))
    if isinstance(mechanism, TwoLinkArm):
        mechanism, at[1] = planar(mechanism), 0.5 * np.pi
    return tuple(map(float, np.diag(mechanism.arm.inertia_matrix(at))))


def hanging_gravity(mechanism: Gantry | TwoLinkArm | Linkage) -> tuple[float, ...]:
    """Return the torque of gravity at each motor per sine of its position, while the others are at 0, N m or N.

    Of an arm that hangs straight down this is what a model of one axis can know. A gantry has none.
    """
    if isinstance(mechanism, Gantry):
        return 0.0, 0.0
    arm = (planar(mechanism) if isinstance(mechanism, TwoLinkArm) else mechanism).arm
    turned = 0.5 * np.pi * np.eye(len(arm))
    return tuple(map(float, 0.5 * np.diag(arm.gravity(turned) - arm.gravity(-turned))))
