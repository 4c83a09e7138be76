"""What rows show of the amplitudes of a residual layer, and of the model's parameters beside them.

Amplitudes and coordinates are those of least squares with what was expected before (S. M. Kay, Fundamentals of
Statistical Signal Processing: Estimation Theory, 1993, chapter 11); the coordinates act in straight lines.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from friction_hil.friction import FrictionModel
from friction_hil.learning.estimate import LeftOver
from friction_hil.learning.layer import LOAD, REVERSAL, SPEED, Feature, columns
from friction_hil.numerics.jit import Array

SAME_ROWS = 20.0  # rows that show no more than one, because what a model leaves is correlated
EXPLAINED = 0.1  # of the mean square of what the model leaves: a layer that explains less is not worth a trial
STRETCHES = 12  # of a window, that count as repeated records
_REMEMBERED_S = 60.0  # time constant of forgetting
_EVIDENT = 3.0  # standard errors by which the explained part exceeds chance
AT_TIMES = 1.5  # the same of what a slow motion shows at a few reversals only
_EXPECTED = 0.1  # of the friction level: standard deviation of an amplitude before anything was learned
_SMOOTH = 0.05  # of the friction level: the same of the change from one place of a curve to the next
_DIFFERENT = 0.015  # and of that of half the difference between both directions


@dataclass(frozen=True, slots=True)
class Memory:
    """Normal equations of weighted rows: ``information`` (m, m) and ``shown`` (m,)."""

    information: Array
    shown: Array

    def older(self, seconds: float) -> "Memory":
        """Return what is left of it after some time."""
        kept = math.exp(-seconds / _REMEMBERED_S)
        return Memory(kept * self.information, kept * self.shown)

    def with_rows(self, columns: Array, target: Array) -> "Memory":
        """Return the memory with further rows (k, m), (k,)."""
        return Memory(self.information + columns.T @ columns, self.shown + columns.T @ target)

    def at(self, index: list[int]) -> "Memory":
        """Return that of some of the values."""
        return Memory(self.information[np.ix_(index, index)], self.shown[index])

    def solved(self, mean: Array, prior: Array) -> Array:
        """Return the values (m,) that are most probable with those, and their information (m, m), expected before."""
        return np.asarray(np.linalg.solve(self.information + prior, self.shown + prior @ mean))


def empty(count: int) -> Memory:
    """Return the memory of nothing."""
    return Memory(np.zeros((count, count)), np.zeros(count))


@dataclass(frozen=True, slots=True)
class Rows:
    """Weighted rows of a window."""

    weights: Array  # (k,)
    # (k, n + m) of the torque of n features with an amplitude of one, and of what is explained by the coordinates
    columns: Array
    target: Array  # (k,) what the belief leaves of the torque
    whole: Array  # (k,) what coordinates of zero would leave of it
    x: Array  # (m,) coordinates
    first: Array  # (m,) their standard deviations before anything was learned


def rows_of(left: LeftOver, weights: Array, features: Sequence[Feature]) -> Rows:
    """Return the rows of a window with weights (k,)."""
    found = columns(left.belief.model, features, left.gradient)
    whole = left.torque - left.slopes @ left.belief.x
    return Rows(
        weights,
        weights[:, None] * np.column_stack([found, -left.slopes]),
        weights * left.torque,
        weights * whole,
        left.belief.x,
        left.belief.first,
    )


def is_evident(before: Array, after: Array, errors: float = _EVIDENT) -> bool:
    """Return True if weighted residuals (k,) became smaller, by so many errors of what their stretches scatter by."""
    starts = np.linspace(0, before.size, STRETCHES, endpoint=False).astype(int)
    gains = np.add.reduceat(before**2 - after**2, starts)
    error = float(np.std(gains, ddof=1)) / math.sqrt(gains.size)
    share = float(np.sum(gains)) / max(float(np.sum(before**2)), 1e-300)
    return share > EXPLAINED and float(np.mean(gains)) > errors * error


def expected(features: Sequence[Feature]) -> Array:
    """Return the information (m, m) with which amplitudes of features are expected about zero, in friction levels.

    Curves are smooth and both directions are alike: the mean of both and half their difference are random walks along
    the places of a curve.
    """
    found = np.eye(len(features)) * _EXPECTED**-2.0
    for group in (REVERSAL, SPEED, LOAD):
        own = [i for i, each in enumerate(features) if each.group == group]
        count = len(own) // 2
        steps = np.eye(count) - np.eye(count, k=-1)
        walk = np.kron(steps.T @ steps, np.diag([_SMOOTH**-2.0, _DIFFERENT**-2.0]))
        both = np.kron(np.eye(count), np.array([[0.5, 0.5], [0.5, -0.5]]))
        found[np.ix_(own, own)] = SAME_ROWS * both.T @ walk @ both
    return np.asarray(found)


def presliding(model: FrictionModel) -> float:
    """Return the distance over which the torque builds up after a reversal, rad or m; 0 for a static map."""
    stiffness = model.presliding_stiffness
    return model.level / stiffness if stiffness > 0.0 else 0.0


def power_of_two(value: float) -> float:
    """Return the next power of two, so that ranges that hardly differ have the same; 0 for 0."""
    return float(2.0 ** math.ceil(math.log2(value))) if value > 0.0 else 0.0
