"""The friction of a joint in an MJCF file, with the defaults of its classes. Files that are included are not read."""

import math
import xml.etree.ElementTree as ET
from dataclasses import dataclass

from friction_hil.dynamics.mjcf_defaults import MAIN, Classes, classes, with_defaults
from friction_hil.dynamics.xml_input import choose, numbers
from friction_hil.errors import UsageError

_STIFF_IMPEDANCE = 0.999  # of the dry friction, of 0.9999 that MuJoCo allows: hardly a joint creeps to be seen


@dataclass(frozen=True, slots=True)
class Joint:
    """Friction of a joint, SI."""

    axis: str  # "rotary" or "linear"
    frictionloss: float
    armature: float
    damping: tuple[float, float, float]  # factors of v, v |v| and v^3, with those of a motor for the friction
    lugre: tuple[float, ...] | None  # stiffness, damping, Coulomb level, break-away level, Stribeck velocity
    cogging: tuple[float, float, float] | None  # amplitude, poles and phase of the motor's torque
    is_stated: bool  # the file gives a frictionloss or LuGre friction, and not MuJoCo's default of zero
    notes: tuple[str, ...]  # what of the actuators on the joint is not read


def find(root: ET.Element, path: str, name: str | None) -> Joint:
    """Return the joint of a name, or the only one with friction; raise UsageError where there is none."""
    defaults = classes(root, path)
    joints: dict[str, dict[str, str]] = {}
    for body in root.findall("worldbody"):
        _joints(body, MAIN, defaults, joints, path)
    elsewhere = "; files that it includes are not read" if root.find(".//include") is not None else ""
    motors = _motors(root, defaults, path)
    has_friction = [
        each
        for each, own in joints.items()
        if name is None
        and (any(any(_numbers(own, key, path, each)) for key in ("frictionloss", "damping")) or each in motors)
    ]
    chosen = choose(joints, has_friction, path, name, elsewhere)
    notes = (*_soft(joints[chosen], f"{path}: joint {chosen!r}"), *_of_other_actuators(root, chosen))
    return _joint(joints[chosen], motors.get(chosen), f"{path}: joint {chosen!r}", path, chosen, notes)


def _joint(
    own: dict[str, str], motor: dict[str, str] | None, where: str, path: str, name: str, notes: tuple[str, ...]
) -> Joint:
    kind = own.get("type", "hinge")
    if kind not in ("hinge", "slide"):
        raise UsageError(f"{where} is of type {kind!r}, not one axis")
    if any(numbers(own.get("springdamper", "0"), f"{where}: springdamper", 1, 2)):
        raise UsageError(
            f"{where} has a springdamper, for which MuJoCo computes the damping from the inertia: write the damping "
            "that it finds (mjModel.dof_damping) in its place"
        )
    damping = _three(_numbers(own, "damping", path, name))
    armature = _numbers(own, "armature", path, name)[0]
    lugre = cogging = None
    if motor is not None:
        if numbers(motor.get("gear", "1"), f"{where}: gear of its dcmotor", 1, 6)[0] != 1.0:
            raise UsageError(f"{where}: its dcmotor has a gear of {motor['gear']}; only 1 can be read")
        armature += numbers(motor.get("armature", "0"), f"{where}: armature of its dcmotor", 1, 1)[0]
        more = _three(numbers(motor.get("damping", "0"), f"{where}: damping of its dcmotor", 1, 3))
        damping = (damping[0] + more[0], damping[1] + more[1], damping[2] + more[2])
        levels = numbers(motor.get("lugre", "0 0 0 0 0"), f"{where}: lugre", 1, 5)
        lugre = (*levels, *[0.0] * (5 - len(levels))) if levels[0] > 0.0 else None
        cogging = _cogging(motor.get("cogging"), where)
    return Joint(
        "rotary" if kind == "hinge" else "linear",
        _numbers(own, "frictionloss", path, name)[0],
        armature,
        damping,
        lugre,
        cogging,
        "frictionloss" in own or lugre is not None,
        notes,
    )


def _soft(own: dict[str, str], where: str) -> tuple[str, ...]:
    """Return a sentence about a dry friction that is soft, as it is by default in MuJoCo."""
    level = numbers(own.get("frictionloss", "0"), f"{where}: frictionloss", 1, 1)[0]
    impedance = numbers(own.get("solimpfriction", "0.9"), f"{where}: solimpfriction", 1, 5)[0]
    if level == 0.0 or impedance >= _STIFF_IMPEDANCE:
        return ()
    return (
        f"not in the model: MuJoCo's dry friction is soft here (solimpfriction {impedance:g}), and a joint that is "
        "pushed with less than frictionloss creeps",
    )


def _of_other_actuators(root: ET.Element, joint: str) -> tuple[str, ...]:
    """Return sentences about damping and armature that other actuators add to a joint."""
    notes = []
    for element in root.findall("actuator/*"):
        given = [f"{key} {element.get(key)}" for key in ("damping", "armature") if element.get(key) is not None]
        if element.tag != "dcmotor" and element.get("joint") == joint and given:
            notes.append(f"left out: {' and '.join(given)} of the actuator <{element.tag}> on this joint")
    return tuple(notes)


def _cogging(text: str | None, where: str) -> tuple[float, float, float] | None:
    if text is None:
        return None
    try:
        values = [float(word) for word in text.split()]
    except ValueError:
        values = []
    if len(values) != 3 or not all(map(math.isfinite, values)) or values[1] < 0.0:
        raise UsageError(f"{where}: cogging {text!r} must be amplitude, poles and phase")
    return (values[0], values[1], values[2]) if values[0] != 0.0 and values[1] > 0.0 else None


def _joints(
    body: ET.Element,
    current: str,
    defaults: Classes,
    joints: dict[str, dict[str, str]],
    path: str,
) -> None:
    current = body.get("childclass", current)
    for element in body:
        if element.tag == "joint":
            attributes = with_defaults(element, current, defaults, path)
            name = attributes.get("name", f"joint {len(joints) + 1}")
            if name in joints:
                raise UsageError(f"{path}: several joints have the name {name!r}")
            joints[name] = attributes
        elif element.tag in ("body", "frame", "replicate"):
            _joints(element, current, defaults, joints, path)


def _motors(root: ET.Element, defaults: Classes, path: str) -> dict[str, dict[str, str]]:
    """Return the motors with friction of their own, by the joint that they act on."""
    motors: dict[str, dict[str, str]] = {}
    for element in root.findall("actuator/dcmotor"):
        attributes = with_defaults(element, MAIN, defaults, path)
        joint = attributes.get("joint")
        if joint is None or not {"lugre", "cogging", "damping", "armature"} & set(attributes):
            continue
        if joint in motors:
            raise UsageError(f"{path}: several dcmotors with friction act on the joint {joint!r}")
        motors[joint] = attributes
    return motors


def _numbers(attributes: dict[str, str], key: str, path: str, joint: str) -> list[float]:
    return numbers(attributes.get(key, "0"), f"{path}: joint {joint!r}: {key}", 1, 3 if key == "damping" else 1)


def _three(values: list[float]) -> tuple[float, float, float]:
    first, second, third = [*values, 0.0, 0.0][:3]
    return first, second, third
