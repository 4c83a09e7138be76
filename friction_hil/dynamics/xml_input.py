"""Reading of XML that somebody else wrote: no document types, no entities, finite numbers."""

import math
import xml.etree.ElementTree as ET
from collections.abc import Collection, Sequence
from xml.parsers import expat

import numpy as np
from numpy.typing import NDArray

from friction_hil.errors import UsageError, choices

_MOST_DEPTH = 200


def parse(content: bytes, path: str, *roots: str) -> ET.Element:
    """Return the root element, which has one of the names ``roots``.

    A document type declaration is refused: entities that multiply or name other files are declared in one. Raises
    `UsageError`: it is no XML, has a document type or another root element, or is nested too deep.
    """
    return parse_with_lines(content, path, *roots)[0]


def parse_with_lines(content: bytes, path: str, *roots: str) -> tuple[ET.Element, dict[ET.Element, int]]:
    """Return the root element as `parse` does, and the line at which each element begins."""
    depth = 0
    lines = []

    def start(name: str, attributes: object) -> None:
        nonlocal depth
        depth += 1
        lines.append(parser.CurrentLineNumber)
        if depth > _MOST_DEPTH:
            raise UsageError(f"{path}: elements are nested more than {_MOST_DEPTH} deep")

    def end(name: str) -> None:
        nonlocal depth
        depth -= 1

    def refuse(*declaration: object) -> None:
        raise UsageError(f"{path} has a document type declaration (<!DOCTYPE>), which is not read; remove it")

    parser = expat.ParserCreate()
    parser.StartDoctypeDeclHandler = refuse
    parser.StartElementHandler = start
    parser.EndElementHandler = end
    try:
        parser.Parse(content, True)
        found = ET.fromstring(content)
    except (expat.ExpatError, ET.ParseError) as error:
        raise UsageError(f"{path} is not XML: {error}") from None
    if found.tag not in roots:
        wanted = " or ".join(f"<{root}>" for root in roots)
        raise UsageError(f"{path}: the root element is <{found.tag}>, not {wanted} without a namespace")
    return found, dict(zip(found.iter(), lines, strict=True))


def choose(
    joints: Collection[str], with_friction: Sequence[str], path: str, joint: str | None, elsewhere: str = ""
) -> str:
    """Return the joint that was asked for, or the only one with friction.

    ``elsewhere`` ends the message if there is none: where joints may be that were not read.
    """
    if joint is not None:
        if joint not in joints:
            raise UsageError(f"{path} has no joint {joint!r}; {choices(joint, joints)}{elsewhere}")
        return joint
    if len(with_friction) != 1:
        if not with_friction:
            raise UsageError(f"{path} states no friction of any joint{elsewhere or f'; {_there_are(joints)}'}")
        raise UsageError(
            f"{path} has several joints with friction; choose one with --joint; {_there_are(with_friction)}"
        )
    return with_friction[0]


def _there_are(joints: Collection[str]) -> str:
    return choices("", [each or "'' (without a name)" for each in joints])


def numbers(text: str, where: str, least: int, most: int) -> list[float]:
    """Return the numbers of an attribute, none below zero.

    Raises `UsageError`: there are too few or too many, or one is no number, not finite or below zero.
    """
    try:
        values = [float(word) for word in text.split()]
    except ValueError:
        raise UsageError(f"{where}: {text!r} must be numbers") from None
    if not least <= len(values) <= most or not all(math.isfinite(each) and each >= 0.0 for each in values):
        wanted = "one finite number, not" if most == 1 else f"{least} to {most} finite numbers, none"
        raise UsageError(f"{where}: {text!r} must be {wanted} below zero")
    return values


def vector(text: str, least: int, most: int) -> NDArray[np.float64]:
    """Return the numbers of an attribute; raise ValueError, with what would be right, if they are not finite."""
    try:
        values = [float(word) for word in text.split()]
    except ValueError:
        values = []
    if not least <= len(values) <= most or not all(map(math.isfinite, values)):
        count = f"{most}" if least == most else f"{least} to {most}"
        raise ValueError(f"must be {count} finite number{'s' * (most > 1)}, not {text!r}")
    return np.array(values)
