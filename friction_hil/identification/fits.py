"""Fit of one candidate: parameters with their uncertainty, prediction errors, and curves for reports."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from friction_hil.identification import structures
from friction_hil.identification import thresholds as th
from friction_hil.identification.data import Data
from friction_hil.identification.inference import Inference, flags, infer
from friction_hil.identification.prediction_errors import (
    PredictionError,
    blocks,
    cross_validate,
    prediction_error,
    speed_groups,
    validate,
)
from friction_hil.identification.refine import LAG_ROWS, refine
from friction_hil.identification.regression import BACK_EMF, INVERSE_GAIN, Estimate, Regression
from friction_hil.identification.structures import InitialScales, ModelStructure
from friction_hil.numerics.jit import Array

ENDED_EARLY = "its search ended early, because other candidates fit far better; its parameters are rough"
MECHANICS = ("inertia", "offset", "gravity.constant", "gravity.sine", "gravity.cosine")


@dataclass(frozen=True, slots=True, eq=False)
class Curves:
    """Measured and predicted torque with the motion, for reports; arrays (k,) on the rows of the regression, SI."""

    time_s: Array
    position: Array
    velocity: Array
    acceleration: Array
    measured: Array
    predicted: Array
    residual: Array  # measured - predicted
    friction: Array  # predicted friction torque
    recording: Any  # index of the record of each row


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """A fitted candidate."""

    structure: ModelStructure
    values: dict[str, float]  # fitted parameters by name, mechanics included
    mechanics: dict[str, float]  # inertia, offset and gravity, including held ones
    inference: Inference
    train: PredictionError  # error on the data
    cross_validation: PredictionError  # error on blocks of the data that were held out
    across_speeds: PredictionError | None  # error on strokes held out by their speed; None: too few strokes
    validation: PredictionError | None  # error on the validation recordings
    flags: tuple[str, ...]
    coordinates: Array  # at which the search ended
    curves: Curves
    estimate: Estimate
    is_refined: bool = False  # comes from `refined`
    # comes from `friction_hil.tuning.closed_loop`: errors are those of the position, and the curves those of the start
    is_closed_loop: bool = False

    @property
    def label(self) -> str:
        """Name for tables and messages."""
        return f"{self.structure.label} in closed loop" if self.is_closed_loop else self.structure.label

    @property
    def count(self) -> int:
        """Number of fitted parameters."""
        return len(self.inference.names)

    @property
    def held_out(self) -> PredictionError:
        """Error used for the choice: on validation recordings if given, else across speeds, else across blocks."""
        return self.validation or self.across_speeds or self.cross_validation

    @property
    def drive(self) -> dict[str, float]:
        """Gain and back-EMF, if the gain of the drive was identified."""
        return {name: value for name, value in self.values.items() if name.startswith("drive.")}

    @property
    def friction(self) -> tuple[dict[str, Any], dict[str, Any]]:
        """Friction parameters and modifiers as in a model file."""
        other = (*MECHANICS, *self.drive)
        own = {name: value for name, value in self.values.items() if name not in other}
        parameters, modifiers = structures.nested({**self.structure.constants, **own})
        return parameters, modifiers


def fit(
    regression: Regression,
    scales: InitialScales,
    *,
    seed: int = 0,
    further_starts: int = 2,  # random ones, besides those that the data suggest
    # values of a related structure to start from; only one other start is then used
    warm: Mapping[str, float] | None = None,
    is_robust: bool = False,  # see `Regression.estimate`
    validation: Regression | None = None,  # of the same structure on validation recordings
    notes: Sequence[str] = (),  # put before the flags of this candidate
) -> Fit:
    """Fit a structure: short searches from several starts, a full one from the best, then errors and uncertainty.

    Raises `InvalidParameterError`: a held value is not allowed by the model.
    """
    structure = regression.structure
    begins: list[dict[str, float]] = []
    for values in structures.starts(structure, scales, seed, further_starts):
        if values not in begins:
            begins.append(values)
    if warm is not None:
        begins = [{**begins[0], **_from_plain(structure, warm)}, *begins[:1]]
    at = [np.array([each.inner(values[each.name]) for each in structure.coordinates]) for values in begins]
    structure.model(
        structure.values(at[0])
    )  # raises on an invalid held value, which a search would only step back from
    if len(at) > 1:
        first = [regression.search(each, evaluations=th.FIRST_EVALUATIONS, tolerance=1e-5) for each in at]
        at = [min(first, key=lambda solution: solution.cost).at]
    estimate = regression.estimate(at[0], is_robust=is_robust, evaluations=th.FIT_EVALUATIONS)
    inference = infer(estimate, regression.data.parts)
    return _fit(regression, estimate, inference, validation, notes)


def refined(
    base: Fit,  # fit to the ordinary records, ``originals``
    regression: Regression,  # of the same structure on `friction_hil.identification.fine.fine_data` of these records
    coarse: Regression,  # the same with fewer steps of the model per sample
    originals: Data,
    scales: InitialScales,
    *,
    replicas: int,  # simulated experiments
    start: Array | None = None,  # (m,), coordinates to start from; those of ``base`` by default
    seed: int = 0,  # of the simulated experiments
    validation: Regression | None = None,  # this and ``notes``: see `fit`
    notes: Sequence[str] = (),
) -> Fit:
    """Fit a structure once more at the encoder's resolution: see `friction_hil.identification.refine`."""
    at = base.coordinates if start is None else start
    estimate, inference, further = refine(regression, coarse, originals, at, scales, replicas=replicas, seed=seed)
    return replace(_fit(regression, estimate, inference, validation, (*notes, *further)), is_refined=True)


def ended(
    regression: Regression, estimate: Estimate, *, validation: Regression | None = None, notes: Sequence[str] = ()
) -> Fit:
    """Return the refined fit of a candidate whose search ended early, because others fit far better.

    The bias by the encoder's counts is not subtracted, and the errors on held-out data are extrapolated.
    """
    inference = infer(estimate, regression.data.parts, lags=LAG_ROWS)
    notes = (*notes, ENDED_EARLY)
    return replace(_fit(regression, estimate, inference, validation, notes, is_linear=True), is_refined=True)


def _fit(
    regression: Regression,
    estimate: Estimate,
    inference: Inference,
    validation: Regression | None,
    notes: Sequence[str],
    *,
    is_linear: bool = False,
) -> Fit:
    structure = regression.structure
    groups = speed_groups(regression.data)
    return Fit(
        structure=structure,
        values=estimate.values,
        mechanics=_mechanics(regression, estimate),
        inference=inference,
        train=prediction_error(regression.data.torque, regression.data.torque - estimate.residual),
        cross_validation=cross_validate(regression, estimate, blocks(regression.data), is_linear=is_linear),
        across_speeds=cross_validate(regression, estimate, groups, is_linear=is_linear) if groups else None,
        validation=None if validation is None else validate(validation, estimate),
        flags=(*notes, *flags(estimate, inference)),
        coordinates=estimate.coordinates,
        curves=_curves(regression.data, estimate),
        estimate=estimate,
    )


def _mechanics(regression: Regression, estimate: Estimate) -> dict[str, float]:
    """Return fitted and held mechanical parameters, in units of the measured torque."""
    scale = estimate.values.get(INVERSE_GAIN, 1.0)
    held = {**regression.held, **{name: scale * value for name, value in regression.data.known.items()}}
    return {name: estimate.values.get(name, held.get(name, 0.0)) for name in MECHANICS}


def _from_plain(structure: ModelStructure, values: Mapping[str, float]) -> dict[str, float]:
    """Return start values for a structure from those of a related one without directions or modifiers."""
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
