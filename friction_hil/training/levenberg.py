"""Levenberg-Marquardt search without bounds, on normal equations that the caller accumulates. Pure.

For many samples and about a hundred parameters: the whole Jacobian is never stored, and derivatives are computed after
accepted steps only. `friction_hil.identification.least_squares` searches within bounds; each of the two does worse on
the problems of the other.

Sources: J. J. More, Numerical Analysis, Lecture Notes in Mathematics 630, 1978 (scaling); K. Madsen, H. B. Nielsen,
O. Tingleff, Methods for Non-Linear Least Squares Problems, 2nd ed., DTU 2004, section 3.2 (damping).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from friction_hil.numerics.jit import Array
from friction_hil.training.normal import solve

_FIRST_DAMPING = 1e-2
_MOST_DAMPING = 1e12
_REJECTIONS = 12  # steps in a row that do not lower the cost before the search ends

Cost = Callable[[Array], float]
NormalEquations = Callable[[], tuple[Array, Array]]


@dataclass(frozen=True, slots=True)
class SearchStep:
    """State of a search after a step that lowered the cost."""

    iteration: int
    cost: float
    damping: float
    at: Array


@dataclass(frozen=True, slots=True)
class UnboundedSolution:
    """Result of `minimise_unbounded`."""

    at: Array  # (m,)
    cost: float
    iterations: int  # accepted and rejected steps
    damping: float  # with which to continue the search
    is_converged: bool  # the predicted decrease of the next step is below the tolerance


def minimise_unbounded(
    cost: Cost,  # takes (m,) and returns the sum of squares r' r; not finite where it is undefined
    normal_equations: NormalEquations,  # returns J' J (m, m) and J' r (m,) at the argument of the last call of ``cost``
    start: Array,  # (m,)
    *,
    iterations: int,  # most steps
    damping: float = _FIRST_DAMPING,  # at first, relative to the scaled normal equations
    tolerance: float = 1e-9,  # relative decrease predicted by the linear model below which the search ends
    # called after every step that lowered the cost; False ends the search
    goes_on: Callable[[SearchStep], bool] = lambda step: True,
) -> UnboundedSolution:
    """Minimise a sum of squares, from ``start``."""
    at, size = np.array(start, dtype=np.float64), len(start)
    now, growth, scale = cost(at), 2.0, np.zeros(size)
    if not math.isfinite(now):
        return UnboundedSolution(at, math.inf, 0, damping, False)
    matrix, gradient = normal_equations()
    step, cholesky, rejected = np.empty(size), np.empty((size, size)), 0
    for iteration in range(1, iterations + 1):
        diagonal = np.diag(matrix)
        scale = np.maximum(scale, diagonal)
        weights = np.where(scale > 0.0, scale, 1.0)
        damped = matrix + np.diag(damping * weights)
        if not solve(damped, -gradient, step, cholesky):
            damping, growth, rejected = damping * growth, 2.0 * growth, rejected + 1
            continue
        predicted = float(step @ (damping * weights * step - gradient))
        if predicted <= tolerance * now:
            return UnboundedSolution(at, now, iteration, damping, True)
        trial = at + step
        then = cost(trial)
        gain = (now - then) / predicted if math.isfinite(then) else -1.0
        if gain > 0.0:
            at, now, rejected = trial, then, 0
            damping, growth = max(damping * max(1.0 / 3.0, 1.0 - (2.0 * gain - 1.0) ** 3), 1e-15), 2.0
            matrix, gradient = normal_equations()
            if not goes_on(SearchStep(iteration, now, damping, at)):
                return UnboundedSolution(at, now, iteration, damping, False)
        else:
            damping, growth, rejected = damping * growth, 2.0 * growth, rejected + 1
            if damping > _MOST_DAMPING or rejected > _REJECTIONS:
                return UnboundedSolution(at, now, iteration, damping, False)
    return UnboundedSolution(at, now, iterations, damping, False)
