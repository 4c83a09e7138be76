"""The friction of an actuator in a file of BAM (Rhoban, Better Actuator Models), as far as a model file can hold it.

Two layouts, told apart by their content: the parameters of one actuator, which ``bam.fit`` writes, and the
configuration of several that ``bam.mujoco.load_config`` reads.

Source: ``compute_frictions`` in ``bam/model.py`` of better-actuator-models 1.0.2. With the torque M of the motor, E of
all that is outside, and s = exp(-(|v| / ``dtheta_stribeck``)^``alpha``), friction while sliding is ``friction_base`` +
``friction_stribeck`` s + ``friction_viscous`` |v| + |e E - m M|, where m and e are m0 + m1 s and e0 + e1 s. M contains
the friction itself, so that in steady motion all of it is divided by 1 - m, also without a load.
"""

import json
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from friction_hil.dynamics.xml_input import choose
from friction_hil.errors import UsageError

_LARGEST = sys.float_info.max  # JSON has whole numbers of any length
_ALWAYS = ("friction_base", "friction_viscous")
_STRIBECK = ("friction_stribeck", "dtheta_stribeck", "alpha")
_EACH_SIDE = ("load_friction_motor", "load_friction_external")
_AT_REST = tuple(f"{name}_stribeck" for name in _EACH_SIDE)
FRICTION: Mapping[str, tuple[str, ...]] = {
    "m1": _ALWAYS,
    "m2": (*_ALWAYS, *_STRIBECK),
    "m3": (*_ALWAYS, "load_friction_base"),
    "m4": (*_ALWAYS, *_STRIBECK, "load_friction_base", "load_friction_stribeck"),
    "m5": (*_ALWAYS, *_STRIBECK, *_EACH_SIDE, *_AT_REST),
    "m6": (*_ALWAYS, *_STRIBECK, *_EACH_SIDE, *_AT_REST),
}
"""Parameters of the friction of each model; their absence is not zero for BAM."""
_QUADRATIC = tuple(f"{name}_quad" for name in _EACH_SIDE)  # of m6 alone, zero where they are absent
_MECHANICS = ("armature", "command_delay")  # the second is in files after 1.0.2
MOTOR = (
    *("actuator", "kt", "R", "ratio", "error_gain", "error_gain_ratio", "max_pwm", "max_velocity", "max_torque"),
    *("current_limit", "q_offset"),
)
"""What describes the motor, its drive and the test bench: no friction, but what BAM needs to simulate."""


@dataclass(frozen=True, slots=True)
class Actuator:
    """Friction of an actuator, SI: the terms of `friction_hil.models.foreign.Stated`."""

    model: str
    parameters: dict[str, float]
    modifiers: dict[str, Any]
    mechanics: dict[str, float]
    motor: dict[str, Any]  # of `MOTOR`
    notes: tuple[str, ...]


def find(content: bytes, path: str, name: str | None) -> Actuator:
    """Return the actuator of a name, or the only one; raise UsageError where there is none or a number is wrong."""
    try:
        given = json.loads(content)
    except (ValueError, RecursionError) as error:
        raise UsageError(f"{path} is not JSON: {error}") from None
    for place, number in _numbers(given, ""):
        if not abs(number) <= _LARGEST:
            raise UsageError(f"{path}: {place} must be a finite number, not {str(number)[:40]}")
    given, where = _chosen(given, path, name)
    kind = given["model"]

    def value(key: str, default: float | None = None) -> float:
        number = given.get(key, default)
        if number is None:
            raise UsageError(
                f"{where}{key} is missing, for which BAM takes a default: {kind} needs {', '.join(FRICTION[kind])}"
            )
        if isinstance(number, bool) or not isinstance(number, int | float) or number < 0.0:
            raise UsageError(f"{where}{key} must be a finite number, not below zero, not {str(number)[:40]}")
        return float(number)

    p = {key: value(key) for key in FRICTION[kind]}
    if kind == "m6":
        p |= {key: value(key, 0.0) for key in _QUADRATIC}
    mechanics = {"inertia": value("armature", 0.0), "delay_s": value("command_delay", 0.0)}
    motor = {key: given[key] for key in MOTOR if given.get(key) not in (None, "")}
    unknown = {key: each for key, each in given.items() if key not in (*p, *_MECHANICS, *MOTOR, "model", "comment")}
    parameters, modifiers, notes = _friction(p, where)
    if motor:
        notes.append(f"no friction, kept in fit.imported.motor for an export to BAM: {_words(motor)}")
    if unknown:
        notes.append(f"left out, because {kind} of BAM has no such parameters: {_words(unknown)}")
    model = "stribeck" if "static" in parameters else "coulomb"
    return Actuator(model, parameters, modifiers, mechanics, motor, tuple(notes))


