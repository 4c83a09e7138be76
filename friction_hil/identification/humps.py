"""Stribeck humps that the data do not show: the static level is then held equal to the Coulomb level. Pure."""

import math
from collections.abc import Collection, Mapping
from dataclasses import replace

import numpy as np

from friction_hil.identification import thresholds as th
from friction_hil.identification.fits import ENDED_EARLY, Fit
from friction_hil.identification.inference import NOT_EXCITED, experiment
from friction_hil.identification.structures import InitialScales, ModelStructure

_LEVELS = ("static", "static_released", "static_rested")
_SHAPES = ("lag_s", "rise_s")  # of a hump, in time
_HUMP = (*_LEVELS, "stribeck_velocity")


def hump(structure: ModelStructure) -> tuple[str, ...]:
    """Return the fitted parameters that set the height and the width of a Stribeck hump beside the Coulomb level."""
    names = [each.name for each in structure.coordinates]
    has_level = any(name.rpartition(".")[2] == "coulomb" for name in names)
    return tuple(name for name in names if has_level and name.rpartition(".")[2] in _HUMP)


def flat(structure: ModelStructure, values: Mapping[str, float], scales: InitialScales) -> ModelStructure | None:
    """Return the structure with static levels equal to the Coulomb level; None if it has no levels to be made equal.

    What shapes the hump is held: it has no effect, but for the width, which the damping of the bristles may share.
    """
    if structure.is_flat or not hump(structure):
        return None
    kept, held = [], dict(structure.constants)
    names = [each.name for each in structure.coordinates]
    for each in structure.coordinates:
        side, dot, last = each.name.rpartition(".")
        if last == "coulomb":
            levels = [name for name in names if name.startswith(side + dot) and name[len(side + dot) :] in _LEVELS]
            kept.append(replace(each, names=(*each.names, *levels)))
        elif last == "stribeck_velocity":
            width = min(max(values[each.name], 2.0 * scales.least_sliding_speed), 0.5 * scales.speed)
            held.update(dict.fromkeys(each.names, width))
        elif last in _SHAPES:
            held.update(dict.fromkeys(each.names, values[each.name]))
        elif last not in _LEVELS:
            kept.append(each)
    return replace(structure, coordinates=tuple(kept), constants=held, is_flat=True)


def is_upright(fit: Fit) -> bool:
    """Return True if no static level of a fit is below the Coulomb level of its side."""
    levels = [name for name in hump(fit.structure) if name.rpartition(".")[2] in _LEVELS]
    return all(fit.values[name] >= fit.values.get(_coulomb_beside(name), 0.0) for name in levels)


def _coulomb_beside(name: str) -> str:
    side, dot, _ = name.rpartition(".")
    return f"{side}{dot}coulomb"


def _is_shown(fit: Fit, name: str, scales: InitialScales) -> bool:
    """Return True if the data show a parameter of the hump.

    Where the hump is as wide as the axis slides, a level below the Coulomb level, down to zero at standstill, is what
    the data show: friction that rises with the speed. Where it is narrower, it is an error of presliding.
    """
    value, error = fit.values[name], fit.inference.standard_errors.get(name)
    if name.rpartition(".")[2] in _LEVELS and value < fit.values.get(_coulomb_beside(name), 0.0):
        width = fit.values.get("stribeck_velocity", 0.0)
        least = max(scales.least_sliding_speed, th.LEAST_DIP * scales.speed)
        return width >= least and (error is None or math.isfinite(error))
    return error is not None and error <= abs(value)


def flattened(fit: Fit, scales: InitialScales) -> Fit | None:
    """Return a fit with static levels equal to the Coulomb level, to start from, if the data may not show a hump."""
    if ENDED_EARLY in fit.flags or all(_is_shown(fit, name, scales) for name in hump(fit.structure)):
        return None
    structure = flat(fit.structure, fit.values, scales)
    if structure is None:
        return None
    at = np.array([each.inner(fit.values[each.name]) for each in structure.coordinates])
    return replace(fit, structure=structure, coordinates=at)


def upright(fit: Fit, flat_values: Mapping[str, float], scales: InitialScales) -> Fit:
    """Return a fit whose static levels are at least the Coulomb levels of its flat version, to start from.

    A free search that ended in a narrow dip may have missed a hump.
    """
    coordinates, at = [], []
    for each in fit.structure.coordinates:
        last, value = each.name.rpartition(".")[2], flat_values.get(each.name, fit.values[each.name])
        if last in _LEVELS:
            level = flat_values[_coulomb_beside(each.name)]
            each, value = replace(each, lower=min(level, each.upper)), th.HUMP_HEIGHT * level
        elif last == "stribeck_velocity":
            narrowest = min(max(each.lower, th.LEAST_DIP * scales.speed), each.upper)
            each, value = replace(each, lower=narrowest), th.HUMP_WIDTH * scales.speed
        coordinates.append(each)
        at.append(each.inner(value))
    structure = replace(fit.structure, coordinates=tuple(coordinates))
    return replace(fit, structure=structure, coordinates=np.array(at))


def is_coulomb(structure: ModelStructure, known: Collection[tuple[str, ...]]) -> bool:
    """Return True if a structure is that of Coulomb friction with modifiers that were ``known`` to be fitted."""
    return structure.family in ("stribeck", "karnopp") and structure.is_flat and structure.modifiers in known


def why_flat(fit: Fit, scales: InitialScales) -> str:
    """Return the flag of a fit that replaces ``fit`` because the data do not show its hump."""
    names = hump(fit.structure)
    found = ", ".join(f"{name} = {fit.values[name]:.4g}" for name in names)
    return (
        f"{NOT_EXCITED}a static level apart from the Coulomb level; it is held equal to coulomb (a free fit has "
        f"{found}, while the axis hardly slides more slowly than {scales.least_sliding_speed:.3g}): "
        f"{experiment('static')}"
    )
