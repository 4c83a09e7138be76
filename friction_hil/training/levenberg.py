"""Levenberg-Marquardt on normal equations, with column scaling and gain-ratio damping. Pure.

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
_REFUSALS = 12  # steps in a row that do not lower the cost before a search gives up

Cost = Callable[[Array], float]
Linear = Callable[[], tuple[Array, Array]]


@dataclass(frozen=True, slots=True)
class Progress:
    """Where a search stands after an iteration."""

    iteration: int
    cost: float
    damping: float
    at: Array


@dataclass(frozen=True, slots=True)
class Solution:
    """Where a search ended.

    Attributes
    ----------
    at : (m,) array
    cost : float
    iterations : int
        Accepted and refused steps.
    damping : float
        To go on with.
    is_converged : bool
        Whether no step was left that lowers the cost by more than the tolerance.
    """

    at: Array
    cost: float
    iterations: int
    damping: float
    is_converged: bool


def minimise(
    cost: Cost,
    linear: Linear,
    start: Array,
    *,
    iterations: int,
    damping: float = _FIRST_DAMPING,
    tolerance: float = 1e-9,
    goes_on: Callable[[Progress], bool] = lambda progress: True,
) -> Solution:
    """Find the least sum of squares from ``start``.

    Parameters
    ----------
    cost : callable
        Sum of squares r' r at (m,); not finite where there is no model.
    linear : callable
        J' J (m, m) and J' r (m,) where ``cost`` was called last.
    start : (m,) array
    iterations : int
        Most steps.
    damping : float
        At the start, relative to the scaled normal equations.
    tolerance : float
        Relative decrease, as the linear model promises it, below which the search is over.
    goes_on : callable
        Called after every step that lowered the cost; returns False to stop there.
    """
    at, size = np.array(start, dtype=np.float64), len(start)
    now, factor, scale = cost(at), 2.0, np.zeros(size)
    if not math.isfinite(now):
        return Solution(at, math.inf, 0, damping, False)
    matrix, gradient = linear()
    step, room, refused = np.empty(size), np.empty((size, size)), 0
    for iteration in range(1, iterations + 1):
        diagonal = np.diag(matrix)
        scale = np.maximum(scale, diagonal)
        weights = np.where(scale > 0.0, scale, 1.0)
        damped = matrix + np.diag(damping * weights)
        if not solve(damped, -gradient, step, room):
            damping, factor, refused = damping * factor, 2.0 * factor, refused + 1
            continue
        promised = float(step @ (damping * weights * step - gradient))
        if promised <= tolerance * now:
            return Solution(at, now, iteration, damping, True)
        trial = at + step
        then = cost(trial)
        gain = (now - then) / promised if math.isfinite(then) else -1.0
        if gain > 0.0:
            at, now, refused = trial, then, 0
            damping, factor = max(damping * max(1.0 / 3.0, 1.0 - (2.0 * gain - 1.0) ** 3), 1e-15), 2.0
            matrix, gradient = linear()
            if not goes_on(Progress(iteration, now, damping, at)):
                return Solution(at, now, iteration, damping, False)
        else:
            damping, factor, refused = damping * factor, 2.0 * factor, refused + 1
            if damping > _MOST_DAMPING or refused > _REFUSALS:
                return Solution(at, now, iteration, damping, False)
    return Solution(at, now, iterations, damping, False)
