"""Constraint that makes a network stable by design: a bound on its feedback weights.

The absolute slopes of the targets of the states over the fed-back values sum to less than a bound, whatever the inputs.
The slope of tanh lies between 0 and 1; the paths from a fed-back value to an output that raise it, and those that lower
it, therefore contribute at most the sum of the products of their weights. The larger of both sums bounds the slope.
Feedback weights beyond the bound are scaled down together by a smooth function of the searched weights.

A bound below 1 makes a gated network a contraction: it forgets its initial state as it moves. A narx needs slopes near
1 to hold its torque at rest and small ones in motion, which no bound on weights can tell apart. Its output is clipped,
and `checks` tests it at rest.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from friction_hil.friction import NetworkStructure
from friction_hil.numerics.jit import Array
from friction_hil.training import thresholds as th

CONTRACTIONS = {"gated": 0.8, "narx": 4.0, "static": 1.0}  # with 0.98 errors at other sampling periods double


@dataclass(frozen=True, slots=True)
class Constraint:
    """Bound on the feedback weights of a network."""

    structure: NetworkStructure
    contraction: float = 0.8  # largest sum of slopes over the fed-back values

    @property
    def feedback(self) -> NDArray[np.intp]:
        """Indices of all feedback weights: in the first layer, and for a narx in its linear path."""
        begin, end = self.structure.feedback_weights
        indices = np.arange(begin, end)
        if self.structure.kind == "narx":
            indices = np.concatenate(
                [indices, np.arange(self.structure.weights - self.structure.states, self.structure.weights)]
            )
        return indices

    def feedback_gain(self, weights: Array) -> float:
        """Return the bound on the sum of slopes of any output over the fed-back values."""
        return self._gain(weights)[0]

    def _gain(self, w: Array) -> tuple[float, Array]:
        """Return the bound and its gradient over all weights."""
        structure, gradient = self.structure, np.zeros_like(w)
        if structure.states == 0:
            return 0.0, gradient
        width, units = structure.hidden[0], structure.hidden[-1]
        begin, end = structure.feedback_weights
        fed, middle = w[begin:end].reshape(structure.states, width), np.eye(width)
        if len(structure.hidden) == 2:
            first = end + units
            middle = w[first : first + width * units].reshape(width, units)
        outs = structure.outputs_begin + 1 + structure.output_weights * np.arange(max(structure.outputs - 1, 1))
        last = np.stack([w[index : index + units] for index in outs])
        (fed_up, fed_down), (middle_up, middle_down), (last_up, last_down) = map(_parts, (fed, middle, last))
        up = fed_up @ middle_up + fed_down @ middle_down  # from every fed-back value to every unit of the last layer
        down = fed_up @ middle_down + fed_down @ middle_up
        raised, lowered = last_up @ up.T + last_down @ down.T, last_up @ down.T + last_down @ up.T
        gains = np.maximum(raised, lowered).sum(axis=1)
        worst = int(np.argmax(gains))
        rises = (raised[worst] >= lowered[worst])[:, None]  # True where the raising sum is the larger one
        last_sign = last[worst] > 0.0
        gradient[outs[worst] : outs[worst] + units] = (
            np.where(last_sign, 1.0, -1.0) * np.where(rises == last_sign, up, down)
        ).sum(axis=0)
        over_up = np.where(rises, last_up[worst], last_down[worst])
        over_down = np.where(rises, last_down[worst], last_up[worst])
        over_fed_up = over_up @ middle_up.T + over_down @ middle_down.T
        over_fed_down = over_up @ middle_down.T + over_down @ middle_up.T
        gradient[begin:end] = np.where(fed > 0.0, over_fed_up, -over_fed_down).ravel()
        if len(structure.hidden) == 2:
            over_middle_up = fed_up.T @ over_up + fed_down.T @ over_down
            over_middle_down = fed_up.T @ over_down + fed_down.T @ over_up
            gradient[first : first + middle.size] = np.where(middle > 0.0, over_middle_up, -over_middle_down).ravel()
        gain = float(gains[worst])
        if structure.kind == "narx":
            linear = w[structure.weights - structure.states :]
            gradient[structure.weights - structure.states :] = np.sign(linear)
            gain += float(np.abs(linear).sum())
        return gain, gradient

    def apply(self, w: Array) -> tuple[Array, Array]:
        """Return the constrained weights, and the difference of their Jacobian over ``w`` from the identity.

        The difference has the rows of the feedback weights only, (feedback weights, weights); all others are zero.
        """
        weights, indices = w.copy(), self.feedback
        change = np.zeros((indices.size, w.size))
        if self.structure.states:
            gain, gradient = self._gain(w)
            excess = (gain / self.contraction) ** th.SHARPNESS
            scale = (1.0 + excess) ** (-1.0 / th.SHARPNESS)
            weights[indices] = scale * w[indices]
            if gain > 0.0:
                change -= np.outer(w[indices], scale * excess / (1.0 + excess) / gain * gradient)
            change[np.arange(indices.size), indices] += scale - 1.0
        return weights, change


def _parts(values: Array) -> tuple[Array, Array]:
    """Return the positive and the negated negative parts of values."""
    return np.maximum(values, 0.0), np.maximum(-values, 0.0)
