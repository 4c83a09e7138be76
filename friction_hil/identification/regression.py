"""Regression of one model structure on data: residual and Jacobian with the linear parameters projected out.

Variable projection: the columns of the linear parameters are constant, so that a search for the nonlinear ones in the
orthogonal complement of their span finds all parameters at once. Source: G. Golub, V. Pereyra, SIAM Journal on
Numerical Analysis 10(2), 1973.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from friction_hil.errors import UsageError
from friction_hil.identification import thresholds as th
from friction_hil.identification.data import Data, Mask
from friction_hil.identification.least_squares import (
    BoundedSolution,
    FitError,
    column_norms,
    least_norm_solution,
    minimise_bounded,
    project_out,
)
from friction_hil.identification.structures import ModelStructure
from friction_hil.numerics.jit import Array
from friction_hil.parallel import in_parallel

# Linear parameters that stay at or above zero: friction must not drive the axis.
_POSITIVE = ("inertia", "viscous", "sigma2", "back_emf")
# Parameters of a drive with an unknown gain: see `friction_hil.identification.unknown_gain`.
GAIN, INVERSE_GAIN, BACK_EMF = "drive.gain", "drive.inverse_gain", "drive.back_emf"
_REMEMBERED = 6  # evaluations kept
_LONG = 20_000  # steps of the longest record: below, a thread takes longer to start than it saves
_RANK = 1e-9  # of a column's norm: a smaller remainder outside the span of the columns before it is rounding
_COLLINEAR = 1e-7  # the same for a derivative
_NORMAL_MAD = 1.4826  # standard deviation of a normal distribution over its median absolute deviation


@dataclass(frozen=True, slots=True)
class Estimate:
    """Estimated parameters of a structure and of the mechanics, with the residual."""

    # all estimated parameters by name: of friction, and ``inertia``, ``offset``, ``gravity.sine`` ...
    values: dict[str, float]
    coordinates: Array  # (m,), of the nonlinear parameters
    at_bound: tuple[str, ...]  # parameters that ended at a bound
    dependent: tuple[str, ...]  # linear parameters left out because their columns are combinations of the others
    residual: Array  # (k,), measured minus predicted torque
    jacobian: Array  # (k, p), derivative of the predicted torque with respect to each parameter of ``names``
    names: tuple[str, ...]  # free parameters: neither held nor at a bound nor dependent
    weights: Array  # (k,), of the rows; ones for plain least squares
    is_converged: bool

    @property
    def rmse(self) -> float:
        """Root mean square of the residual, N m or N."""
        return float(np.sqrt(np.mean(self.residual**2)))


class Regression:
    """A model structure and the linear parameters of the mechanics, to be fitted to data."""

    def __init__(
        self,
        data: Data,
        structure: ModelStructure,
        mechanics: Sequence[str],  # linear parameters of the mechanics to identify
        held: Mapping[str, float] | None = None,  # those that are held, by name
        loads: Sequence[Array] | None = None,  # load torque (n,) of each record, if the structure depends on it
    ) -> None:
        self.data, self.structure, self.loads = data, structure, loads
        self.held = dict(held or {})
        self.keys = {**{name: name for name in mechanics if name not in self.held}, **structure.linear}
        self.lower, self.upper = (
            np.array([each.bounds[i] for each in structure.coordinates], dtype=float) for i in (0, 1)
        )
        self.longest = np.array(
            [th.LONGEST_STEP if each.is_log else math.inf for each in structure.coordinates], dtype=float
        )
        self._known: dict[bytes, tuple[Array, Array]] = {}
        self._buffers: list[tuple[Array, Array]] | None = None  # for torque and gradient at the full rate
        self._held_torque = np.zeros(len(data))
        for name, value in self.held.items():
            self._held_torque += value * data.column(name)

    def friction(self, coordinates: Array) -> tuple[Array, Array]:
        """Return `_friction`, kept for the last few coordinates: folds of a cross-validation start at the same ones."""
        key = coordinates.tobytes()
        known = self._known.pop(key, None)
        self._known[key] = self._friction(coordinates) if known is None else known
        if len(self._known) > _REMEMBERED:
            del self._known[next(iter(self._known))]
        return self._known[key]

    def _friction(self, coordinates: Array) -> tuple[Array, Array]:
        """Return the nonlinear friction torque (k,) and its derivatives (k, m); NaN for inconsistent parameters."""
        structure, records = self.structure, self.data.records
        values = structure.values(coordinates)
        try:
            model = structure.model(values)
            is_allowed = structure.is_admissible(values)
        except UsageError:
            is_allowed = False
        if not is_allowed:
            return np.full(len(self.data), math.nan), np.zeros((len(self.data), len(coordinates)))
        # derivative of each parameter with respect to its coordinate
        slopes = [
            each.outer(float(x)) if each.is_log else 1.0
            for each, x in zip(structure.coordinates, coordinates, strict=True)
        ]
        directions = [dict.fromkeys(each.names, x) for each, x in zip(structure.coordinates, slopes, strict=True)]
        if self._buffers is None:
            self._buffers = [
                (np.empty(record.velocity.size), np.empty((record.velocity.size, len(directions))))
                for record in records
            ]
        jobs = [
            partial(
                model.simulate_with_gradient,
                record.velocity,
                record.dt,
                free=directions,
                out=self._buffers[number],
                **self._inputs(number),
            )
            for number, record in enumerate(records)
        ]
        if max(record.velocity.size for record in records) >= _LONG:
            in_parallel(jobs)
        else:
            for job in jobs:
                job()
        torques, gradients = zip(*self._buffers, strict=True)
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
    ) -> BoundedSolution:
        """Search from ``start`` with the linear parameters projected out, on the rows of a mask if given."""
        basis = self._basis(rows, weights, pinned)[1]
        target = self.data.torque - self._held_torque

        def residual(at: Array) -> tuple[Array, Array]:
            torque, gradient = self.friction(at)
            both = _rows(np.column_stack([target - torque, -gradient]), rows, weights)
            before = column_norms(both)
            project_out(basis, both)
            # a derivative inside the span of the linear parameters leaves rounding only: not a direction to search in
            is_made_up = column_norms(both) <= _COLLINEAR * before
            both[:, 1:][:, is_made_up[1:]] = 0.0
            return np.ascontiguousarray(both[:, 0]), np.ascontiguousarray(both[:, 1:])

        return minimise_bounded(
            residual,
            start,
            self.lower,
            self.upper,
            evaluations=evaluations,
            tolerance=tolerance,
            longest=self.longest,
        )

    def refit(
        self,
        at: Array,
        *,
        rows: Mask,
        weights: Array | None = None,
        pinned: Sequence[str] = (),
        is_linear: bool = False,
    ) -> tuple[Array, Array]:
        """Return coordinates fitted to the rows of a mask, starting from a fit to all rows, and their torque (k,).

        One Gauss-Newton step, whose gradient is known already, is taken if it is short enough for the torque to follow
        that gradient, or if the sum of squares falls by at least half of the predicted decrease. Otherwise a damped
        step is tried, because parameters that the data hardly determine make the step too long, and finally a search.
        With ``is_linear`` the damped step is taken without a simulation.
        """
        torque_at, gradient = self.friction(at)
        torque = torque_at
        if not len(at):
            return at, torque
        basis = self._basis(rows, weights, pinned)[1]
        target = self.data.torque - self._held_torque
        both = _rows(np.column_stack([target - torque, -gradient]), rows, weights)
        project_out(basis, both)
        cost = float(np.sum(both[:, 0] ** 2))
        norms = column_norms(both[:, 1:])
        is_free = (norms > _COLLINEAR * column_norms(gradient)) & (at > self.lower) & (at < self.upper)
        columns = both[:, 1:][:, is_free] / norms[is_free]
        normal, slope = columns.T @ columns, columns.T @ both[:, 0]
        for damping in (0.0, th.REFIT_DAMPING):
            step = np.zeros(len(at))
            damped = normal + damping * np.eye(len(slope))
            step[is_free] = least_norm_solution(damped, -slope, 1e-10) / norms[is_free]
            trial = np.clip(at + np.clip(step, -self.longest, self.longest), self.lower, self.upper)
            if (is_linear and damping > 0.0) or self._is_short(at, trial):
                return trial, torque_at + gradient @ (trial - at)
            if is_linear:
                continue
            try:
                torque = self.friction_torque(trial)
            except UsageError:
                continue
            after = _rows((target - torque)[:, None], rows, weights)
            project_out(basis, after)
            promised = cost - float(np.sum((both[:, 0] + both[:, 1:] @ (trial - at)) ** 2))
            if cost - float(np.sum(after**2)) >= 0.5 * promised >= 0.0:  # below zero where a bound has bent the step
                return trial, torque
        at = self.search(
            at, evaluations=th.REFIT_EVALUATIONS, rows=rows, weights=weights, pinned=pinned, tolerance=1e-4
        ).at
        return at, self.friction(at)[0]

    def _is_short(self, at: Array, trial: Array) -> bool:
        """Return True if every parameter changes by a few percent at most."""
        sizes = np.where(np.isfinite(self.longest), 1.0, np.abs(at))  # a logarithm changes by the relative change
        return bool(np.all(np.abs(trial - at) <= th.SHORT_STEP * sizes))

    def _basis(self, rows: Mask | None, weights: Array | None, pinned: Sequence[str]) -> tuple[list[str], Array]:
        """Return the names of linear parameters with independent columns, and an orthonormal basis of their span."""
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
        """Return the linear parameters that fit best to a nonlinear friction ``torque`` (k,); 0 for dependent ones."""
        names, _ = self._basis(rows, weights, pinned)
        values = dict.fromkeys(self.keys, 0.0)
        if names:
            matrix = np.column_stack([self.data.column(self.keys[name]) for name in names])
            norms = np.linalg.norm(matrix, axis=0)
            target = _rows(self.data.torque - self._held_torque - torque, rows, weights)
            found = least_norm_solution(_rows(matrix / norms, rows, weights), target) / norms
            values.update(zip(names, map(float, found), strict=True))
        return values

    def impossible(self, linear: Mapping[str, float]) -> list[str]:
        """Return the linear parameters whose values no friction has: they are to be held at 0."""
        wrong = [name for name, value in linear.items() if is_positive(name) and value < 0.0]
        bend = linear.get("viscous.quadratic", 0.0)
        if bend < 0.0:
            slopes = [value for name, value in linear.items() if name.rpartition(".")[2] in ("viscous", "sigma2")]
            top = float(np.max(np.abs(self.data.motion("velocity"))))
            if min(slopes, default=0.0) + th.BENDING_SPEEDS * top * bend < 0.0:
                wrong.append("viscous.quadratic")
        return wrong

    def predict(self, coordinates: Array, linear: Mapping[str, float], friction: Array | None = None) -> Array:
        """Return the predicted torque (k,); ``friction`` is the result of `friction_torque` if known already."""
        torque = self._held_torque + (self.friction_torque(coordinates) if friction is None else friction)
        for name, value in linear.items():
            torque = torque + value * self.data.column(self.keys[name])
        return torque

    def friction_torque(self, coordinates: Array) -> Array:
        """Return the torque of `friction` without derivatives."""
        return self.data.stack(self.simulated(coordinates))

    def simulated(self, coordinates: Array) -> list[Array]:
        """Return the nonlinear friction torque along each record, (n,)."""
        model = self.structure.model(self.structure.values(coordinates))
        records = enumerate(self.data.records)
        return [model.simulate(record.velocity, record.dt, **self._inputs(number)) for number, record in records]

    def _inputs(self, number: int) -> dict[str, Any]:
        """Return what a model is given of a record beside its velocity."""
        record, load = self.data.records[number], None if self.loads is None else self.loads[number]
        return {"position": record.position, "load_torque": load, "temperature": record.temperature}

    def on(self, data: Data) -> "Regression":
        """Return the same regression on other data with the same loads."""
        mechanics = [name for name in self.keys if name not in self.structure.linear]
        return Regression(data, self.structure, mechanics, self.held, self.loads)

    def jacobian(self, at: Array, names: Sequence[str]) -> Array:
        """Return the derivative (k, p) of the predicted torque over named parameters, linear ones included."""
        gradient = self.friction(at)[1]
        indices = {each.name: i for i, each in enumerate(self.structure.coordinates)}
        columns = []
        for name in names:
            if name in self.keys:
                columns.append(self.data.column(self.keys[name]))
                continue
            each, i = self.structure.coordinates[indices[name]], indices[name]
            columns.append(gradient[:, i] / (each.outer(float(at[i])) if each.is_log else 1.0))
        return np.column_stack(columns) if columns else np.empty((len(self.data), 0))

    def estimate(
        self, start: Array, *, is_robust: bool = False, evaluations: int = 60, weights: Array | None = None
    ) -> Estimate:
        """Estimate all parameters from one start, (m,).

        ``is_robust``: residuals beyond three robust standard deviations are reweighted. ``evaluations``: most of each
        search. ``weights``: (k,), initial ones of the rows. Raises `FitError`: the torque is not finite where the
        search starts.
        """
        pinned: list[str] = []
        at = start
        for _ in range(th.REGRESSION_ROUNDS if is_robust else 1):
            while True:
                solution = self.search(at, evaluations=evaluations, weights=weights, pinned=pinned)
                at = solution.at
                if not math.isfinite(solution.cost):
                    raise FitError("its torque is not defined at any start of the search")
                torque, _ = self.friction(at)
                linear = self.linear(torque, weights=weights, pinned=pinned)
                wrong = [name for name in self.impossible(linear) if name not in pinned]
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
    """Return the rows of (k,) or (k, m) values that a mask selects, weighted."""
    if weights is not None:
        values = values * (weights if values.ndim == 1 else weights[:, None])
    return values if rows is None else values[rows]


def is_positive(name: str) -> bool:
    """Return True if a linear parameter must not be negative."""
    return name.rpartition(".")[2] in _POSITIVE


def robust_weights(residual: Array) -> Array:
    """Return square roots of Huber's weights, (k,): 1 within three robust standard deviations, decreasing beyond.

    Source: P. J. Huber, Annals of Mathematical Statistics 35(1), 1964; scale from the median absolute deviation.
    """
    centred = np.abs(residual - np.median(residual))
    scale = th.ROBUST_DEVIATIONS * _NORMAL_MAD * float(np.median(centred))
    if scale == 0.0:
        return np.ones(len(residual))
    return np.sqrt(np.minimum(1.0, scale / np.maximum(centred, scale)))
