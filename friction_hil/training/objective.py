"""Error of a network over samples, as a function of the searched weights, and its derivative."""

import math

import numpy as np

from friction_hil.friction import network
from friction_hil.numerics.jit import Array
from friction_hil.training import jacobian
from friction_hil.training.constraints import Constraint
from friction_hil.training.layout import Samples
from friction_hil.training.normal import padded


class NetworkRun:
    """Runs of networks with one header (structure and scales) over the same samples.

    ``p``: the header is used, the weights are not. ``samples``: at the period at which the network is trained.
    """

    def __init__(self, p: Array, samples: Samples) -> None:
        self.samples = samples
        self.inputs = np.empty((len(samples), int(p[network.INPUTS])))  # of the network, see `jacobian`
        others = (samples.position, samples.load_torque, samples.temperature)
        jacobian.fill_inputs(p, samples.starts, samples.velocity, samples.dt, *others, self.inputs)
        # inputs of the gates, see `jacobian`
        self.gate_features = (
            jacobian.gate_features(p, samples.starts, samples.velocity, samples.dt, self.inputs)
            if p[network.STRUCTURE] == network.GATED
            else np.empty((0, 0))
        )
        self.path = np.abs(samples.velocity) * samples.dt  # (n,), distance travelled in each sample, rad
        self.target = samples.torque / p[network.TORQUE_SCALE]  # (n,), torque in units of the torque scale
        self.weight = samples.weight / np.sum(samples.weight)  # (n,), the sum is 1
        mean = float(self.weight @ self.target)
        self._spread = math.sqrt(float(self.weight @ (self.target - mean) ** 2)) or 1.0
        self.trace = np.empty((len(samples), jacobian.trace_width(p)))  # (n, trace_width), of the last `simulate`

    def simulate(self, p: Array, is_free: bool) -> float:
        """Run a network; return the weighted mean of its squared error, in units of the torque scale squared."""
        motion = (self.samples.starts, self.inputs, self.gate_features, self.path)
        jacobian.run(p, *motion, self.target, is_free, self.trace)
        return jacobian.squared_error(self.trace, self.target, self.weight)

    def error(self, p: Array, is_free: bool) -> float:
        """Return the NRMSE: root mean squared error over the standard deviation of the target."""
        return math.sqrt(self.simulate(p, is_free)) / self._spread

    def normal_equations(self, p: Array, is_free: bool, matrix: Array) -> None:
        """Fill ``matrix`` as `jacobian.normal_equations` does, for the last `simulate`."""
        weights = p.size - network.HEADER
        record = (self.samples.starts, self.inputs, self.gate_features, self.path, self.trace)
        jacobian.normal_equations(p, *record, is_free, self.target, self.weight, weights, matrix)


class Objective:
    """Mean squared error with weight decay, for `levenberg.minimise_unbounded`."""

    def __init__(self, p: Array, run: NetworkRun, constraint: Constraint, decay: float, is_free: bool) -> None:
        self.p = p.copy()  # network with the weights of the last `cost`
        self._run, self._constraint = run, constraint
        self._decay, self._is_free = decay, is_free
        self._weights = p.size - network.HEADER
        self._matrix = np.zeros((padded(self._weights + 1),) * 2)
        self._searched, self._change = np.zeros(0), np.zeros((0, 0))

    def network_at(self, searched: Array) -> Array:
        """Return the parameter array of the network with these searched weights."""
        p = self.p.copy()
        p[network.HEADER :] = self._constraint.apply(searched)[0]
        return p

    def cost(self, searched: Array) -> float:
        """Return the mean squared error plus decay times the squared norm of ``searched``."""
        self._searched = searched
        self.p[network.HEADER :], self._change = self._constraint.apply(searched)
        return self._run.simulate(self.p, self._is_free) + self._decay * float(searched @ searched)

    def normal_equations(self) -> tuple[Array, Array]:
        """Return the Gauss-Newton matrix and half the gradient of the last `cost`."""
        self._run.normal_equations(self.p, self._is_free, self._matrix)
        lower = np.tril(self._matrix[: self._weights, : self._weights])
        matrix = lower + np.tril(lower, -1).T
        gradient = self._matrix[self._weights, : self._weights]
        fed_back, change = self._constraint.feedback, self._change
        turned = matrix[:, fed_back] @ change  # small enough for a BLAS to stay on one thread: two take far longer
        over_searched = matrix + turned + turned.T + change.T @ (matrix[np.ix_(fed_back, fed_back)] @ change)
        over_searched[np.diag_indices_from(matrix)] += self._decay
        return over_searched, gradient + change.T @ gradient[fed_back] + self._decay * self._searched
