"""A dynamic model once more, where the recording shows presliding: unbiased by the encoder's counts, honest errors.

1. The fit of ordinary records is the start of a weighted one of fine records (`friction_hil.identification.fine`):
   a stretch where the motion is finer than the encoder tells, so that the model's state gets lost, says so by its
   residual and counts less (iteratively reweighted).
2. What bias is left is found by repeating the experiment: the fitted model's own torque over the smoothed motion,
   which an encoder counts anew, is fitted by one Gauss-Newton step. The mean shift is taken off.
   Source: indirect inference; C. Gourieroux, A. Monfort, E. Renault, Journal of Applied Econometrics 8, 1993.
3. Standard errors are those of Newey and West plus what the shifts leave unknown.
"""

from dataclasses import replace

import numpy as np

from friction_hil import friction as models
from friction_hil.errors import UsageError
from friction_hil.identification import structures
from friction_hil.identification.data import Data, linear_column
from friction_hil.identification.fine import ROWS_HZ, FineSegment, local_rms, recounted
from friction_hil.identification.inference import Inference, infer
from friction_hil.identification.problem import Estimate, Problem, is_positive
from friction_hil.identification.structures import Scales, Structure
from friction_hil.numerics.jit import Array

REPLICAS = 8
_REWEIGHTINGS = 2
_WEIGHT_S = 0.25  # over which a residual is looked at
_EQUAL_SHARE = 0.25  # of the rows, the quietest ones, count alike
_LAG_S = 0.5  # over which residuals are taken to be correlated
_SHIFT_DOUBT = 1.0 / 8.0  # of the square of a shift, which is as good as the model it is made with


def is_dynamic(structure: Structure) -> bool:
    """Whether friction has a state, which fast reversals show."""
    return not models.describe(structure.family).is_static


def refine(
    problem: Problem,
    originals: Data,
    at: Array,
    scales: Scales,
    *,
    replicas: int = REPLICAS,
    seed: int = 0,
) -> tuple[Estimate, Inference, list[str]]:
    """Estimate a structure on fine records.

    Parameters
    ----------
    problem : Problem
        On `fine_data`.
    originals : Data
        The ordinary records.
    at : (m,) array
        Coordinates of the fit to these.
    scales : Scales
    replicas : int
        Repeated experiments; at least 2.
    seed : int
        Of the repeated experiments.

    Returns
    -------
    estimate : Estimate
        Bias taken off.
    inference : Inference
    notes : list of str
    """
    weights: Array | None = None
    estimate = problem.estimate(_inside(problem, at, scales))
    for _ in range(_REWEIGHTINGS):
        weights = _weights(problem.data, estimate.residual)
        estimate = problem.estimate(estimate.coordinates, weights=weights)
    inference = infer(estimate, problem.data.parts, lags=round(_LAG_S * ROWS_HZ))
    shifts = _shifts(problem, originals, estimate, replicas, seed)
    corrected, inference, notes = _corrected(problem, estimate, inference, shifts)
    return corrected, inference, [_convention(problem.data), *notes]


def _convention(data: Data) -> str:
    """What was taken for granted of the torque: nothing in a recording tells it, and damping hangs on it."""
    record = data.records[0]
    assert isinstance(record, FineSegment)
    taken = "the mean over the period before the sample" if record.is_mean else "that of the instant"
    other = "instant" if record.is_mean else "mean"
    return (
        f"torque is taken to be {taken}; if it is not (--torque-is {other}), damping of presliding is wrong by its "
        f"stiffness times half a period, {0.5 / record.sample_hz:.3g} s"
    )


def _inside(problem: Problem, at: Array, scales: Scales) -> Array:
    """Start from coordinates, but where one ended at a bound from what the scales suggest: it has no slope there."""
    first = next(structures.starts(problem.structure, scales, 0, 0))
    suggested = np.array([each.inner(first[each.name]) for each in problem.structure.coordinates])
    return np.where((at <= problem.lower) | (at >= problem.upper), suggested, at)


