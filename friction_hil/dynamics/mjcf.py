"""The bodies and joints of an MJCF file (MuJoCo's XML reference). What cannot be computed is refused by name."""

import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from friction_hil.dynamics import inertial, rotations
from friction_hil.dynamics.bodies import Body, Joint, Stated, refusal
from friction_hil.dynamics.mjcf_defaults import MAIN, Classes, classes, with_defaults
from friction_hil.dynamics.newton_euler import PARAMETERS, PRISMATIC, REVOLUTE
from friction_hil.dynamics.rotations import Pose
from friction_hil.dynamics.xml_input import vector
from friction_hil.errors import ConfigurationError
from friction_hil.numerics.jit import Array

_KINDS = {"hinge": REVOLUTE, "slide": PRISMATIC}
_MAKE_BODIES = ("attach", "composite", "flexcomp", "include", "replicate")
_ORIENTATIONS = {"quat": 4, "axisangle": 4, "euler": 3, "xyaxes": 6, "zaxis": 3}  # and the count of numbers
_CHANGE_MASSES = {"balanceinertia": "false", "boundmass": "0", "boundinertia": "0", "settotalmass": "-1"}
_COMPILED = (
    "let MuJoCo write what it computes: <compiler saveinertial='true'/>, mujoco.mj_saveLastXML('arm.xml', model)"
)
_NO_VOLUME = ("plane", "hfield")


