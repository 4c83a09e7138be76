"""One structure against data: residual and Jacobian, the linear parameters projected out.

Variable projection: what the torque is linear in has columns that do not change, so that searching for the rest
in the complement of their span finds all parameters at once. Source: G. Golub, V. Pereyra, SIAM Journal on
Numerical Analysis 10(2), 1973.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from friction_hil.errors import UsageError
from friction_hil.identification.data import Data, Mask
from friction_hil.identification.least_squares import Solution, minimise, project_out
from friction_hil.identification.structures import Structure
from friction_hil.numerics.jit import Array

# Linear parameters that stay at or above zero: what would drive the axis is no friction, and a torque that bends
# down with the speed (which power_law can) must not turn around beyond the speeds that were seen.
_POSITIVE = ("inertia", "viscous", "sigma2", "quadratic", "back_emf")
# Of a drive whose torque is a signal times an unknown gain: see `friction_hil.identification.drive`.
GAIN, INVERSE_GAIN, BACK_EMF = "drive.gain", "drive.inverse_gain", "drive.back_emf"
_LONGEST_STEP = 2.0  # of a logarithm: a factor of seven
_REMEMBERED = 6  # evaluations
_RANK = 1e-9  # of a column's norm: what is left of one that the columns before it make up
_COLLINEAR = 1e-7  # likewise, of a derivative
_REFIT_DAMPING = 0.1  # of columns of length 1
_ROUNDS = 4  # of reweighting
_NORMAL_MAD = 1.4826  # standard deviation of a normal distribution over its median absolute deviation
ROBUST_DEVIATIONS = 3.0  # beyond which a residual counts less


@dataclass(frozen=True, slots=True)
class Estimate:
    """Parameters of a structure and of the mechanics, and what they leave.

    Attributes
    ----------
    values : dict
        All parameters that were found, by name: of friction, and ``inertia``, ``offset``, ``gravity.sine`` ...
    coordinates : (m,) array
        Those that were searched for, as the search sees them.
    at_bound : tuple of str
        Parameters that ended at a bound.
    dependent : tuple of str
        Linear parameters left out because the others make up their columns.
    residual : (k,) array
        Measured minus predicted torque.
    jacobian : (k, p) array
        Derivative of the predicted torque with respect to each parameter of ``names``.
    names : tuple of str
        Parameters that are free: not held, at a bound or dependent.
    weights : (k,) array
        Of the robust loss; ones without it.
    is_converged : bool
    """

    values: dict[str, float]
    coordinates: Array
    at_bound: tuple[str, ...]
    dependent: tuple[str, ...]
    residual: Array
    jacobian: Array
    names: tuple[str, ...]
    weights: Array
    is_converged: bool

    @property
    def rmse(self) -> float:
        """Root mean square of the residual, N m or N."""
        return float(np.sqrt(np.mean(self.residual**2)))


class Problem:
    """A structure, the linear parameters of the mechanics, and data.

    Parameters
    ----------
    data : Data
    structure : Structure
    mechanics : sequence of str
        Linear parameters of the mechanics that are looked for.
    held : mapping
        Those that are held, by name.
    loads : sequence of (n,) arrays, optional
        Load torque of each record, for a structure that depends on it.
    """

    def __init__(
        self,
        data: Data,
        structure: Structure,
        mechanics: Sequence[str],
        held: Mapping[str, float] | None = None,
        loads: Sequence[Array] | None = None,
    ) -> None:
        self.data, self.structure, self.loads = data, structure, loads
        self.held = dict(held or {})
        self.keys = {**{name: name for name in mechanics if name not in self.held}, **structure.linear}
        self.lower, self.upper = (
            np.array([each.bounds[i] for each in structure.coordinates], dtype=float) for i in (0, 1)
        )
        self.longest = np.array(
            [_LONGEST_STEP if each.is_log else math.inf for each in structure.coordinates], dtype=float
        )
        self._known: dict[bytes, tuple[Array, Array]] = {}
        self._rooms: list[tuple[Array, Array]] | None = None  # for torque and gradient at the full rate
        self._given = np.zeros(len(data))
        for name, value in self.held.items():
            self._given += value * data.column(name)

    def friction(self, coordinates: Array) -> tuple[Array, Array]:
        """`_friction`, remembered for the last few coordinates: folds of a cross-validation begin at the same ones."""
        key = coordinates.tobytes()
        known = self._known.pop(key, None)
        self._known[key] = self._friction(coordinates) if known is None else known
        if len(self._known) > _REMEMBERED:
            del self._known[next(iter(self._known))]
        return self._known[key]

    def _friction(self, coordinates: Array) -> tuple[Array, Array]:
        """Torque (k,) of friction without its linear part, and its derivatives (k, m); NaN where there is no model."""
        structure, records = self.structure, self.data.records
        try:
            model = structure.model(structure.values(coordinates))
        except UsageError:
            return np.full(len(self.data), math.nan), np.zeros((len(self.data), len(coordinates)))
        # gamma in a logarithm and the like: derivative of each parameter with respect to its coordinate
        slopes = [
            each.outer(float(x)) if each.is_log else 1.0
            for each, x in zip(structure.coordinates, coordinates, strict=True)
        ]
        directions = [dict.fromkeys(each.names, x) for each, x in zip(structure.coordinates, slopes, strict=True)]
        if self._rooms is None:
            self._rooms = [
                (np.empty(record.velocity.size), np.empty((record.velocity.size, len(directions))))
                for record in records
            ]
        for number, record in enumerate(records):
            model.simulate_with_gradient(
                record.velocity,
                record.dt,
                free=directions,
                position=record.position,
                load_torque=None if self.loads is None else self.loads[number],
                temperature=record.temperature,
                out=self._rooms[number],
            )
        torques, gradients = zip(*self._rooms, strict=True)
        return self.data.stack(torques), self.data.stack(gradients)

    def search(
        self,
        start: Array,
        *,
        evaluations: int = 60,
        rows: Mask | None = None,
        weights: Array | None = None,
        pinned: Sequence[str] = (),
        tolerance: float = 1e-6,
    ) -> Solution:
        """Search from ``start`` with the linear parameters projected out, on some rows (mask) alone if wanted."""
        basis = self._basis(rows, weights, pinned)[1]
        target = self.data.torque - self._given

        def residual(at: Array) -> tuple[Array, Array]:
            torque, gradient = self.friction(at)
            both = _rows(np.column_stack([target - torque, -gradient]), rows, weights)
            before = np.linalg.norm(both, axis=0)
            project_out(basis, both)
            # what the linear parameters can make up as well is rounding, and no direction to search in
            is_made_up = np.linalg.norm(both, axis=0) <= _COLLINEAR * before
            both[:, 1:][:, is_made_up[1:]] = 0.0
            return np.ascontiguousarray(both[:, 0]), np.ascontiguousarray(both[:, 1:])

        return minimise(
            residual,
            start,
            self.lower,
            self.upper,
            evaluations=evaluations,
            tolerance=tolerance,
            longest=self.longest,
        )

    def refit(
        self, at: Array, *, rows: Mask, weights: Array | None = None, pinned: Sequence[str] = (), evaluations: int = 4
    ) -> tuple[Array, Array]:
        """Coordinates that fit some rows (mask), found from those that fit all, and their friction torque (k,).

        One Gauss-Newton step, whose gradient is known already, does where the sum of squares falls by most of what
        it promises; else one that is damped, since what the data hardly determine leads the step far away; a search
        where neither does.
        """
        torque, gradient = self.friction(at)
        if not len(at):
            return at, torque
        basis = self._basis(rows, weights, pinned)[1]
        target = self.data.torque - self._given
        both = _rows(np.column_stack([target - torque, -gradient]), rows, weights)
        project_out(basis, both)
        cost = float(np.sum(both[:, 0] ** 2))
        norms = np.linalg.norm(both[:, 1:], axis=0)
        is_free = (norms > _COLLINEAR * np.linalg.norm(gradient, axis=0)) & (at > self.lower) & (at < self.upper)
        columns = both[:, 1:][:, is_free] / norms[is_free]
        normal, slope = columns.T @ columns, columns.T @ both[:, 0]
        for damping in (0.0, _REFIT_DAMPING):
            step = np.zeros(len(at))
            damped = normal + damping * np.eye(len(slope))
            step[is_free] = np.linalg.lstsq(damped, -slope, rcond=1e-10)[0] / norms[is_free]
            trial = np.clip(at + np.clip(step, -self.longest, self.longest), self.lower, self.upper)
            try:
                torque = self.friction_torque(trial)
            except UsageError:
                continue
            after = _rows((target - torque)[:, None], rows, weights)
            project_out(basis, after)
            promised = cost - float(np.sum((both[:, 0] + both[:, 1:] @ (trial - at)) ** 2))
            if cost - float(np.sum(after**2)) >= 0.5 * promised >= 0.0:  # below zero where a bound has bent the step
                return trial, torque
        at = self.search(at, evaluations=evaluations, rows=rows, weights=weights, pinned=pinned, tolerance=1e-4).at
        return at, self.friction(at)[0]

    def _basis(self, rows: Mask | None, weights: Array | None, pinned: Sequence[str]) -> tuple[list[str], Array]:
        """Names of the linear parameters whose columns are independent, and an orthonormal basis of their span."""
        names: list[str] = []
        basis = np.empty((len(self.data) if rows is None else int(np.sum(rows)), 0))
        for name, key in self.keys.items():
            if name in pinned:
                continue
            column = _rows(self.data.column(key), rows, weights)
            norm = float(np.linalg.norm(column))
            rest = column
            for _ in range(2):  # twice is enough (Kahan)
                rest = rest - basis @ (basis.T @ rest)
            left = float(np.linalg.norm(rest))
            if left > _RANK * norm > 0.0:
                names.append(name)
                basis = np.column_stack([basis, rest / left])
        return names, basis

    def linear(
        self,
        torque: Array,
        *,
        rows: Mask | None = None,
        weights: Array | None = None,
        pinned: Sequence[str] = (),
    ) -> dict[str, float]:
        """Linear parameters that go best with the friction ``torque`` (k,) of the rest; 0 where there are none."""
        names, _ = self._basis(rows, weights, pinned)
        values = dict.fromkeys(self.keys, 0.0)
        if names:
            matrix = np.column_stack([self.data.column(self.keys[name]) for name in names])
            norms = np.linalg.norm(matrix, axis=0)
            target = _rows(self.data.torque - self._given - torque, rows, weights)
            found = np.linalg.lstsq(_rows(matrix / norms, rows, weights), target, rcond=None)[0] / norms
            values.update(zip(names, map(float, found), strict=True))
        return values

    def predict(self, coordinates: Array, linear: Mapping[str, float], friction: Array | None = None) -> Array:
        """Predicted torque (k,); ``friction`` is that of `friction_torque` where it is known already."""
        torque = self._given + (self.friction_torque(coordinates) if friction is None else friction)
        for name, value in linear.items():
            torque = torque + value * self.data.column(self.keys[name])
        return torque

    def friction_torque(self, coordinates: Array) -> Array:
        """`friction` without derivatives."""
        model = self.structure.model(self.structure.values(coordinates))
        torques = [
            model.simulate(
                record.velocity,
                record.dt,
                position=record.position,
                load_torque=None if self.loads is None else self.loads[number],
                temperature=record.temperature,
            )
            for number, record in enumerate(self.data.records)
        ]
        return self.data.stack(torques)

    def jacobian(self, at: Array, names: Sequence[str]) -> Array:
        """Derivative (k, p) of the predicted torque with respect to parameters by name, linear ones among them."""
        gradient = self.friction(at)[1]
        places = {each.name: i for i, each in enumerate(self.structure.coordinates)}
        columns = []
        for name in names:
            if name in self.keys:
                columns.append(self.data.column(self.keys[name]))
                continue
            each, i = self.structure.coordinates[places[name]], places[name]
            columns.append(gradient[:, i] / (each.outer(float(at[i])) if each.is_log else 1.0))
        return np.column_stack(columns) if columns else np.empty((len(self.data), 0))

    def estimate(
        self, start: Array, *, is_robust: bool = False, evaluations: int = 60, weights: Array | None = None
    ) -> Estimate:
        """Find all parameters from one start; robust: residuals beyond three robust deviations count less.

        ``weights`` (k,) are those of the rows to begin with.
        """
        pinned: list[str] = []
        at = start
        for _ in range(_ROUNDS if is_robust else 1):
            while True:
                solution = self.search(at, evaluations=evaluations, weights=weights, pinned=pinned)
                at = solution.at
                torque, _ = self.friction(at)
                linear = self.linear(torque, weights=weights, pinned=pinned)
                wrong = [name for name, value in linear.items() if is_positive(name) and value < 0.0]
                if not wrong:
                    break
                pinned += wrong
            residual = self.data.torque - self.predict(at, linear, torque)
            if is_robust:
                weights = robust_weights(residual)
        independent, _ = self._basis(None, weights, pinned)
        values = {**self.structure.values(at), **linear}
        edges = [
            each.name
            for each, value, low, high in zip(self.structure.coordinates, at, self.lower, self.upper, strict=True)
            if value <= low or value >= high
        ]
        free = [each.name for each in self.structure.coordinates if each.name not in edges]
        names = (*free, *independent)
        return Estimate(
            values=values,
            coordinates=at,
            at_bound=(*edges, *pinned),
            dependent=tuple(name for name in self.keys if name not in independent and name not in pinned),
            residual=residual,
            jacobian=self.jacobian(at, names),
            names=names,
            weights=np.ones(len(self.data)) if weights is None else weights,
            is_converged=solution.is_converged,
        )


def _rows(values: Array, rows: Mask | None, weights: Array | None) -> Array:
    """Rows of (k,) or (k, m) values that count, weighted."""
    if weights is not None:
        values = values * (weights if values.ndim == 1 else weights[:, None])
    return values if rows is None else values[rows]


def is_positive(name: str) -> bool:
    """Whether a linear parameter stays at or above zero."""
    return name.rpartition(".")[2] in _POSITIVE


def robust_weights(residual: Array) -> Array:
    """Square roots of Huber's weights, (k,): 1 within three robust standard deviations, falling beyond.

    Source: P. J. Huber, Annals of Mathematical Statistics 35(1), 1964; scale from the median absolute deviation.
    """
    centred = np.abs(residual - np.median(residual))
    scale = ROBUST_DEVIATIONS * _NORMAL_MAD * float(np.median(centred))
    if scale == 0.0:
        return np.ones(len(residual))
    return np.sqrt(np.minimum(1.0, scale / np.maximum(centred, scale)))
