"""Configuration of a mechanism that two simulated servos share, and its record."""

from collections.abc import Iterator
from itertools import pairwise
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, field_validator, model_validator

from friction_hil.numerics.jit import StructuredArray
from friction_hil.servo.config import ServoConfig
from friction_hil.servo.parts import Finite, NotNegative, Part, Positive
from friction_hil.servo.records import GANTRY, MECHANISM, MOST_TIMES, TWO_LINK_ARM

__all__ = [
    "Gantry",
    "Mechanism",
    "TwoLinkArm",
    "axis_mistakes",
    "hanging_gravity",
    "mechanism_record",
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
    x: Finite = Field(0.0, description="horizontal force on the tool, N")
    y: Finite = Field(0.0, description="upward force on the tool, N")


class TwoLinkArm(_Shared):
    """A planar arm of two links; its axes are shoulder and elbow."""

    kind: Literal["two_link_arm"] = Field(description="a planar arm; its rotary axes are shoulder and elbow")
    links: tuple[Link, Link] = Field(description="upper arm and forearm")
    payload: NotNegative = Field(0.0, description="point mass at the tool, kg")
    gravity: Finite = Field(9.81, description="m/s^2; 0: the arm moves in a horizontal plane")
    tool_force: Annotated[tuple[ToolForce, ...], Field(max_length=MOST_TIMES)] = Field(
        (), description="force at the tool, constant between the times, e.g. of cutting or of a hand"
    )

    @model_validator(mode="after")
    def _is_ordered(self) -> "TwoLinkArm":
        times = [force.time_s for force in self.tool_force]
        if any(after <= before for before, after in pairwise(times)):
            raise ValueError(f"the times of tool_force must rise, not {', '.join(f'{time:g}' for time in times)}")
        return self


Mechanism = Annotated[Gantry | TwoLinkArm, Field(discriminator="kind")]


def axis_mistakes(mechanism: Gantry | TwoLinkArm, name: str, servo: ServoConfig) -> Iterator[tuple[str, str]]:
    """Yield key and message of each setting of a servo that does not go with the mechanism."""
    mechanics, gear = servo.mechanics, servo.gear
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


def mechanism_record(mechanism: Gantry | TwoLinkArm) -> StructuredArray:
    """Return the `MECHANISM` record."""
    record = np.zeros(1, MECHANISM)
    k = record[0]
    if isinstance(mechanism, Gantry):
        _set_gantry(k, mechanism)
    else:
        _set_arm(k, mechanism)
    return record


def reflected_inertias(mechanism: Gantry | TwoLinkArm) -> tuple[float, float]:
    """Return what the mechanism adds to the inertia of each motor, kg or kg m^2.

    Those by which a drive is commissioned: of a gantry the share of its mass in a motion without yaw, of an arm the
    diagonal of the inertia matrix at an elbow of 90 degrees, the mean over its positions.
    """
    k = mechanism_record(mechanism)[0]
    shared = float(k["inertia12"]) if isinstance(mechanism, Gantry) else 0.0
    return float(k["inertia11"]) + shared, float(k["inertia22"]) + shared


def hanging_gravity(mechanism: Gantry | TwoLinkArm) -> tuple[float, float]:
    """Return the torque of gravity at each motor per sine of its position, while the other one is at 0, N m or N.

    Of an arm that hangs straight down this is what a model of one axis can know. A gantry has none.
    """
    k = mechanism_record(mechanism)[0]
    return float(k["gravity1"]) + float(k["gravity2"]), float(k["gravity2"])


def _set_gantry(k: np.void, gantry: Gantry) -> None:
    """Set the inertia matrix J' diag(mass, inertia) J with translation and yaw J = [[1/2, 1/2], [-1/span, 1/span]]."""
    beam, payload, span = gantry.beam, gantry.payload, gantry.span
    k["kind"], k["span"] = GANTRY, span
    k["yaw_stiffness"], k["yaw_damping"] = gantry.yaw_stiffness, gantry.yaw_damping
    mass = beam.mass + payload.mass
    moment = payload.mass * payload.position
    inertia = beam.inertia + moment * payload.position
    along, around, across = 0.25 * mass, inertia / span**2, moment / span
    k["inertia11"], k["inertia12"], k["inertia22"] = along - across + around, along - around, along + across + around


def _set_arm(k: np.void, arm: TwoLinkArm) -> None:
    first, second = arm.links
    k["kind"] = TWO_LINK_ARM
    k["length1"], k["length2"] = first.length, second.length
    carried = second.mass + arm.payload
    moment = second.mass * second.center + arm.payload * second.length  # about the elbow
    elbow = second.inertia + second.mass * second.center**2 + arm.payload * second.length**2
    shoulder = first.inertia + first.mass * first.center**2 + carried * first.length**2
    k["inertia11"], k["inertia12"], k["inertia22"] = shoulder + elbow, elbow, elbow
    k["swing"] = first.length * moment
    k["gravity1"] = arm.gravity * (first.mass * first.center + carried * first.length)
    k["gravity2"] = arm.gravity * moment
    k["tool_forces"][0] = len(arm.tool_force)
    for i, force in enumerate(arm.tool_force):
        k["tool_forces"][1 + 3 * i : 4 + 3 * i] = force.time_s, force.x, force.y
