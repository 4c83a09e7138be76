"""Bodies and joints as a file states them, and the tree of links that is left when all other joints are locked."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from friction_hil.dynamics import inertial
from friction_hil.dynamics.newton_euler import LINK, PRISMATIC, REVOLUTE
from friction_hil.dynamics.rotations import Pose, about
from friction_hil.errors import ConfigurationError, Problem, UsageError, choices
from friction_hil.numerics.jit import Array, StructuredArray


@dataclass(frozen=True, slots=True)
class Joint:
    """A joint between a body and its parent."""

    name: str
    line: int
    kind: int = REVOLUTE  # or PRISMATIC
    axis: Array = field(default_factory=lambda: np.array([0.0, 0.0, 1.0]))  # in the body's frame, of length 1
    anchor: Array = field(default_factory=lambda: np.zeros(3))  # a point of the axis in the body's frame, m
    zero: float = 0.0  # position at which the body has its pose, rad or m
    armature: float = 0.0  # kg m^2 or kg
    refusal: str = ""  # why it cannot be one of the arm's joints
    mimic: tuple[str, float, float] | None = None  # it follows this joint, by factor and offset


@dataclass(frozen=True, slots=True)
class Body:
    """A body with the joints that move it, the first one next to the parent."""

    name: str
    line: int
    parent: int  # index of its parent, which comes before it; -1: it is the world
    pose: Pose  # in its parent's frame, with each joint at its zero
    joints: tuple[Joint, ...]
    parameters: Array  # (10,), in its own frame
    refusal: str = ""  # why the arm cannot carry it


@dataclass(frozen=True, slots=True)
class Stated:
    """What a file states of an arm."""

    path: str
    bodies: tuple[Body, ...]
    gravity: Array  # (3,), in the frame of the world, m/s^2

    def refuse(self, line: int, element: str, message: str) -> ConfigurationError:
        """Return the error for a mistake in the file."""
        return refusal(self.path, line, element, message)


def refusal(path: str, line: int | None, element: str, message: str) -> ConfigurationError:
    """Return the error for a mistake in a file."""
    return ConfigurationError([Problem(path, line, element, message)])


def choose(stated: Stated, wanted: Sequence[str] | None) -> tuple[str, ...]:
    """Return the joints of the arm in their order; raise an error for what none can be."""
    there = {joint.name: joint for body in stated.bodies for joint in body.joints}
    names = tuple(wanted) if wanted is not None else tuple(name for name, each in there.items() if not each.mimic)
    if not names:
        raise UsageError(f"{stated.path} has no joint that moves" if wanted is None else "joints must name a joint")
    for name in names:
        if name not in there:
            raise UsageError(f"{stated.path} has no joint {name!r} that moves; {choices(name, there)}")
        if names.count(name) > 1:
            raise UsageError(f"joints names {name!r} twice")
        joint = there[name]
        if joint.mimic is not None:
            text = f"follows {joint.mimic[0]!r} (mimic) and has no position of its own: leave it out of joints"
            raise stated.refuse(joint.line, f"joint {name!r}", text)
        if joint.refusal:
            raise stated.refuse(joint.line, f"joint {name!r}", joint.refusal)
    for name, joint in there.items():
        if joint.mimic is not None and joint.mimic[0] in names:
            text = f"follows {joint.mimic[0]!r} (mimic): such joints are not computed; leave {joint.mimic[0]!r} out of "
            raise stated.refuse(joint.line, f"joint {name!r}", f"{text}joints")
        if joint.mimic is not None and joint.mimic[0] not in there:
            text = f"follows {joint.mimic[0]!r}, which is no joint that moves; {choices(joint.mimic[0], there)}"
            raise stated.refuse(joint.line, f"joint {name!r}", text)
    return names


def positions(stated: Stated, names: Sequence[str], locked: Mapping[str, float]) -> dict[str, float]:
    """Return the position of each joint that does not move: as given, that of its mimic, or its zero."""
    there = {joint.name: joint for body in stated.bodies for joint in body.joints}
    for name, position in locked.items():
        if name not in there:
            raise UsageError(f"locked: {stated.path} has no joint {name!r} that moves; {choices(name, there)}")
        if name in names:
            raise UsageError(f"locked: {name!r} is one of the joints that move")
        if there[name].mimic is not None:
            raise UsageError(f"locked: {name!r} follows {there[name].mimic[0]!r} (mimic)")  # type: ignore[index]
        if not np.isfinite(position):
            raise UsageError(f"locked: the position of {name!r} must be finite, not {position!r}")
    found = {name: locked.get(name, each.zero) for name, each in there.items() if name not in names}
    for name, each in there.items():
        if each.mimic is not None:
            leader, factor, offset = each.mimic
            if there[leader].mimic is not None:
                text = f"follows {leader!r}, which follows another joint: not read"
                raise stated.refuse(each.line, f"joint {name!r}", text)
            found[name] = factor * found[leader] + offset
    return found


def reduce(stated: Stated, names: Sequence[str], locked: Mapping[str, float]) -> StructuredArray:
    """Return the `LINK` records of joints, with all that they carry; ``locked`` has the positions of the others."""
    links = np.zeros(len(names), LINK)
    made = 0
    place: list[tuple[int, Pose]] = []  # of each body: the link that carries it, and its pose in the link's frame
    for body in stated.bodies:
        carrier, above = place[body.parent] if body.parent >= 0 else (-1, Pose())
        pose = above @ body.pose
        for joint in body.joints:
            if joint.name in names:
                start = pose @ Pose(position=joint.anchor)
                link = links[made]
                link["parent"], link["kind"], link["order"] = carrier, joint.kind, list(names).index(joint.name)
                link["sign"], link["zero"], link["armature"] = 1.0, joint.zero, joint.armature
                link["rotation"], link["origin"], link["axis"] = start.rotation.ravel(), start.position, joint.axis
                carrier, pose, made = made, Pose(position=-joint.anchor), made + 1
            else:
                pose = pose @ _moved(joint, locked[joint.name] - joint.zero)
        if carrier >= 0:
            if body.refusal:
                raise stated.refuse(body.line, f"body {body.name!r}", body.refusal)
            links[carrier]["parameters"] += inertial.seen_from(pose, body.parameters)
        place.append((carrier, pose))
    return links


def _moved(joint: Joint, by: float) -> Pose:
    if joint.kind == PRISMATIC:
        return Pose(position=by * joint.axis)
    turn = about(joint.axis, by)
    return Pose(turn, joint.anchor - turn @ joint.anchor)
