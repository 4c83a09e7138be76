"""Model files from the friction that other programs state: MJCF, URDF, and the parameters of BAM.

They hold less than a model file; what is missing is named in the result, and in the file that is written from it.
"""

import math
import xml.etree.ElementTree as ET
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from friction_hil import __version__
from friction_hil.dynamics import xml_input
from friction_hil.errors import FrictionHilError, UsageError, choices
from friction_hil.models import bam_file, mjcf_joints
from friction_hil.models.model_file import ModelFile

_MOST_BYTES = 100_000_000
_NEVER_THERE = (
    "standard errors, recordings and errors of a fit",
    "the range of velocity and temperature in which it holds",
    "the period of the loop in which it was found",
)


@dataclass(slots=True)
class Stated:
    """What a file states of one joint, in the terms of a model file."""

    axis: str  # "rotary" or "linear"
    model: str
    parameters: dict[str, Any]
    modifiers: dict[str, Any] = field(default_factory=dict)
    mechanics: dict[str, Any] = field(default_factory=dict)
    # what was done with numbers that have no place of their own, or was left out
    notes: list[str] = field(default_factory=list)
    missing: list[str] = field(default_factory=list)  # friction that the file does not state
    imported: dict[str, Any] = field(default_factory=dict)  # what else is kept for an export back to the same format


@dataclass(frozen=True, slots=True)
class Imported:
    """A model file with what it lacks."""

    content: dict[str, Any]  # plain values of the model file
    missing: tuple[str, ...]  # what the source does not state
    notes: tuple[str, ...]  # what of the source was changed or left out


def read(path: str | Path, source: str, joint: str | None = None) -> Imported:
    """Read the friction of one joint; ``joint`` is its name, if several have friction.

    ``source``: one of `SOURCES`. Raises `FrictionHilError`: the file cannot be read; `UsageError`: the file is not of
    this format, there is no such joint, or its numbers make no model.
    """
    if source not in SOURCES:
        raise UsageError(f"there is no source {source!r}; {choices(source, SOURCES)}")
    stated = SOURCES[source](_bytes(Path(path)), str(path), joint)
    mechanics = {name: value for name, value in stated.mechanics.items() if value}
    missing = [*stated.missing, *_NEVER_THERE, *(text for name, text in _MECHANICS.items() if name not in mechanics)]
    friction: dict[str, Any] = {"model": stated.model, "parameters": stated.parameters}
    if stated.modifiers:
        friction["modifiers"] = stated.modifiers
    imported = {"path": Path(path).name, "format": source, **({"joint": joint} if joint else {}), **stated.imported}
    content: dict[str, Any] = {"version": 1, "axis": stated.axis, "friction": friction}
    if mechanics:
        content["mechanics"] = mechanics
    content["fit"] = {
        "software": f"friction_hil {__version__}",
        "imported": imported,
        "flags": [f"not stated by the {source} file: {each}" for each in missing] + stated.notes,
    }
    try:
        ModelFile.model_validate(content)
    except ValidationError as error:
        reasons = "; ".join(f"{'.'.join(map(str, each['loc']))}: {each['msg']}" for each in error.errors())
        raise UsageError(f"{path}: the friction it states makes no model: {reasons}") from None
    return Imported(content, tuple(missing), tuple(stated.notes))


_COULOMB = "the Coulomb friction"
_DYNAMICS = {"friction": _COULOMB, "damping": "the viscous friction"}
_XACRO = ("{http://www.ros.org/wiki/xacro}", "{http://ros.org/wiki/xacro}")
_MECHANICS = {"inertia": "the inertia of motor and load", "delay_s": "the delay of the torque"}


def _bytes(path: Path) -> bytes:
    try:
        if path.stat().st_size > _MOST_BYTES:
            raise UsageError(f"{path} has more than {_MOST_BYTES // 1_000_000} MB: no description of a joint")
        return path.read_bytes()
    except OSError as error:
        raise FrictionHilError(f"{path} cannot be read: {error.strerror or error}") from None


