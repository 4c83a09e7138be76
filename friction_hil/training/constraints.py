"""From the numbers that are searched for to the weights of a network that is stable by design.

The slopes of a network's aims over what is fed back sum to less than a bound in absolute value, whatever the inputs.
As the slope of tanh is at most 1, the absolute weights on the way from feedback to output bound that sum. Feedback
weights beyond the bound are shrunk together, smoothly.

A bound below 1 makes a gated network a contraction: it forgets how it began, as far as it moves. A narx needs slopes
near 1 in order to hold its torque at rest and small ones in motion, which no bound on weights can tell apart. It is
bounded by the cut-off of its output, and `checks` looks at how it rests.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from friction_hil.jit import Array
from friction_hil.models import Structure

CONTRACTIONS = {"gated": 0.8, "narx": 4.0, "static": 1.0}  # 0.98 is half as good for other sampling periods
_SHARPNESS = 4.0  # of the bend where feedback comes to its bound: the larger, the less it is felt below


@dataclass(frozen=True, slots=True)
class Constraint:
    """Bounds on the weights of a network of a structure.

    Attributes
    ----------
    structure : Structure
    contraction : float
        Largest sum of slopes over what is fed back.
    """

    structure: Structure
    contraction: float = 0.8

    @property
    def feedback(self) -> NDArray[np.intp]:
        """Places of all weights of what is fed back: in the first layer, and of a narx in its linear path."""
        begin, end = self.structure.feedback_weights
        places = np.arange(begin, end)
        if self.structure.kind == "narx":
            places = np.concatenate(
                [places, np.arange(self.structure.weights - self.structure.states, self.structure.weights)]
            )
        return places

    def feedback_gain(self, weights: Array) -> float:
        """Bound on the sum of slopes of any output over what is fed back."""
        return self._gain(weights)[0]

    def _gain(self, w: Array) -> tuple[float, Array]:
        """Bound and its gradient over all weights."""
        structure, gradient = self.structure, np.zeros_like(w)
        if structure.states == 0:
            return 0.0, gradient
        width = structure.hidden[0]
        begin, end = structure.feedback_weights
        fed = w[begin:end].reshape(structure.states, width)
        into = np.abs(fed).sum(axis=0)
        middle = np.eye(width)
        if len(structure.hidden) == 2:
            first = end + structure.hidden[1]
            middle = w[first : first + width * structure.hidden[1]].reshape(width, structure.hidden[1])
        onward = into @ np.abs(middle)
        outs = structure.outputs_begin + 1 + structure.output_weights * np.arange(max(structure.outputs - 1, 1))
        last = np.stack([w[place : place + structure.hidden[-1]] for place in outs])
        gains = np.abs(last) @ onward
        worst = int(np.argmax(gains))
        out = np.abs(last[worst])
        gradient[outs[worst] : outs[worst] + structure.hidden[-1]] = onward * np.sign(last[worst])
        gradient[begin:end] = (np.abs(middle) @ out * np.sign(fed)).ravel()
        if len(structure.hidden) == 2:
            gradient[first : first + middle.size] = (np.outer(into, out) * np.sign(middle)).ravel()
        gain = float(gains[worst])
        if structure.kind == "narx":
            linear = w[structure.weights - structure.states :]
            gradient[structure.weights - structure.states :] = np.sign(linear)
            gain += float(np.abs(linear).sum())
        return gain, gradient

    def apply(self, w: Array) -> tuple[Array, Array]:
        """Return the weights of the network, and their derivative over ``w`` (weights, weights)."""
        weights, slopes = w.copy(), np.eye(w.size)
        if self.structure.states:
            places = self.feedback
            gain, gradient = self._gain(w)
            excess = (gain / self.contraction) ** _SHARPNESS
            scale = (1.0 + excess) ** (-1.0 / _SHARPNESS)
            weights[places] = scale * w[places]
            slopes[places, places] = scale
            if gain > 0.0:
                slopes[places] -= np.outer(w[places], scale * excess / (1.0 + excess) / gain * gradient)
        return weights, slopes