def _friction(p: Mapping[str, float], where: str) -> tuple[dict[str, float], dict[str, Any], list[str]]:
    """Return parameters and modifiers of the model, and what BAM's friction has besides."""
    both, both_at_rest = p.get("load_friction_base", 0.0), p.get("load_friction_stribeck", 0.0)
    m0, e0 = (p.get(key, both) for key in _EACH_SIDE)
    m1, e1 = (p.get(key, both_at_rest) for key in _AT_REST)
    sliding, at_rest = 1.0 - m0, 1.0 - m0 - m1
    if at_rest <= 0.0:
        raise UsageError(
            f"{where}the friction grows by {m0 + m1:g} of the motor torque, which would never move it: the parameters "
            "load_friction_* of the motor must be below 1 together"
        )
    base, hump, viscous = p["friction_base"], p.get("friction_stribeck", 0.0), p["friction_viscous"]
    parameters, notes = {"coulomb": base / sliding}, []
    static = (base + hump) / at_rest
    if static > parameters["coulomb"] and "alpha" in p:
        parameters |= {"static": static, "stribeck_velocity": p["dtheta_stribeck"], "stribeck_exponent": p["alpha"]}
    parameters["viscous"] = viscous / sliding
    if m1 > 0.0 and p["dtheta_stribeck"] > 0.0 and p["alpha"] > 0.0:
        s = np.linspace(1e-3, 1.0, 1000)
        v = p["dtheta_stribeck"] * (-np.log(s)) ** (1.0 / p["alpha"])
        exact = (base + hump * s + viscous * v) / (sliding - m1 * s)
        ours = parameters["coulomb"] * (1.0 - s) + static * s + parameters["viscous"] * v
        off = 100.0 * np.max(np.abs(ours - exact) / np.maximum(exact, sys.float_info.min))
        notes.append(f"without load the friction differs from BAM's by {off:.3g} % at most")
    if m0 + e0 + m1 + e1 == 0.0:
        return parameters, {}, notes
    motoring, resting = (m0 + e0) / sliding, (m0 + e0 + m1 + e1) / at_rest
    driven = (m0 + e0) / (1.0 + m0)
    losses = [f"while the load drives the motor it falls with a small load, and grows by {driven:.3g} of a large one"]
    if resting > motoring:
        losses.append(f"near rest it grows by {resting:.3g} of the load, and not by {motoring:.3g}")
    if any(p.get(key, 0.0) for key in _QUADRATIC):
        losses.append("near rest it grows with the square of the load")
    notes.append(f"left out of BAM's friction: {'; '.join(losses)}")
    return parameters, {"load": {"motoring": motoring}} if motoring > 0.0 else {}, notes


def _chosen(given: Any, path: str, name: str | None) -> tuple[dict[str, Any], str]:
    """Return the parameters of one actuator, and how messages about them begin."""
    if isinstance(given, dict) and given.get("model") in FRICTION:
        if name is not None:
            raise UsageError(f"{path}: --joint: this file of BAM describes one actuator")
        return given, f"{path}: "
    several = given.items() if isinstance(given, dict) else ()
    found: dict[str, dict[str, Any]] = {}
    for key, each in several:
        model = each.get("model") if isinstance(each, dict) else None
        if isinstance(model, dict) and model.get("model") in FRICTION:
            found[key] = {**model, **{other: each[other] for other in each if other not in ("model", "dofs")}}
    if not found:
        raise UsageError(f"{path} is no file of BAM: it names no model m1 to m6")
    chosen = choose(found, list(found), path, name)
    return found[chosen], f"{path}: {chosen}: "


def _numbers(given: Any, place: str) -> Iterator[tuple[str, float]]:
    """Yield all numbers with the names of their places."""
    if isinstance(given, dict | list):
        for key, each in given.items() if isinstance(given, dict) else enumerate(given):
            yield from _numbers(each, f"{place}.{key}" if place else str(key))
    elif isinstance(given, int | float):
        yield place, given


def _words(values: Mapping[str, Any]) -> str:
    return ", ".join(f"{name} {each}" for name, each in values.items())