def _mjcf(content: bytes, path: str, joint: str | None) -> Stated:
    found = mjcf_joints.find(xml_input.parse(content, path, "mujoco"), path, joint)
    mechanics = {"inertia": found.armature}
    notes = list(found.notes)
    missing = [] if found.is_stated else [f"{_COULOMB} (frictionloss): zero stands for it"]
    if found.armature:
        notes.append("inertia is the armature of the joint; the bodies that it moves are not in it")
    modifiers: dict[str, Any] = {}
    linear, quadratic, cubic = found.damping
    if quadratic or cubic:
        modifiers["viscous"] = {"quadratic": quadratic, "cubic": cubic}
    if found.cogging is not None:
        amplitude, poles, phase = found.cogging
        harmonic = {"order": poles, "cosine": -amplitude * math.sin(phase), "sine": -amplitude * math.cos(phase)}
        modifiers["ripple"] = [harmonic]
    if found.lugre is None:
        parameters = {"coulomb": found.frictionloss, "viscous": linear}
        return Stated(found.axis, "coulomb", parameters, modifiers, mechanics, notes, missing)
    stiffness, damping, coulomb, static, stribeck_velocity = found.lugre
    if found.frictionloss:
        notes.append(f"frictionloss {found.frictionloss:g} of the joint was added to both levels of its LuGre friction")
    parameters = {
        "sigma0": stiffness,
        "sigma1": damping,
        "sigma2": linear,
        "coulomb": coulomb + found.frictionloss,
        "static": static + found.frictionloss,
        "stribeck_velocity": stribeck_velocity,
    }
    return Stated(found.axis, "lugre", parameters, modifiers, mechanics, notes)


def _urdf(content: bytes, path: str, joint: str | None) -> Stated:
    root = xml_input.parse(content, path, "robot")
    joints: dict[str, ET.Element] = {}
    for each in root.findall("joint"):
        if each.get("type") == "fixed":
            continue
        name = each.get("name", "")
        if name in joints:
            raise UsageError(f"{path}: several joints have the name {name!r}")
        joints[name] = each
    with_friction = [name for name, each in joints.items() if joint is None and any(_dynamics(each, path))]
    is_macro = any(str(each.tag).startswith(_XACRO) for each in root.iter())
    elsewhere = "; it has macros of xacro, which are not read: expand it with xacro first" if is_macro else ""
    chosen = joints[xml_input.choose(joints, with_friction, path, joint, elsewhere)]
    kind = chosen.get("type")
    if kind not in ("revolute", "continuous", "prismatic"):
        raise UsageError(f"{path}: joint {chosen.get('name')!r} is of type {kind!r}, not one axis")
    values = _dynamics(chosen, path)
    axis = "linear" if kind == "prismatic" else "rotary"
    element = chosen.find("dynamics")
    stated = {} if element is None else element.attrib
    missing = [f"{text} ({name}): zero stands for it" for name, text in _DYNAMICS.items() if name not in stated]
    return Stated(axis, "coulomb", {"coulomb": values[0], "viscous": values[1]}, missing=missing)


def _dynamics(joint: ET.Element, path: str) -> list[float]:
    """Return Coulomb level and viscous coefficient of a joint of URDF, zero where the file does not state them."""
    element = joint.find("dynamics")
    given = {} if element is None else element.attrib
    where = f"{path}: joint {joint.get('name', '')!r}"
    return [xml_input.numbers(given.get(name, "0"), f"{where}: {name}", 1, 1)[0] for name in _DYNAMICS]


def _bam(content: bytes, path: str, joint: str | None) -> Stated:
    found = bam_file.find(content, path, joint)
    imported = {"motor": found.motor} if found.motor else {}
    return Stated(
        "rotary", found.model, found.parameters, found.modifiers, found.mechanics, list(found.notes), imported=imported
    )


SOURCES: Mapping[str, Callable[[bytes, str, str | None], Stated]] = {"mjcf": _mjcf, "urdf": _urdf, "bam": _bam}
