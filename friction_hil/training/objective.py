"""Error of a network over samples, as a function of the numbers that are searched for, and its derivative."""

import math

import numpy as np

from friction_hil.friction import network
from friction_hil.numerics.jit import Array
from friction_hil.training import jacobian
from friction_hil.training.constraints import Constraint
from friction_hil.training.layout import Samples
from friction_hil.training.normal import room


class Record:
    """Samples as a network of one structure and one set of scales sees them, and its runs over them.

    Parameters
    ----------
    p : array
        Network; its header counts, its weights do not.
    samples : Samples
        At the period that the network is trained at.
    """

    def __init__(self, p: Array, samples: Samples) -> None:
        self.samples = samples
        self.inputs = np.empty((len(samples), int(p[network.INPUTS])))
        others = (samples.position, samples.load_torque, samples.temperature)
        jacobian.fill_inputs(p, samples.starts, samples.velocity, samples.dt, *others, self.inputs)
        self.gate_features = (
            jacobian.gate_features(p, samples.starts, samples.velocity, samples.dt, self.inputs)
            if p[network.STRUCTURE] == network.GATED
            else np.empty((0, 0))
        )
        self.path = np.abs(samples.velocity) * samples.dt
        self.target = samples.torque / p[network.TORQUE_SCALE]
        self.weight = samples.weight / np.sum(samples.weight)
        mean = float(self.weight @ self.target)
        self._spread = math.sqrt(float(self.weight @ (self.target - mean) ** 2)) or 1.0
        self.trace = np.empty((len(samples), jacobian.trace_width(p)))

    def run(self, p: Array, is_free: bool) -> float:
        """Run the network; return the weighted mean of its squared error, in units of the torque scale squared."""
        motion = (self.samples.starts, self.inputs, self.gate_features, self.path)
        jacobian.run(p, *motion, self.target, is_free, self.trace)
        return jacobian.squared_error(self.trace, self.target, self.weight)

    def error(self, p: Array, is_free: bool) -> float:
        """NRMSE: root of the mean squared error over the standard deviation of the target."""
        return math.sqrt(self.run(p, is_free)) / self._spread

    def normal_equations(self, p: Array, is_free: bool, matrix: Array) -> None:
        """Fill ``matrix`` as `jacobian.normal_equations` does, for the last `run`."""
        weights = p.size - network.HEADER
        record = (self.samples.starts, self.inputs, self.gate_features, self.path, self.trace)
        jacobian.normal_equations(p, *record, is_free, self.target, self.weight, weights, matrix)


class Objective:
    """Mean squared error with weight decay, for `levenberg.minimise`.

    Attributes
    ----------
    p : array
        Network with the weights of the last `cost`.
    """

    def __init__(self, p: Array, record: Record, constraint: Constraint, decay: float, is_free: bool) -> None:
        self.p = p.copy()
        self._record, self._constraint = record, constraint
        self._decay, self._is_free = decay, is_free
        self._weights = p.size - network.HEADER
        self._matrix = np.zeros((room(self._weights + 1),) * 2)
        self._searched, self._change = np.zeros(0), np.zeros((0, 0))

    def network_at(self, searched: Array) -> Array:
        """Parameter array of the network that the searched numbers mean."""
        p = self.p.copy()
        p[network.HEADER :] = self._constraint.apply(searched)[0]
        return p

    def cost(self, searched: Array) -> float:
        """Mean squared error plus decay times the squared length of ``searched``."""
        self._searched = searched
        self.p[network.HEADER :], self._change = self._constraint.apply(searched)
        return self._record.run(self.p, self._is_free) + self._decay * float(searched @ searched)

    def linear(self) -> tuple[Array, Array]:
        """Gauss-Newton matrix and half the gradient of the last `cost`."""
        self._record.normal_equations(self.p, self._is_free, self._matrix)
        lower = np.tril(self._matrix[: self._weights, : self._weights])
        matrix = lower + np.tril(lower, -1).T
        gradient = self._matrix[self._weights, : self._weights]
        places, change = self._constraint.feedback, self._change
        turned = matrix[:, places] @ change  # too small for a BLAS to wake a second thread, which takes far longer
        over_searched = matrix + turned + turned.T + change.T @ (matrix[np.ix_(places, places)] @ change)
        over_searched[np.diag_indices_from(matrix)] += self._decay
        return over_searched, gradient + change.T @ gradient[places] + self._decay * self._searched
