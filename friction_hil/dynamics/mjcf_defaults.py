"""Default classes of MJCF.

Source: MuJoCo's XML reference: default classes are inherited from the enclosing class, ``childclass`` of a body holds
for all within it, ``class`` of an element comes first.
"""

import xml.etree.ElementTree as ET

from friction_hil.errors import UsageError

MAIN = "main"  # the class of what names none

Classes = dict[str, dict[str, dict[str, str]]]  # attributes by class and element


def classes(root: ET.Element, path: str) -> Classes:
    """Return the attributes of each class; a class inherits those of the class around it."""
    known: Classes = {MAIN: {}}
    for default in root.findall("default"):
        _collect(default, {}, known, path)
    return known


def _collect(default: ET.Element, above: dict[str, dict[str, str]], known: Classes, path: str) -> None:
    name = default.get("class", MAIN)
    own = {tag: dict(attributes) for tag, attributes in above.items()}
    for element in default:
        if element.tag != "default":
            own[element.tag] = own.get(element.tag, {}) | element.attrib
    before = known.get(name, {})
    known[name] = {**before, **{tag: {**before.get(tag, {}), **own[tag]} for tag in own}}
    for inner in default.findall("default"):
        if "class" not in inner.attrib:
            raise UsageError(f"{path}: a default within another must have a class")
        _collect(inner, known[name], known, path)


def with_defaults(element: ET.Element, current: str, defaults: Classes, path: str) -> dict[str, str]:
    """Return the attributes of an element with those of its class, or else of the ``current`` one."""
    name = element.get("class", current)
    if name not in defaults:
        raise UsageError(f"{path}: there is no default class {name!r} for <{element.tag}>")
    return {**defaults[name].get(element.tag, {}), **element.attrib}
