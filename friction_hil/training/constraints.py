"""From the numbers that are searched for to the weights of a network that is stable by design.

The slopes of a network's aims over what is fed back sum to less than a bound in absolute value, whatever the inputs.
As the slope of tanh is between 0 and 1, what raises an aim and what lowers it, on all ways from feedback to output, do
so each by their weights at most; the larger of both sums bounds the slope. Feedback weights beyond the bound are
shrunk together, smoothly.

A bound below 1 makes a gated network a contraction: it forgets how it began, as far as it moves. A narx needs slopes
near 1 in order to hold its torque at rest and small ones in motion, which no bound on weights can tell apart. It is
bounded by the cut-off of its output, and `checks` looks at how it rests.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from friction_hil.friction import NetworkStructure
from friction_hil.numerics.jit import Array

CONTRACTIONS = {"gated": 0.8, "narx": 4.0, "static": 1.0}  # 0.98 is half as good for other sampling periods
_SHARPNESS = 4.0  # of the bend where feedback comes to its bound: the larger, the less it is felt below


@dataclass(frozen=True, slots=True)
class Constraint:
    """Bounds on the weights of a network of a structure.

    Attributes
    ----------
    structure : NetworkStructure
    contraction : float
        Largest sum of slopes over what is fed back.
    """

    structure: NetworkStructure
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
        width, units = structure.hidden[0], structure.hidden[-1]
        begin, end = structure.feedback_weights
        fed, middle = w[begin:end].reshape(structure.states, width), np.eye(width)
        if len(structure.hidden) == 2:
            first = end + units
            middle = w[first : first + width * units].reshape(width, units)
        outs = structure.outputs_begin + 1 + structure.output_weights * np.arange(max(structure.outputs - 1, 1))
        last = np.stack([w[place : place + units] for place in outs])
        (fed_up, fed_down), (middle_up, middle_down), (last_up, last_down) = map(_parts, (fed, middle, last))
        up = fed_up @ middle_up + fed_down @ middle_down  # of every feedback, to every unit of the last layer
        down = fed_up @ middle_down + fed_down @ middle_up
        raised, lowered = last_up @ up.T + last_down @ down.T, last_up @ down.T + last_down @ up.T
        gains = np.maximum(raised, lowered).sum(axis=1)
        worst = int(np.argmax(gains))
        rises = (raised[worst] >= lowered[worst])[:, None]  # where the larger sum of a feedback is the raising one
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
        """Return the weights of the network, and by how much their slopes over ``w`` differ from the identity.

        The slopes are those of the weights of what is fed back, (feedback weights, weights); the others do not differ.
        """
        weights, places = w.copy(), self.feedback
        change = np.zeros((places.size, w.size))
        if self.structure.states:
            gain, gradient = self._gain(w)
            excess = (gain / self.contraction) ** _SHARPNESS
            scale = (1.0 + excess) ** (-1.0 / _SHARPNESS)
            weights[places] = scale * w[places]
            if gain > 0.0:
                change -= np.outer(w[places], scale * excess / (1.0 + excess) / gain * gradient)
            change[np.arange(places.size), places] += scale - 1.0
        return weights, change


def _parts(values: Array) -> tuple[Array, Array]:
    """Values where they are above zero, and less than zero with the sign turned; zeros elsewhere."""
    return np.maximum(values, 0.0), np.maximum(-values, 0.0)
