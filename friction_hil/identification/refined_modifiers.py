"""Modifiers of refined fits: what the residual at the encoder's resolution still shows of direction, load and ripple.

A refined fit takes seconds. Therefore each modifier is first tested in one step: the columns that it would add to the
Jacobian are fitted to the residual, block by block held out, in the linear approximation about the refined fit (a score
test; C. R. Rao, Mathematical Proceedings of the Cambridge Philosophical Society 44, 1948). Only what predicts the
held-out blocks better is refined, all of it at once, and is kept if that predicts them better too.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from friction_hil.identification import thresholds as th
from friction_hil.identification.candidates import CandidateFitter
from friction_hil.identification.choice import log_likelihood_gain
from friction_hil.identification.data import Mask
from friction_hil.identification.fits import Fit
from friction_hil.identification.prediction_errors import blocks, speed_groups
from friction_hil.identification.regression import Estimate
from friction_hil.identification.structures import EXTENDS, ModelStructure, directed
from friction_hil.numerics.jit import Array

_RIDGE = 1e-9  # of columns of length 1


@dataclass(frozen=True, slots=True)
class RefinedModifiers:
    """Result of `refine_modifiers`."""

    tried: tuple[Fit, ...]  # refined fits with further modifiers
    outdone: tuple[Fit, ...]  # fits that lost the comparison of a fit with and without these modifiers, of either kind


def refine_modifiers(fitter: CandidateFitter, refined: Sequence[Fit]) -> RefinedModifiers:
    """Refine the best families once more with the modifiers that their residuals support."""
    tried: list[Fit] = []
    outdone: list[Fit] = []
    for base in _bases(refined):
        now = base
        # an asymmetry bends all other parameters, so that one step from them need not show it
        split = _split(fitter, base)
        for larger in fitter.supported(fitter.refine_all([split])) if split is not None else ():
            tried.append(larger)
            lower, higher = (larger, now) if _is_likelier(larger, now) else (now, larger)
            outdone.append(higher)
            now = lower
        for _ in range(th.REFINED_ROUNDS):
            seed = _supported(fitter, now)
            if seed is None or any(_is_same(each, seed) for each in (*refined, *tried)):
                break
            larger_one = fitter.refine(seed)
            if larger_one is None:
                break
            tried.append(larger_one)
            if not _is_likelier(larger_one, now):
                outdone.append(larger_one)
                break
            outdone.append(now)
            now = larger_one
    return RefinedModifiers(tuple(tried), tuple(outdone))


def _is_same(fit: Fit, other: Fit) -> bool:
    """True if two fits have the same parameters and harmonics."""
    one, two = fit.structure, other.structure
    return (one.family, one.names, one.constants) == (two.family, two.names, two.constants)


def _is_likelier(fit: Fit, other: Fit) -> bool:
    """Return True if held-out data are more likely with a fit than with another by a standard error."""
    gain, doubt = log_likelihood_gain(fit.held_out, other.held_out)
    return gain > doubt


def _is_lower(errors: Sequence[float], others: Sequence[float]) -> bool:
    """Return True if the mean square errors of blocks are below others by more than a standard error.

    They are compared block by block, in proportion: those of slow strokes and of presliding differ by orders of
    magnitude.
    """
    gain = np.log(np.maximum(others, 1e-300)) - np.log(np.maximum(errors, 1e-300))
    error = float(np.std(gain, ddof=1)) / len(gain) ** 0.5 if len(gain) > 1 else 0.0
    return float(np.mean(gain)) > error


def _bases(refined: Sequence[Fit]) -> list[Fit]:
    """Return the best refined fit of each of the best families; one that extends another one does not count."""
    best: dict[str, Fit] = {}
    families = {each.structure.family for each in refined}
    for each in sorted(refined, key=lambda each: each.held_out.rmse):
        if EXTENDS.get(each.structure.family) not in families:
            best.setdefault(each.structure.family, each)
    return list(best.values())[: th.REFINED_BASES]


@dataclass(frozen=True, slots=True, eq=False)
class _Step:
    """A structure, and how well it predicts after one linear step; ``estimate`` has the residual after that step."""

    structure: ModelStructure
    estimate: Estimate
    errors: tuple[float, ...]  # mean square of each held-out block, weighted


def _supported(fitter: CandidateFitter, base: Fit) -> Fit | None:
    """Return ``base`` with all modifiers that one step supports, as a start for its refinement; None without any."""
    masks = speed_groups(fitter.fine) or blocks(fitter.fine)
    now = first = _step(fitter, base, base.structure, masks)
    while True:
        tried = [_step(fitter, base, each, masks) for each in _larger(fitter, base, now)]
        better = [each for each in tried if _is_lower(each.errors, now.errors)]
        if not better:
            break
        now = min(better, key=lambda each: sum(map(math.log, each.errors)))
    return None if now is first else _seed(fitter, base, now.structure)


def _split(fitter: CandidateFitter, base: Fit) -> Fit | None:
    """Return ``base`` with levels for each direction, as a start, if its offset shows that they differ."""
    error = base.inference.standard_errors.get("offset", math.inf)
    least = max(th.REFINED_CLEAR * error, th.REFINED_LEAST_OFFSET * fitter.scales.level)
    if abs(base.values.get("offset", 0.0)) <= least:
        return None
    if base.structure.modifiers:
        return None
    return _seed(fitter, base, fitter.build(base.structure.family, is_directed=True))


def _seed(fitter: CandidateFitter, base: Fit, structure: ModelStructure) -> Fit:
    """Return ``base`` with a larger structure, as a start for its refinement."""
    # the levels of two directions take up the offset, which is then held
    is_split = "direction" in structure.modifiers and "direction" not in base.structure.modifiers
    held = fitter.fine_regression(structure, base.mechanics).held if is_split else {}
    offset = base.mechanics["offset"] - held["offset"] if "offset" in held else 0.0
    coordinates = _start(structure, base.values, offset)
    values = {**base.values, **structure.values(coordinates)}
    return replace(base, structure=structure, coordinates=coordinates, values=values)


def _larger(fitter: CandidateFitter, base: Fit, now: _Step) -> Iterator[ModelStructure]:
    """Yield the structures with one modifier more than ``now``."""
    if "direction" not in now.structure.modifiers:
        split = directed(now.structure)
        if split.coordinates != now.structure.coordinates:
            yield split
    yield from fitter.with_fine_modifier(replace(base, structure=now.structure), now.estimate)


def _start(structure: ModelStructure, values: Mapping[str, float], offset: float = 0.0) -> Array:
    """Return coordinates from the values of a simpler structure; levels take up its offset, others begin at zero."""
    start = []
    for each in structure.coordinates:
        name = each.name.rpartition(".")[2]
        value = values.get(each.name, values.get(name, 0.0))
        if each.name not in values and name in values and name.startswith(("coulomb", "static")):
            value += offset if each.name.startswith("direction.positive") else -offset
        start.append(each.inner(value))
    return np.array(start)


def _step(fitter: CandidateFitter, base: Fit, structure: ModelStructure, masks: Sequence[Mask]) -> _Step:
    """Take one linear step of all parameters of a structure from the point where it equals ``base``."""
    regression = fitter.fine_regression(structure, base.mechanics, like=base.structure)
    weights, at = base.estimate.weights, _start(structure, base.values)
    names = (*(each.name for each in structure.coordinates), *regression.keys)
    jacobian = regression.jacobian(at, names)
    after, errors = _one_step(jacobian, base.estimate.residual, weights, masks)
    estimate = replace(base.estimate, coordinates=at, residual=after, jacobian=jacobian, names=names)
    return _Step(structure, estimate, errors)


def _one_step(
    jacobian: Array, residual: Array, weights: Array, masks: Sequence[Mask]
) -> tuple[Array, tuple[float, ...]]:
    """Return the residual (k,) after a linear step, and the weighted mean square of each block held out of it."""
    columns, target = jacobian * weights[:, None], residual * weights
    norms = np.linalg.norm(columns, axis=0)
    norms[norms == 0.0] = 1.0
    columns = columns / norms
    gram, right = columns.T @ columns, columns.T @ target
    ridge = _RIDGE * np.eye(len(right))
    after = residual - jacobian @ (np.linalg.solve(gram + ridge, right) / norms)
    errors = []
    for mask in masks:
        own, wanted = columns[mask], target[mask]
        step = np.linalg.solve(gram - own.T @ own + ridge, right - own.T @ wanted)
        errors.append(float(np.mean((wanted - own @ step) ** 2)))
    return after, tuple(errors)
