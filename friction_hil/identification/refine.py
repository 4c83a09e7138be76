"""Refinement of a dynamic model on recordings that show presliding, without the bias of the encoder's counts.

1. A weighted fit to fine records (`friction_hil.identification.fine`) starts from the fit to ordinary records. Where
   the motion is finer than the encoder resolves, the state of the model is wrong and the residual grows: such stretches
   get smaller weights (iteratively reweighted least squares).
2. The remaining bias is estimated by simulated experiments: the fitted model's torque along the smoothed motion, which
   a simulated encoder counts anew, is fitted by one Gauss-Newton step. The mean shift is subtracted.
   Source: indirect inference; C. Gourieroux, A. Monfort, E. Renault, Journal of Applied Econometrics 8, 1993.
3. Standard errors are those of Newey and West plus the uncertainty of the shifts.
"""

from dataclasses import replace

import numpy as np

from friction_hil import friction as models
from friction_hil.errors import UsageError
from friction_hil.identification import structures
from friction_hil.identification import thresholds as th
from friction_hil.identification.data import Data, linear_column
from friction_hil.identification.fine import FineSegment, local_rms, recounted
from friction_hil.identification.inference import Inference, infer
from friction_hil.identification.least_squares import column_norms, least_norm_solution
from friction_hil.identification.regression import Estimate, Regression
from friction_hil.identification.structures import InitialScales, ModelStructure
from friction_hil.numerics.jit import Array

LAG_ROWS = round(0.5 * th.ROWS_HZ)  # over which residuals are taken to be correlated


def is_dynamic(structure: ModelStructure) -> bool:
    """Return True if the friction model has a state, which fast reversals show."""
    return not models.describe(structure.family).is_static


def refine(
    regression: Regression,  # on `friction_hil.identification.fine.fine_data`
    coarse: Regression,  # the same with fewer steps of the model per sample: the search and the weights come from there
    originals: Data,  # the ordinary records
    at: Array,  # (m,), coordinates to start from
    scales: InitialScales,
    *,
    replicas: int = th.REPLICAS,  # simulated experiments, at least 2
    seed: int = 0,  # of the simulated experiments
) -> tuple[Estimate, Inference, list[str]]:
    """Estimate a structure on fine records: the estimate, with the bias subtracted, its uncertainty, and notes."""
    estimate = coarse.estimate(inside(coarse, at, scales), evaluations=th.REFINED_EVALUATIONS)
    weights = _weights(coarse.data, estimate.residual)
    for _ in range(th.REWEIGHTINGS - 1):
        estimate = coarse.estimate(estimate.coordinates, weights=weights, evaluations=th.FURTHER_EVALUATIONS)
        weights = _weights(coarse.data, estimate.residual)
    estimate = regression.estimate(estimate.coordinates, weights=weights, evaluations=th.FURTHER_EVALUATIONS)
    inference = infer(estimate, regression.data.parts, lags=LAG_ROWS)
    shifts = _shifts(regression, originals, estimate, replicas, seed)
    corrected, inference, notes = _corrected(regression, estimate, inference, shifts)
    return corrected, inference, notes


def weighted_estimate(regression: Regression, at: Array, scales: InitialScales, *, evaluations: int = 60) -> Estimate:
    """Estimate a structure on fine records from ``at``, with small weights where the state of the model is wrong."""
    estimate = regression.estimate(inside(regression, at, scales), evaluations=evaluations)
    for _ in range(th.REWEIGHTINGS):
        weights = _weights(regression.data, estimate.residual)
        estimate = regression.estimate(estimate.coordinates, weights=weights, evaluations=evaluations)
    return estimate


def inside(regression: Regression, at: Array, scales: InitialScales) -> Array:
    """Return coordinates to start from: those at a bound, where they have no gradient, come from the scales."""
    first = next(structures.starts(regression.structure, scales, 0, 0))
    suggested = np.array([each.inner(first[each.name]) for each in regression.structure.coordinates])
    return np.where((at <= regression.lower) | (at >= regression.upper), suggested, at)


def _near(data: Data, residual: Array) -> Array:
    """Return the local root mean square of the residual, (k,)."""
    return np.concatenate([local_rms(residual[part], th.WEIGHT_S) for part in data.parts])