@dataclass(slots=True)
class _Reader:
    path: str
    lines: dict[ET.Element, int]
    defaults: Classes
    compiler: Mapping[str, str]
    bodies: list[Body] = field(default_factory=list)
    joints: dict[str, int] = field(default_factory=dict)  # lines by name
    refusals: dict[str, str] = field(default_factory=dict)  # of joints, by name
    armatures: dict[str, float] = field(default_factory=dict)  # that actuators add to joints

    def wrong(self, element: ET.Element, message: str) -> ConfigurationError:
        name = element.get("name")
        return refusal(
            self.path, self.lines[element], f"{element.tag} {name!r}" if name else f"<{element.tag}>", message
        )

    def numbers(self, element: ET.Element, given: Mapping[str, str], name: str, default: str, count: int) -> Array:
        try:
            return vector(given.get(name, default), count, count)
        except ValueError as error:
            raise self.wrong(element, f"{name} {error}") from None

    def number(self, element: ET.Element, given: Mapping[str, str], name: str) -> float:
        return float(self.numbers(element, given, name, "0", 1)[0])

    def angle(self, degrees_or_radians: float) -> float:
        return degrees_or_radians if self.compiler.get("angle") == "radian" else float(np.deg2rad(degrees_or_radians))

    def pose(self, element: ET.Element, given: Mapping[str, str]) -> Pose:
        return Pose(self.rotation(element, given), self.numbers(element, given, "pos", "0 0 0", 3))

    def rotation(self, element: ET.Element, given: Mapping[str, str]) -> Array:
        stated = [name for name in _ORIENTATIONS if name in given]
        if len(stated) > 1:
            raise self.wrong(element, f"has several orientations: {', '.join(stated)}")
        if not stated:
            return np.eye(3)
        values = self.numbers(element, given, stated[0], "", _ORIENTATIONS[stated[0]])
        directions = {"axisangle": [values[:3]], "xyaxes": [values[:3], values[3:]]}.get(stated[0], [values])
        if stated[0] != "euler" and any(np.linalg.norm(each) < 1e-10 for each in directions):
            raise self.wrong(element, f"{stated[0]} must have a length, not {given[stated[0]]!r}")
        if stated[0] == "quat":
            return rotations.of_quaternion(values)
        if stated[0] == "axisangle":
            return rotations.about(values[:3] / np.linalg.norm(values[:3]), self.angle(values[3]))
        if stated[0] == "zaxis":
            return rotations.of_z_axis(values)
        if stated[0] == "xyaxes":
            if np.linalg.norm(np.cross(values[:3], values[3:])) < 1e-10:
                raise self.wrong(element, f"the axes of xyaxes are parallel: {given['xyaxes']!r}")
            return rotations.of_x_and_y(values[:3], values[3:])
        return rotations.of_euler(np.array([self.angle(each) for each in values]), self.compiler.get("eulerseq", "xyz"))

    def children(self, element: ET.Element, parent: int, outer: Pose, current: str) -> None:
        """Read the bodies within a body, the world or a frame."""
        for each in element:
            if each.tag in _MAKE_BODIES:
                raise self.wrong(each, f"is not read; {_COMPILED}")
            inner = each.get("childclass", current)
            if each.tag == "frame":
                self.children(each, parent, outer @ self.pose(each, each.attrib), inner)
            elif each.tag == "body":
                self.body(each, parent, outer, inner)

    def body(self, element: ET.Element, parent: int, outer: Pose, current: str) -> None:
        index = len(self.bodies)
        joints = self.within(element, Pose(), current)
        parameters, refused = self.mass(element, current)
        if self.number(element, element.attrib, "gravcomp"):
            refused = "has gravcomp, which takes gravity away from it: remove it"
        name = element.get("name", f"body {index + 1}")
        pose = outer @ self.pose(element, element.attrib)
        self.bodies.append(Body(name, self.lines[element], parent, pose, tuple(joints), parameters, refused))
        self.children(element, index, Pose(), current)

    def within(self, element: ET.Element, frame: Pose, current: str) -> list[Joint]:
        """Return the joints of a body, also those within its frames."""
        found = []
        for each in element:
            if each.tag in ("joint", "freejoint"):
                found.append(self.joint(each, frame, current))
            elif each.tag == "frame":
                inner = frame @ self.pose(each, each.attrib)
                found += self.within(each, inner, each.get("childclass", current))
        return found

    def joint(self, element: ET.Element, frame: Pose, current: str) -> Joint:
        given = with_defaults(element, current, self.defaults, self.path)
        if element.tag == "freejoint":
            given = {**element.attrib, "type": "free"}
        name, line = given.get("name", f"joint {len(self.joints) + 1}"), self.lines[element]
        if name in self.joints:
            raise self.wrong(element, f"has the name of the one in line {self.joints[name]}")
        self.joints[name] = line
        kind = given.get("type", "hinge")
        if kind not in _KINDS:
            text = f"is of type {kind!r}, not 'hinge' or 'slide': choose others with joints; it is locked then"
            return Joint(name, line, refusal=text)
        axis = frame.rotation @ self.numbers(element, given, "axis", "0 0 1", 3)
        length = float(np.linalg.norm(axis))
        if length < 1e-6:
            raise self.wrong(element, "the axis has no length")
        refused = self.refusals.get(name, "")
        for key in ("stiffness", "springdamper"):
            if any(word.strip("0.") for word in given.get(key, "0").split()):
                refused = f"has a {key}: springs are not computed; remove it"
        zero = self.number(element, given, "ref")
        armature = self.number(element, given, "armature")
        if armature < 0.0:
            raise self.wrong(element, f"armature must not be negative, not {armature:g}")
        anchor = frame.position + frame.rotation @ self.numbers(element, given, "pos", "0 0 0", 3)
        zero = self.angle(zero) if kind == "hinge" else zero
        armature += self.armatures.get(name, 0.0)
        return Joint(name, line, _KINDS[kind], axis / length, anchor, zero, armature, refused)

    def mass(self, element: ET.Element, current: str) -> tuple[Array, str]:
        """Return the parameters of a body, and why they are not known."""
        given = element.find("inertial")
        if given is None or self.compiler.get("inertiafromgeom") == "true":
            geoms = [
                each for each in element.iter("geom") if self.is_of(each, element) and self.has_mass(each, current)
            ]
            text = f"has no <inertial>, and that of its geom in line {self.lines[geoms[0]]}" if geoms else ""
            return np.zeros(PARAMETERS), f"{text} is not computed; {_COMPILED}" if geoms else ""
        if "mass" not in given.attrib:
            raise self.wrong(given, "lacks mass")
        kilograms = self.number(given, given.attrib, "mass")
        if "fullinertia" in given.attrib:
            xx, yy, zz, xy, xz, yz = self.numbers(given, given.attrib, "fullinertia", "", 6)
            inertia = inertial.inertia_of(np.array([xx, xy, xz, yy, yz, zz]))
        else:
            inertia = np.diag(self.numbers(given, given.attrib, "diaginertia", "0 0 0", 3))
        if text := inertial.mistake(kilograms, inertia):
            raise self.wrong(given, text)
        parameters = inertial.parameters_of(kilograms, np.zeros(3), inertia)
        return inertial.seen_from(self.pose(given, given.attrib), parameters), ""

    def is_of(self, geom: ET.Element, body: ET.Element) -> bool:
        """Return whether a geom is the body's own, not that of a body within it."""
        return not any(geom in inner.iter("geom") for inner in body.iter("body") if inner is not body)

    def has_mass(self, geom: ET.Element, current: str) -> bool:
        given = with_defaults(geom, current, self.defaults, self.path)
        low, high = self.numbers(geom, self.compiler, "inertiagrouprange", "0 5", 2)
        is_counted = low <= self.number(geom, given, "group") <= high
        return (
            is_counted
            and given.get("type") not in _NO_VOLUME
            and self.number(geom, {"mass": given.get("mass", given.get("density", "1000"))}, "mass") != 0.0
        )


