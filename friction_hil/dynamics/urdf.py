"""The links and joints of a URDF (http://wiki.ros.org/urdf/XML)."""

import xml.etree.ElementTree as ET
from dataclasses import dataclass

import numpy as np

from friction_hil.dynamics import inertial
from friction_hil.dynamics.bodies import Body, Joint, Stated, refusal
from friction_hil.dynamics.newton_euler import PARAMETERS, PRISMATIC, REVOLUTE
from friction_hil.dynamics.rotations import Pose, of_roll_pitch_yaw
from friction_hil.dynamics.xml_input import vector
from friction_hil.errors import ConfigurationError, choices
from friction_hil.numerics.jit import Array

_KINDS = {"revolute": REVOLUTE, "continuous": REVOLUTE, "prismatic": PRISMATIC}
_OTHERS = ("fixed", "floating", "planar")
_SIX = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
_GRAVITY = (0.0, 0.0, -9.81)  # m/s^2; a URDF states none, and its z axis points upwards (REP 103)


@dataclass(frozen=True, slots=True)
class _Reader:
    path: str
    lines: dict[ET.Element, int]

    def wrong(self, element: ET.Element, where: str, message: str) -> ConfigurationError:
        return refusal(self.path, self.lines[element], where, message)

    def numbers(self, element: ET.Element, name: str, default: str | None, count: int, where: str) -> Array:
        text = element.get(name, default)
        if text is None:
            raise self.wrong(element, where, f"<{element.tag}> lacks {name}")
        try:
            return vector(text, count, count)
        except ValueError as error:
            raise self.wrong(element, where, f"{name} of <{element.tag}> {error}") from None

    def number(self, element: ET.Element, name: str, default: str | None, where: str) -> float:
        return float(self.numbers(element, name, default, 1, where)[0])

    def origin(self, element: ET.Element, where: str) -> Pose:
        origin = element.find("origin")
        if origin is None:
            return Pose()
        angles = self.numbers(origin, "rpy", "0 0 0", 3, where)
        return Pose(of_roll_pitch_yaw(angles), self.numbers(origin, "xyz", "0 0 0", 3, where))

    def parameters(self, link: ET.Element, where: str) -> Array:
        """Return the parameters of a link in its own frame; without <inertial> it has no mass."""
        given = link.find("inertial")
        if given is None:
            return np.zeros(PARAMETERS)
        mass, matrix = given.find("mass"), given.find("inertia")
        if mass is None or matrix is None:
            raise self.wrong(given, where, f"<inertial> lacks <{'mass' if mass is None else 'inertia'}>")
        kilograms = self.number(mass, "value", None, where)
        inertia = inertial.inertia_of(np.array([self.number(matrix, name, None, where) for name in _SIX]))
        if text := inertial.mistake(kilograms, inertia):
            raise self.wrong(mass if kilograms < 0.0 else matrix, where, text)
        pose = self.origin(given, where)
        return inertial.seen_from(pose, inertial.parameters_of(kilograms, np.zeros(3), inertia))

    def joint(self, element: ET.Element, kind: str, where: str) -> Joint:
        axis, armature = element.find("axis"), 0.0
        direction = np.array([1.0, 0.0, 0.0]) if axis is None else self.numbers(axis, "xyz", "1 0 0", 3, where)
        length = float(np.linalg.norm(direction))
        if length < 1e-6:
            raise self.wrong(element if axis is None else axis, where, "the axis has no length")
        follows = element.find("mimic")
        mimic = None
        if follows is not None:
            factor = self.number(follows, "multiplier", "1", where)
            mimic = (follows.get("joint", ""), factor, self.number(follows, "offset", "0", where))
        name, line = element.get("name", ""), self.lines[element]
        return Joint(name, line, _KINDS[kind], direction / length, armature=armature, mimic=mimic)


def read(root: ET.Element, lines: dict[ET.Element, int], path: str) -> Stated:
    """Return what a URDF states; raise ConfigurationError with the line of what cannot be read."""
    reader = _Reader(path, lines)
    for element in root.iter():
        if element.tag.startswith("{") and "xacro" in element.tag:
            text = "is a macro of xacro: expand the file first (`xacro FILE > arm.urdf`)"
            raise reader.wrong(element, f"<{element.tag.rpartition('}')[2]}>", text)
    links = _named(reader, root, "link")
    joints = _named(reader, root, "joint")
    above: dict[str, tuple[str, ET.Element]] = {}  # parent and joint of each link that has them
    for name, element in joints.items():
        where = f"joint {name!r}"
        kind = element.get("type", "")
        if kind not in (*_KINDS, *_OTHERS):
            raise reader.wrong(element, where, f"type {kind!r} is not known; {choices(kind, (*_KINDS, *_OTHERS))}")
        if kind in ("floating", "planar"):
            raise reader.wrong(element, where, f"is {kind}: only joints of one axis are computed; make it fixed")
        ends = []
        for tag in ("parent", "child"):
            end = element.find(tag)
            link = "" if end is None else end.get("link", "")
            if link not in links:
                raise reader.wrong(element, where, f"its {tag} {link!r} is no link; {choices(link, links)}")
            ends.append(link)
        if ends[1] in above:
            text = f"its child {ends[1]!r} is the child of joint {above[ends[1]][1].get('name')!r} already"
            raise reader.wrong(element, where, f"{text}: a closed loop is not computed")
        above[ends[1]] = (ends[0], element)
    roots = [name for name in links if name not in above]
    if len(roots) != 1:
        text = (
            f"of {len(roots)} links without a parent ({', '.join(roots[:5])}) only one can be"
            if roots
            else "no link is"
        )
        raise refusal(path, lines[root], "", f"{text} the base")
    order, bodies = list(roots), []
    for name in order:  # grows below
        below = [link for link, (parent, _) in above.items() if parent == name]
        order += sorted(below, key=lambda link: lines[above[link][1]])
    if len(order) != len(links):
        lost = next(name for name in links if name not in order)
        raise reader.wrong(links[lost], f"link {lost!r}", "is part of a ring of links, without the base")
    for name in order:
        parameters = reader.parameters(links[name], f"link {name!r}")
        if name not in above:
            bodies.append(Body(name, lines[links[name]], -1, Pose(), (), parameters))
            continue
        parent, element = above[name]
        where, kind = f"joint {element.get('name')!r}", element.get("type", "")
        moving = () if kind == "fixed" else (reader.joint(element, kind, where),)
        pose = reader.origin(element, where)
        bodies.append(Body(name, lines[links[name]], order.index(parent), pose, moving, parameters))
    return Stated(path, tuple(bodies), np.array(_GRAVITY))


def _named(reader: _Reader, root: ET.Element, tag: str) -> dict[str, ET.Element]:
    """Return the links or joints by name."""
    found: dict[str, ET.Element] = {}
    for element in root.findall(tag):
        name = element.get("name", "")
        if not name:
            raise reader.wrong(element, f"<{tag}>", "has no name")
        if name in found:
            raise reader.wrong(
                element, f"{tag} {name!r}", f"has the name of the one in line {reader.lines[found[name]]}"
            )
        found[name] = element
    return found