def _weights(data: Data, residual: Array) -> Array:
    near = _near(data, residual)
    return np.asarray(1.0 / np.maximum(near, max(float(np.quantile(near, th.EQUAL_FRACTION)), 1e-300)))


def _shifts(regression: Regression, originals: Data, estimate: Estimate, replicas: int, seed: int) -> Array:
    """Return the errors of estimates from simulated experiments whose truth is ``estimate``, (replicas, p)."""
    random = np.random.default_rng(seed)
    torques = sensed(regression, estimate)
    rows = []
    for _ in range(replicas):
        data = recounted(regression.data, originals.records, torques, random)
        again = regression.on(data)
        linear = {name: estimate.values[name] for name in again.keys}
        residual = data.torque - again.predict(estimate.coordinates, linear, again.friction(estimate.coordinates)[0])
        jacobian = again.jacobian(estimate.coordinates, estimate.names)
        # a stretch where the state is wrong in this replica only gets a smaller weight, as in a recording
        joint = 1.0 / np.hypot(1.0 / estimate.weights, _near(data, residual))
        columns = jacobian * joint[:, None]
        norms = column_norms(columns)
        norms[norms == 0.0] = 1.0
        rows.append(least_norm_solution(columns / norms, residual * joint, 1e-7) / norms)
    return np.array(rows)


def sensed(regression: Regression, estimate: Estimate) -> list[Array]:
    """Return the torque that a sensor without noise would report at the samples of each record."""
    found = []
    for record, torque in zip(regression.data.records, torque_at_steps(regression, estimate), strict=True):
        assert isinstance(record, FineSegment)
        found.append(record.at_samples(torque))
    return found


def torque_at_steps(regression: Regression, estimate: Estimate) -> list[Array]:
    """Return the predicted torque (n,) of each record at the steps of the model."""
    linear = {**regression.held, **{name: estimate.values[name] for name in regression.keys}}
    keys = {**{name: name for name in regression.held}, **regression.keys}
    found = []
    for record, torque in zip(regression.data.records, regression.simulated(estimate.coordinates), strict=True):
        for name, value in linear.items():
            unit = record.acceleration if keys[name] == "inertia" else linear_column(keys[name], record)
            torque = torque + value * unit
        found.append(torque)
    return found


def _corrected(
    regression: Regression, estimate: Estimate, inference: Inference, shifts: Array
) -> tuple[Estimate, Inference, list[str]]:
    """Subtract the mean shift, and add the uncertainty of the shift to the standard errors."""
    names, structure = estimate.names, regression.structure
    shift, spread = shifts.mean(axis=0), shifts.var(axis=0, ddof=1)
    values = {
        **estimate.values,
        **{name: estimate.values[name] - x for name, x in zip(names, shift.tolist(), strict=True)},
    }
    below = tuple(regression.impossible({name: values[name] for name in regression.keys}))
    values.update(dict.fromkeys(below, 0.0))
    notes = []
    coordinates, is_inside = estimate.coordinates.copy(), True
    for i, each in enumerate(structure.coordinates):
        if each.name in names:
            is_inside &= each.lower < values[each.name] < each.upper
            coordinates[i] = each.inner(values[each.name])
    try:
        structure.model(structure.values(coordinates))
    except UsageError:
        is_inside = False
    if is_inside:
        values.update(structure.values(coordinates))  # includes tied parameters
        linear = {name: values[name] for name in regression.keys}
        residual = regression.data.torque - regression.predict(coordinates, linear)
        at_bound = tuple(dict.fromkeys((*estimate.at_bound, *below)))
        estimate = replace(estimate, values=values, coordinates=coordinates, residual=residual, at_bound=at_bound)
    else:
        notes.append("the bias by the encoder's counts exceeds the bounds: it is part of the errors, not subtracted")
    doubt = th.SHIFT_DOUBT if is_inside else 1.0
    variance = (1.0 + 1.0 / len(shifts)) * spread + doubt * shift**2
    errors = {
        name: float(np.hypot(inference.standard_errors[name], np.sqrt(more)))
        for name, more in zip(names, variance, strict=True)
    }
    return estimate, replace(inference, standard_errors=errors), notes
