"""Levenberg-Marquardt search within bounds, for few parameters and residuals with an exact Jacobian. Pure.

Source: J. J. More, "The Levenberg-Marquardt algorithm: implementation and theory", Numerical Analysis, Lecture Notes in
Mathematics 630, 1978. Parameters at a bound are held as long as the gradient points outwards.

Training has a search of its own (`friction_hil.training.levenberg`), without bounds, which computes derivatives after
accepted steps only. Each of the two does worse on the problems of the other.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from friction_hil.errors import FrictionHilError
from friction_hil.numerics.jit import Array, compiled

_FIRST_DAMPING = 1e-6
_LEAST_GAIN = 1e-4  # of the predicted decrease: a step with a smaller one is rejected
_TRIALS = 12  # dampings tried for one step before the search ends
_LEAST_CHANGE = 0.3  # of a rejected step: one that differs by less is not evaluated


class FitError(FrictionHilError):
    """The numbers of a candidate fail: it is left out of a search."""


NUMERICAL = (FitError, ArithmeticError, np.linalg.LinAlgError)  # what a candidate's numbers can raise


@dataclass(frozen=True, slots=True)
class BoundedSolution:
    """Result of `minimise_bounded`."""

    at: Array  # (m,)
    residual: Array  # (k,)
    jacobian: Array  # (k, m), derivative of the residual
    cost: float  # sum of squares of the residual
    is_converged: bool  # no step was left that lowers the cost; False: the evaluations ran out


@compiled
def normal_equations(jacobian: Array, residual: Array, matrix: Array, gradient: Array) -> None:
    """Fill ``matrix`` (m, m) with J' J and ``gradient`` (m,) with J' r.

    Compiled, because a BLAS spends most of its time on its threads with tall and thin matrices.
    """
    rows, columns = jacobian.shape
    matrix[:] = 0.0
    gradient[:] = 0.0
    for k in range(rows):
        for i in range(columns):
            value = jacobian[k, i]
            gradient[i] += value * residual[k]
            for j in range(i + 1):
                matrix[i, j] += value * jacobian[k, j]
    for i in range(columns):
        for j in range(i):
            matrix[j, i] = matrix[i, j]


@compiled
def project_out(basis: Array, values: Array) -> None:
    """Remove from ``values`` (k, m), in place, the part in the span of the orthonormal columns of ``basis`` (k, l)."""
    rows, count = basis.shape
    columns = values.shape[1]
    products = np.zeros((count, columns))
    for k in range(rows):
        for i in range(count):
            for j in range(columns):
                products[i, j] += basis[k, i] * values[k, j]
    for k in range(rows):
        for i in range(count):
            for j in range(columns):
                values[k, j] -= basis[k, i] * products[i, j]


def column_norms(matrix: Array) -> Array:
    """Return the Euclidean norms of the columns of (k, m), which neither overflow nor underflow."""
    largest = np.max(np.abs(matrix), axis=0, initial=0.0)
    scale = np.where((largest > 0.0) & np.isfinite(largest), largest, 1.0)
    return np.asarray(scale * np.linalg.norm(matrix / scale, axis=0))


def least_norm_solution(matrix: Array, right: Array, rank: float | None = None) -> Array:
    """Return the solution of least norm of a linear least-squares problem, (m,) of a matrix (k, m).

    ``rank``: singular values below this fraction of the largest one are taken to be zero; None: the machine precision.
    Raises `FitError`: a number is not finite.
    """
    if not (np.isfinite(matrix).all() and np.isfinite(right).all()):
        raise FitError("its least-squares problem has numbers that are not finite")
    try:
        return np.asarray(np.linalg.lstsq(matrix, right, rcond=rank)[0])
    except np.linalg.LinAlgError:  # the divide-and-conquer SVD can fail; a pivoted QR does not iterate
        from scipy import linalg  # imported here: it is hardly ever needed

        return np.asarray(linalg.lstsq(matrix, right, cond=rank, lapack_driver="gelsy")[0])


def scaled_solution(matrix: Array, right: Array, rank: float | None = None) -> Array:
    """Return `least_norm_solution` with the columns scaled to length 1; 0 for a column of zeros."""
    norms = np.linalg.norm(matrix, axis=0)
    norms[norms == 0.0] = 1.0
    return np.asarray(least_norm_solution(matrix / norms, right, rank) / norms)


def _norm(values: Array) -> float:
    return math.sqrt(values @ values)


def _damped_step(matrix: Array, right: Array, damping: float) -> Array:
    """Return the solution of the damped normal equations; of least norm if they are singular."""
    return least_norm_solution(matrix + damping * np.eye(len(right)), right)


def _cost(residual: Array, jacobian: Array) -> float:
    """Return the sum of squares; infinite where residual or Jacobian cannot be used for a step."""
    return float(residual @ residual) if math.isfinite(float(np.sum(np.abs(jacobian)))) else math.inf


def _is_same(step: Array, rejected: Array, scale: Array) -> bool:
    """Return True if a step differs too little from a rejected one to be evaluated."""
    return _norm(scale * (step - rejected)) < _LEAST_CHANGE * _norm(scale * rejected)


def _increased(damping: float) -> float:
    """Return the damping after a rejected step."""
    return max(10.0 * damping, 1e-5)


def _adapted(damping: float, decrease: float, predicted: float) -> float:
    """Return the damping after an accepted step, by how well the linear model predicted its decrease."""
    if decrease > 0.7 * predicted:
        return max(0.1 * damping, 1e-14)
    return 5.0 * damping if decrease < 0.25 * predicted else damping


def minimise_bounded(
    # takes (m,) and returns residual (k,) and Jacobian (k, m); the residual is not finite where it is undefined
    residual: Callable[[Array], tuple[Array, Array]],
    start: Array,  # (m,), as the bounds
    lower: Array,
    upper: Array,
    *,
    evaluations: int = 60,  # most calls of ``residual``
    tolerance: float = 1e-9,  # relative decrease of the sum below which the search ends
    longest: Array | None = None,  # (m,), longest step of each parameter
) -> BoundedSolution:
    """Minimise a sum of squares within bounds, from ``start``."""
    at = np.clip(start, lower, upper)
    r, jacobian = residual(at)
    cost = _cost(r, jacobian)
    calls, damping, scale = 1, _FIRST_DAMPING, np.zeros(len(at))
    if not math.isfinite(cost):
        return BoundedSolution(at, r, jacobian, math.inf, False)
    matrix, gradient = np.empty((len(at), len(at))), np.empty(len(at))
    while calls < evaluations:
        normal_equations(jacobian, r, matrix, gradient)
        is_held = ((at <= lower) & (gradient > 0.0)) | ((at >= upper) & (gradient < 0.0))
        norms = np.sqrt(np.diag(matrix))
        if not math.isfinite(float(np.sum(norms))):
            return BoundedSolution(at, r, jacobian, cost, False)
        scale = np.maximum(scale, norms)
        free = np.flatnonzero(~is_held & (norms > 0.0))
        if not free.size or cost == 0.0:
            return BoundedSolution(at, r, jacobian, cost, True)
        size = scale[free]
        scaled = matrix[np.ix_(free, free)] / np.outer(size, size)
        rejected: Array | None = None
        for _ in range(_TRIALS):
            step = np.zeros(len(at))
            step[free] = _damped_step(scaled, -gradient[free] / size, damping) / size
            if longest is not None:
                step = np.clip(step, -longest, longest)
            trial = np.clip(at + step, lower, upper)
            step = trial - at
            if rejected is not None and _is_same(step, rejected, scale):
                damping = _increased(damping)
                continue
            rejected = step
            predicted = -float(2.0 * gradient @ step + step @ matrix @ step)
            r_trial, jacobian_trial = residual(trial)
            calls += 1
            cost_trial = _cost(r_trial, jacobian_trial)
            if math.isfinite(cost_trial) and cost - cost_trial > _LEAST_GAIN * max(predicted, 0.0):
                break
            if abs(predicted) <= tolerance * cost or calls >= evaluations:
                return BoundedSolution(at, r, jacobian, cost, abs(predicted) <= tolerance * cost)
            damping = _increased(damping)
        else:
            return BoundedSolution(at, r, jacobian, cost, False)
        decrease = cost - cost_trial
        damping = _adapted(damping, decrease, predicted)
        is_over = decrease <= tolerance * cost
        at, r, jacobian, cost = trial, r_trial, jacobian_trial, cost_trial
        if is_over:
            return BoundedSolution(at, r, jacobian, cost, True)
    return BoundedSolution(at, r, jacobian, cost, False)
