"""One candidate fitted: parameters with their uncertainty, errors inside and outside the data, curves to draw."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from friction_hil.identification import structures
from friction_hil.identification.data import Data
from friction_hil.identification.errors import (
    PredictionError,
    blocks,
    cross_validate,
    prediction_error,
    speed_groups,
    validate,
)
from friction_hil.identification.inference import Inference, flags, infer
from friction_hil.identification.problem import BACK_EMF, INVERSE_GAIN, Estimate, Problem
from friction_hil.identification.refine import refine
from friction_hil.identification.structures import Scales, Structure
from friction_hil.numerics.jit import Array

_FIRST_EVALUATIONS = 5  # of each start; the best goes on
_EVALUATIONS = 60
MECHANICS = ("inertia", "offset", "gravity.constant", "gravity.sine", "gravity.cosine")


@dataclass(frozen=True, slots=True, eq=False)
class Curves:
    """Measured and predicted torque over what a report draws them; arrays (k,) on the rows of the regression.

    Attributes
    ----------
    time_s, position, velocity, acceleration : array
        SI.
    measured, predicted, residual : array
        N m or N; residual = measured - predicted.
    friction : array
        Predicted share of friction.
    recording : array of int
        Which of the records a row belongs to.
    """

    time_s: Array
    position: Array
    velocity: Array
    acceleration: Array
    measured: Array
    predicted: Array
    residual: Array
    friction: Array
    recording: Any


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """A candidate and what is known of it.

    Attributes
    ----------
    structure : Structure
    values : dict
        Parameters that were looked for, by name, mechanics included.
    mechanics : dict
        Inertia, offset and gravity, held ones included.
    inference : Inference
    train, cross_validation : PredictionError
        On the data, and on blocks of it that were held out.
    across_speeds : PredictionError or None
        On groups of strokes that were held out, by their speed; None where there are too few strokes.
    validation : PredictionError or None
        On recordings that the fit has not seen.
    flags : tuple of str
    coordinates : array
        Where the search ended.
    curves : Curves
    estimate : Estimate
    is_refined : bool
        Whether it was fitted once more by `refined`.
    """

    structure: Structure
    values: dict[str, float]
    mechanics: dict[str, float]
    inference: Inference
    train: PredictionError
    cross_validation: PredictionError
    across_speeds: PredictionError | None
    validation: PredictionError | None
    flags: tuple[str, ...]
    coordinates: Array
    curves: Curves
    estimate: Estimate
    is_refined: bool = False

    @property
    def label(self) -> str:
        """Name for people."""
        return self.structure.label

    @property
    def count(self) -> int:
        """Number of parameters that were fitted."""
        return len(self.inference.names)

    @property
    def held_out(self) -> PredictionError:
        """The error that counts: on other recordings, or of strokes held out, or of blocks held out; what there is."""
        return self.validation or self.across_speeds or self.cross_validation

    @property
    def drive(self) -> dict[str, float]:
        """Gain and back-EMF of a drive whose gain was looked for."""
        return {name: value for name, value in self.values.items() if name.startswith("drive.")}

    @property
    def friction(self) -> tuple[dict[str, Any], dict[str, Any]]:
        """Parameters and modifiers as in a model file."""
        other = (*MECHANICS, *self.drive)
        own = {name: value for name, value in self.values.items() if name not in other}
        parameters, modifiers = structures.nested({**self.structure.constants, **own})
        return parameters, modifiers


def fit(
    problem: Problem,
    scales: Scales,
    *,
    seed: int = 0,
    further_starts: int = 2,
    warm: Mapping[str, float] | None = None,
    is_robust: bool = False,
    validation: Problem | None = None,
    notes: Sequence[str] = (),
) -> Fit:
    """Fit a structure: several short searches, the best one to its end, then what can be said of it.

    Parameters
    ----------
    problem : Problem
    scales : Scales
    seed, further_starts : int
        Random starts besides those that the data suggest.
    warm : mapping, optional
        Values of a related structure to start from; then only one start besides.
    is_robust : bool
        See `Problem.estimate`.
    validation : Problem, optional
        The same structure on other recordings.
    notes : sequence of str
        What is to be said of this candidate anyway.

    Raises
    ------
    InvalidParameterError
        A held value does not fit the model.
    """
    structure = problem.structure
    begins: list[dict[str, float]] = []
    for values in structures.starts(structure, scales, seed, further_starts):
        if values not in begins:
            begins.append(values)
    if warm is not None:
        begins = [{**begins[0], **_from_plain(structure, warm)}, *begins[:1]]
    structure.model(begins[0])  # a held value that does not fit is the user's to know
    at = [np.array([each.inner(values[each.name]) for each in structure.coordinates]) for values in begins]
    if len(at) > 1:
        first = [problem.search(each, evaluations=_FIRST_EVALUATIONS, tolerance=1e-5) for each in at]
        at = [min(first, key=lambda solution: solution.cost).at]
    estimate = problem.estimate(at[0], is_robust=is_robust, evaluations=_EVALUATIONS)
    inference = infer(estimate, problem.data.parts)
    return _fit(problem, estimate, inference, validation, notes)


def refined(
    base: Fit,
    problem: Problem,
    originals: Data,
    scales: Scales,
    *,
    replicas: int,
    seed: int = 0,
    validation: Problem | None = None,
    notes: Sequence[str] = (),
) -> Fit:
    """Fit a structure once more on fine records: see `friction_hil.identification.refine`.

    Parameters
    ----------
    base : Fit
        To the ordinary records, ``originals``.
    problem : Problem
        The same structure on what `friction_hil.identification.fine.fine_data` makes of them.
    originals : Data
    scales : Scales
    replicas, seed : int
        Of the repeated experiments.
    validation, notes
        See `fit`.
    """
    estimate, inference, further = refine(problem, originals, base.coordinates, scales, replicas=replicas, seed=seed)
    return replace(_fit(problem, estimate, inference, validation, (*notes, *further)), is_refined=True)


def _fit(
    problem: Problem, estimate: Estimate, inference: Inference, validation: Problem | None, notes: Sequence[str]
) -> Fit:
    structure = problem.structure
    return Fit(
        structure=structure,
        values=estimate.values,
        mechanics=_mechanics(problem, estimate),
        inference=inference,
        train=prediction_error(problem.data.torque, problem.data.torque - estimate.residual),
        cross_validation=cross_validate(problem, estimate, blocks(problem.data)),
        across_speeds=cross_validate(problem, estimate, groups) if (groups := speed_groups(problem.data)) else None,
        validation=None if validation is None else validate(validation, estimate),
        flags=(*notes, *flags(estimate, inference)),
        coordinates=estimate.coordinates,
        curves=_curves(problem.data, estimate),
        estimate=estimate,
    )


def _mechanics(problem: Problem, estimate: Estimate) -> dict[str, float]:
    """Mechanics that were found or held, in the units of the measured torque."""
    scale = estimate.values.get(INVERSE_GAIN, 1.0)
    held = {**problem.held, **{name: scale * value for name, value in problem.data.known.items()}}
    return {name: estimate.values.get(name, held.get(name, 0.0)) for name in MECHANICS}


def _from_plain(structure: Structure, values: Mapping[str, float]) -> dict[str, float]:
    """Values of a structure's coordinates from those of one without directions or modifiers."""
    found = {}
    for each in structure.coordinates:
        plain = each.name.rpartition(".")[2] if each.name.startswith("direction.") else each.name
        if each.name in values or plain in values:
            found[each.name] = values.get(each.name, values.get(plain, 0.0))
    return found


def _curves(data: Data, estimate: Estimate) -> Curves:
    predicted = data.torque - estimate.residual
    friction = predicted.copy()
    for name in (*MECHANICS, INVERSE_GAIN, BACK_EMF):
        if estimate.values.get(name):
            friction -= estimate.values[name] * data.column(name)
    numbers = np.concatenate([np.full(part.stop - part.start, i) for i, part in enumerate(data.parts)])
    return Curves(
        time_s=data.time_s,
        position=data.motion("position"),
        velocity=data.motion("velocity"),
        acceleration=data.column("inertia"),
        measured=data.torque,
        predicted=predicted,
        residual=estimate.residual,
        friction=friction,
        recording=numbers,
    )