def read(root: ET.Element, lines: dict[ET.Element, int], path: str) -> Stated:
    """Return what an MJCF file states; raise ConfigurationError with the line of what cannot be read."""
    compiler: dict[str, str] = {}
    for element in root.findall("compiler"):
        compiler |= element.attrib
    reader = _Reader(path, lines, classes(root, path), compiler)
    for element in root.findall("compiler"):
        for name, neutral in _CHANGE_MASSES.items():
            if element.get(name, neutral) != neutral:
                raise reader.wrong(element, f"{name} changes masses or inertias and is not read; {_COMPILED}")
        if element.get("coordinate", "local") != "local":
            raise reader.wrong(element, "coordinate='global' is not read")
        sequence = element.get("eulerseq", "xyz")
        if len(sequence) != 3 or set(sequence.lower()) - set("xyz"):
            raise reader.wrong(element, f"eulerseq must be three of x, y, z, X, Y, Z, not {sequence!r}")
    for element in root.iter("include"):
        raise reader.wrong(element, f"is not read; {_COMPILED}")
    _find_couplings(reader, root)
    gravity = np.array([0.0, 0.0, -9.81])
    for option in root.findall("option"):
        gravity = reader.numbers(option, option.attrib, "gravity", " ".join(map(str, gravity)), 3)
        if any(flag.get("gravity") == "disable" for flag in option.findall("flag")):
            gravity = np.zeros(3)
    for world in root.findall("worldbody"):
        reader.children(world, -1, Pose(), world.get("childclass", MAIN))
    return Stated(path, tuple(reader.bodies), gravity)


def _find_couplings(reader: _Reader, root: ET.Element) -> None:
    """Note what else acts on joints, and refuse what closes loops."""
    for element in root.findall("equality/*"):
        if with_defaults(element, MAIN, reader.defaults, reader.path).get("active", "true") == "false":
            continue
        if element.tag != "joint":
            raise reader.wrong(element, "closes a loop, which is not computed; remove it, or set active='false'")
        for key, other in (("joint1", "joint2"), ("joint2", "joint1")):
            tied = f"to {element.get(other)!r} " if element.get(other) else ""
            text = f"is tied {tied}by <equality> in line {reader.lines[element]}: leave it out of joints"
            reader.refusals[element.get(key, "")] = text
    for element in root.findall("tendon/*"):
        given = with_defaults(element, MAIN, reader.defaults, reader.path)
        if any(reader.number(element, given, key) for key in ("armature",)) or given.get("stiffness", "0") != "0":
            raise reader.wrong(element, "has stiffness or armature, which are not computed; remove it")
    for element in root.findall("actuator/*"):
        given = with_defaults(element, MAIN, reader.defaults, reader.path)
        if (joint := given.get("joint")) is not None and (armature := reader.number(element, given, "armature")):
            gear = float(vector(given.get("gear", "1"), 1, 6)[0])
            reader.armatures[joint] = reader.armatures.get(joint, 0.0) + gear**2 * armature
