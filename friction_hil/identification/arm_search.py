"""The least squares of all joints of an arm together; see `friction_hil.identification.arm_fit`. Pure."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from friction_hil.dynamics import Arm
from friction_hil.dynamics.newton_euler import PARAMETERS
from friction_hil.identification import thresholds as th
from friction_hil.identification.inference import correlated_lags, correlated_square
from friction_hil.numerics.jit import Array

FRICTION = ("coulomb", "viscous", "offset", "load")


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """Rows of the regression, in which not every joint slides."""

    velocity: Array  # (k, n)
    acceleration: Array
    position: Array
    torque: Array
    regressor: Array  # (k, n, 10 n)
    slides: NDArray[np.bool_]  # (k, n)
    part: NDArray[np.intp]  # (k,) number of the stretch without a gap
    repeated: float  # rows among which white noise is one and the same behind the low-pass

    def at(self, rows: NDArray[np.bool_]) -> "Rows":
        """Return some of the rows."""
        return Rows(
            self.velocity[rows],
            self.acceleration[rows],
            self.position[rows],
            self.torque[rows],
            self.regressor[rows],
            self.slides[rows],
            self.part[rows],
            self.repeated,
        )


class Search:
    """The least squares of all joints together."""

    def __init__(self, rows: Rows, arm: Arm, used: Mapping[str, Sequence[bool]]) -> None:
        self.rows, self.arm, self.used, self.n = rows, arm, used, len(arm)
        self.wide = PARAMETERS * self.n
        self.prior, self.spread = arm.parameters.ravel(), prior_spread(arm)
        self.rotor = arm.armatures
        self.rotor_spread = np.where(self.rotor > 0.0, th.ARM_PRIOR * self.rotor, math.inf)
        self.count = self.wide + 5 * self.n  # rotor, and those of `FRICTION`, of each joint
        own = [np.array(used[name]) for name in ("rotor", *FRICTION)]
        self.is_free = np.concatenate([np.ones(self.wide, bool), *own])
        self.values = np.concatenate([self.prior, np.where(own[0], self.rotor, 0.0), np.zeros(4 * self.n)])
        spread = [rows.torque[rows.slides[:, k], k] for k in range(self.n)]
        self.noise = np.maximum([float(np.std(each)) if len(each) else 1.0 for each in spread], 1e-9)
        self.deviation = self.noise.copy()

    def place(self, name: str, joint: int) -> int:
        """Return the place of a parameter of a joint."""
        return self.wide + self.n * (1 + FRICTION.index(name)) + joint if name != "rotor" else self.wide + joint

    def rigid(self, rows: Rows) -> Array:
        """Return the torques of the rigid links (k, n)."""
        torques: Array = rows.regressor @ self.values[: self.wide]
        return torques

    def jacobian(self, rows: Rows, joint: int, load: Array) -> Array:
        """Return the change of a joint's torque with all parameters, in the rows in which it slides."""
        use = rows.slides[:, joint]
        s, v = np.sign(rows.velocity[use, joint]), rows.velocity[use, joint]
        matrix = np.zeros((len(s), self.count))
        factor = self.values[self.place("load", joint)]
        matrix[:, : self.wide] = rows.regressor[use, joint] * (1.0 + factor * np.sign(load) * s)[:, None]
        matrix[:, self.place("rotor", joint)] = rows.acceleration[use, joint]
        for name, column in (("coulomb", s), ("viscous", v), ("offset", np.ones(len(s))), ("load", np.abs(load) * s)):
            matrix[:, self.place(name, joint)] = column
        return matrix

    def torque(self, rows: Rows, joint: int) -> Array:
        """Return the torque of a joint in the rows in which it slides."""
        use = rows.slides[:, joint]
        load = rows.regressor[use, joint] @ self.values[: self.wide]
        s, v = np.sign(rows.velocity[use, joint]), rows.velocity[use, joint]
        a = rows.acceleration[use, joint]
        coulomb, viscous, offset, factor = (self.values[self.place(name, joint)] for name in FRICTION)
        total: Array = load + self.values[self.place("rotor", joint)] * a
        total += coulomb * s + viscous * v + offset + factor * np.abs(load) * s
        return total

    def index(self, place: int) -> int:
        """Return where a free parameter stands among the free ones."""
        return int(np.count_nonzero(self.is_free[:place]))

    def run(self, steps: int = th.ARM_SEARCH_STEPS) -> None:
        """Search for the most likely parameters."""
        for _ in range(steps):
            step, change = self._step()
            self.values[self.is_free] += step
            if change < th.ARM_NEAR:
                break

    def _step(self) -> tuple[Array, float]:
        free = self.is_free
        normal, right = self._prior_terms()
        pieces = []
        for k in range(self.n):
            use = self.rows.slides[:, k]
            if not use.any():
                continue
            load = self.rows.regressor[use, k] @ self.values[: self.wide]
            residual = self.rows.torque[use, k] - self.torque(self.rows, k)
            self._weigh(k, residual, use)
            matrix = self.jacobian(self.rows, k, load)[:, free]
            weight = np.sqrt(self._huber(residual, k)) / self.noise[k]
            matrix *= weight[:, None]
            normal += matrix.T @ matrix
            right += matrix.T @ (weight * residual)
            pieces.append(matrix)
        step = solved(normal, right)
        change = math.sqrt(sum(float(np.sum((each @ step) ** 2)) for each in pieces) / max(sum(map(len, pieces)), 1))
        return step, change

    def _prior_terms(self) -> tuple[Array, Array]:
        """Return the part of the normal equations that the file's values make."""
        weight, off = np.zeros(self.count), np.zeros(self.count)
        end = self.wide + self.n
        weight[:end] = 1.0 / np.concatenate([self.spread, self.rotor_spread]) ** 2
        off[:end] = np.concatenate([self.prior, self.rotor]) - self.values[:end]
        return np.diag(weight[self.is_free]), (weight * off)[self.is_free]

    def _weigh(self, joint: int, residual: Array, use: NDArray[np.bool_]) -> None:
        """Set the noise of a joint as it counts for correlated rows."""
        deviation = 1.4826 * float(np.median(np.abs(residual - np.median(residual))))
        self.deviation[joint] = max(deviation, 1e-12)
        lags = correlated_lags(residual, [slice(0, len(residual))])
        # each joint's residual is short of its share of the parameters, as many rows as the low-pass makes of each one
        left = max(len(residual) - self.rows.repeated * np.count_nonzero(self.is_free) / self.n, 1.0)
        square = max(correlated_square(residual, lags), self.rows.repeated * float(residual @ residual))
        self.noise[joint] = max(math.sqrt(square / left), 1e-9)

    def _huber(self, residual: Array, joint: int) -> Array:
        far = th.ARM_HUBER * self.deviation[joint]
        weights: Array = np.minimum(1.0, far / np.maximum(np.abs(residual), 1e-300))
        return weights

    def covariance(self) -> tuple[Array, Array]:
        """Return the covariance of the free parameters, and the information that the log has of them."""
        information, scores = np.zeros((self.is_free.sum(),) * 2), []
        lags = 1
        for k in range(self.n):
            use = self.rows.slides[:, k]
            score = np.zeros((len(use), int(self.is_free.sum())))
            if use.any():
                load = self.rows.regressor[use, k] @ self.values[: self.wide]
                residual = self.rows.torque[use, k] - self.torque(self.rows, k)
                weights = self._huber(residual, k)
                matrix = self.jacobian(self.rows, k, load)[:, self.is_free] / self.noise[k]
                information += (matrix * weights[:, None]).T @ matrix
                score[use] = matrix * (weights * residual / self.noise[k])[:, None]
                lags = max(lags, correlated_lags(residual, [slice(0, len(residual))]))
            scores.append(score)
        total = np.sum(scores, axis=0)
        middle, prior = np.zeros_like(information), self._prior_terms()[0]
        for number in np.unique(self.rows.part):
            # Bartlett's weights are those of the sums over a window that slides over all rows
            padded = np.pad(total[self.rows.part == number], ((lags + 1, lags), (0, 0)))
            sums = np.cumsum(padded, axis=0)
            windows = sums[lags + 1 :] - sums[: -lags - 1]
            middle += windows.T @ windows / (lags + 1.0)
        inverse = solved(information + prior, np.eye(len(information)))
        found = inverse @ (middle + prior) @ inverse
        # few stretches of correlated rows make it too small; the noise of the rows is a bound
        factor = np.sqrt(np.maximum(np.diag(inverse) / np.maximum(np.diag(found), 1e-300), 1.0))
        return found * np.outer(factor, factor), information


def solved(matrix: Array, right: Array) -> Array:
    """Solve symmetric equations whose unknowns have different units; what is not determined stays 0."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    values, vectors = np.linalg.eigh(matrix * np.outer(scale, scale))
    inverse = np.where(values > 1e-12 * values[-1], 1.0 / np.maximum(values, 1e-300), 0.0)
    scaled = (right.T * scale).T
    solved: Array = ((vectors * inverse) @ (vectors.T @ scaled)).T * scale
    return solved.T


def prior_spread(arm: Arm) -> Array:
    """Return how far the inertial parameters of a file may be off (10 n,), one standard deviation.

    A part of the mass; of first moments and inertias the same part of the mass times the link's extent and its square.
    """
    spread = []
    for mass, *rest in arm.parameters:
        trace = 0.5 * float(rest[3] + rest[6] + rest[8])
        extent = math.sqrt(max(trace / mass, 1e-6)) if mass > 0.0 else 0.1
        size = max(mass, 1e-3)
        spread += [size, *[size * extent] * 3, *[size * extent**2] * 6]
    return th.ARM_PRIOR * np.array(spread)
