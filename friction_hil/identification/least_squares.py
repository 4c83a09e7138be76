"""Levenberg-Marquardt with bounds, for residuals whose gradient is exact. Pure.

Source: J. J. More, "The Levenberg-Marquardt algorithm: implementation and theory", Numerical Analysis, Lecture
Notes in Mathematics 630, 1978; bounds by holding what would leave them.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from friction_hil.numerics.jit import Array, compiled

_FIRST_DAMPING = 1e-6
_LEAST_GAIN = 1e-4  # of the decrease that the linear model promises: a smaller one is no step
_TRIALS = 12  # dampings before a search gives up
_LEAST_CHANGE = 0.3  # of a refused step: one that differs by less is not worth an evaluation


@dataclass(frozen=True, slots=True)
class Solution:
    """Where a search ended.

    Attributes
    ----------
    at : (m,) array
    residual : (k,) array
    jacobian : (k, m) array
        Derivative of the residual.
    cost : float
        Sum of squares of the residual.
    evaluations : int
    is_converged : bool
        Whether no step was left, rather than no evaluation.
    """

    at: Array
    residual: Array
    jacobian: Array
    cost: float
    evaluations: int
    is_converged: bool


@compiled
def normal_equations(jacobian: Array, residual: Array, matrix: Array, gradient: Array) -> None:
    """Fill ``matrix`` (m, m) with J' J and ``gradient`` (m,) with J' r.

    Compiled here because for tall and thin matrices a BLAS spends most of its time on its threads.
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
    """Take the part in the span of the orthonormal columns of ``basis`` (k, l) out of ``values`` (k, m), in place."""
    rows, count = basis.shape
    columns = values.shape[1]
    share = np.zeros((count, columns))
    for k in range(rows):
        for i in range(count):
            for j in range(columns):
                share[i, j] += basis[k, i] * values[k, j]
    for k in range(rows):
        for i in range(count):
            for j in range(columns):
                values[k, j] -= basis[k, i] * share[i, j]


def _norm(values: Array) -> float:
    return math.sqrt(values @ values)


def minimise(
    residual: Callable[[Array], tuple[Array, Array]],
    start: Array,
    lower: Array,
    upper: Array,
    *,
    evaluations: int = 60,
    tolerance: float = 1e-9,
    longest: Array | None = None,
) -> Solution:
    """Find the least sum of squares from ``start``.

    Parameters
    ----------
    residual : callable
        Takes (m,) and returns residual (k,) and Jacobian (k, m); not finite where there is no model.
    start, lower, upper : (m,) array
    evaluations : int
        Most calls of ``residual``.
    tolerance : float
        Relative decrease of the sum below which the search is over.
    longest : (m,) array, optional
        Longest step of each.
    """
    at = np.clip(start, lower, upper)
    r, jacobian = residual(at)
    cost = float(r @ r)
    calls, damping, scale = 1, _FIRST_DAMPING, np.zeros(len(at))
    if not math.isfinite(cost):
        return Solution(at, r, jacobian, math.inf, calls, False)
    matrix, gradient = np.empty((len(at), len(at))), np.empty(len(at))
    while calls < evaluations:
        normal_equations(jacobian, r, matrix, gradient)
        is_held = ((at <= lower) & (gradient > 0.0)) | ((at >= upper) & (gradient < 0.0))
        norms = np.sqrt(np.diag(matrix))
        scale = np.maximum(scale, norms)
        free = np.flatnonzero(~is_held & (norms > 0.0))
        if not free.size or cost == 0.0:
            return Solution(at, r, jacobian, cost, calls, True)
        size = scale[free]
        scaled = matrix[np.ix_(free, free)] / np.outer(size, size)
        refused: Array | None = None
        for _ in range(_TRIALS):
            damped = scaled + damping * np.eye(free.size)
            step = np.zeros(len(at))
            step[free] = np.linalg.lstsq(damped, -gradient[free] / size, rcond=None)[0] / size
            if longest is not None:
                step = np.clip(step, -longest, longest)
            trial = np.clip(at + step, lower, upper)
            step = trial - at
            if refused is not None and _norm(scale * (step - refused)) < _LEAST_CHANGE * _norm(scale * refused):
                damping = max(10.0 * damping, 1e-5)
                continue
            refused = step
            predicted = -float(2.0 * gradient @ step + step @ matrix @ step)
            r_trial, jacobian_trial = residual(trial)
            calls += 1
            cost_trial = float(r_trial @ r_trial)
            if math.isfinite(cost_trial) and cost - cost_trial > _LEAST_GAIN * max(predicted, 0.0):
                break
            if abs(predicted) <= tolerance * cost or calls >= evaluations:
                return Solution(at, r, jacobian, cost, calls, abs(predicted) <= tolerance * cost)
            damping = max(10.0 * damping, 1e-5)
        else:
            return Solution(at, r, jacobian, cost, calls, False)
        decrease = cost - cost_trial
        if decrease > 0.7 * predicted:
            damping = max(0.1 * damping, 1e-14)
        elif decrease < 0.25 * predicted:
            damping *= 5.0
        is_over = decrease <= tolerance * cost
        at, r, jacobian, cost = trial, r_trial, jacobian_trial, cost_trial
        if is_over:
            return Solution(at, r, jacobian, cost, calls, True)
    return Solution(at, r, jacobian, cost, calls, False)