def _near(data: Data, residual: Array) -> Array:
    """Size of the residual nearby, (k,)."""
    return np.concatenate([local_rms(residual[part], _WEIGHT_S) for part in data.parts])


def _weights(data: Data, residual: Array) -> Array:
    near = _near(data, residual)
    return np.asarray(1.0 / np.maximum(near, max(float(np.quantile(near, _EQUAL_SHARE)), 1e-300)))


def _shifts(problem: Problem, originals: Data, estimate: Estimate, replicas: int, seed: int) -> Array:
    """By how much an estimate misses the truth where that is ``estimate``, (replicas, p)."""
    random = np.random.default_rng(seed)
    torques = _sensed(problem, estimate)
    mechanics = [name for name in problem.keys if name not in problem.structure.linear]
    rows = []
    for _ in range(replicas):
        data = recounted(problem.data, originals.records, torques, random)
        again = Problem(data, problem.structure, mechanics, problem.held, problem.loads)
        linear = {name: estimate.values[name] for name in again.keys}
        residual = data.torque - again.predict(estimate.coordinates, linear, again.friction(estimate.coordinates)[0])
        jacobian = again.jacobian(estimate.coordinates, estimate.names)
        # a state that gets lost here only counts less here, as it would in a recording
        joint = 1.0 / np.hypot(1.0 / estimate.weights, _near(data, residual))
        columns = jacobian * joint[:, None]
        norms = np.linalg.norm(columns, axis=0)
        norms[norms == 0.0] = 1.0
        rows.append(np.linalg.lstsq(columns / norms, residual * joint, rcond=1e-7)[0] / norms)
    return np.array(rows)


def _sensed(problem: Problem, estimate: Estimate) -> list[Array]:
    """Torque that a sensor without noise would have told at the samples of each record."""
    structure = problem.structure
    linear = {**problem.held, **{name: estimate.values[name] for name in problem.keys}}
    keys = {**{name: name for name in problem.held}, **problem.keys}
    model = structure.model(structure.values(estimate.coordinates))
    found = []
    for number, record in enumerate(problem.data.records):
        assert isinstance(record, FineSegment)
        torque = model.simulate(
            record.velocity,
            record.dt,
            position=record.position,
            load_torque=None if problem.loads is None else problem.loads[number],
            temperature=record.temperature,
        )
        for name, value in linear.items():
            unit = record.acceleration if keys[name] == "inertia" else linear_column(keys[name], record)
            torque = torque + value * unit
        found.append(record.at_samples(torque))
    return found


def _corrected(
    problem: Problem, estimate: Estimate, inference: Inference, shifts: Array
) -> tuple[Estimate, Inference, list[str]]:
    """Take the mean shift off, and let the errors know of it."""
    names, structure = estimate.names, problem.structure
    shift, spread = shifts.mean(axis=0), shifts.var(axis=0, ddof=1)
    values = {
        **estimate.values,
        **{name: estimate.values[name] - x for name, x in zip(names, shift.tolist(), strict=True)},
    }
    below = tuple(name for name in problem.keys if is_positive(name) and values[name] < 0.0)
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
        values.update(structure.values(coordinates))  # tied ones
        linear = {name: values[name] for name in problem.keys}
        residual = problem.data.torque - problem.predict(coordinates, linear)
        at_bound = tuple(dict.fromkeys((*estimate.at_bound, *below)))
        estimate = replace(estimate, values=values, coordinates=coordinates, residual=residual, at_bound=at_bound)
    else:
        notes.append("the shift by the encoder's counts would leave the bounds: it is in the errors, not taken off")
    doubt = _SHIFT_DOUBT if is_inside else 1.0
    variance = (1.0 + 1.0 / len(shifts)) * spread + doubt * shift**2
    errors = {
        name: float(np.hypot(inference.standard_errors[name], np.sqrt(more)))
        for name, more in zip(names, variance, strict=True)
    }
    return estimate, replace(inference, standard_errors=errors), notes
