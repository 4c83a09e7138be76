"""Maximum a posteriori estimate of an axis's parameters from a stretch of its ordinary record.

The measured torque is explained by the axis's own friction model, its inertia and its static torque. What was known
before enters as further rows of the least-squares problem, so that a parameter that the motion does not show stays what
it was (S. M. Kay, Fundamentals of Statistical Signal Processing: Estimation Theory, 1993, chapter 11). The residual is
mostly error of the model, and correlated: rows count as many times less as it is (integrated autocorrelation time;
G. E. P. Box, G. M. Jenkins, Time Series Analysis, 1976), and stretches of a large residual count less.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy import linalg, ndimage

from friction_hil.compensator.load import gravity_torque
from friction_hil.errors import UsageError
from friction_hil.friction import FrictionModel
from friction_hil.identification.least_squares import minimise_bounded
from friction_hil.learning import thresholds as th
from friction_hil.learning.coordinates import Coordinates, coordinates_of
from friction_hil.learning.window import Window, velocity_of
from friction_hil.numerics.jit import Array

_INERTIA, STATIC, _DELAY = range(3)  # coordinates of the mechanics, after those of the friction
MECHANICS = 3


@dataclass(frozen=True, slots=True)
class Mechanics:
    """What is known beside the friction: inertia, and static torque constant + sine sin q + cosine cos q."""

    inertia: float
    static: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Belief:
    """Parameters with their uncertainty."""

    coordinates: Coordinates
    mechanics: Mechanics
    # (m + 3,) coordinates of the friction, then relative change of the inertia, further static torque in friction
    # levels and age of the torque in periods
    x: Array
    covariance: Array  # (m + 3, m + 3)
    first: Array  # (m + 3,) standard deviations before anything was learned

    @property
    def model(self) -> FrictionModel:
        """The model with these parameters."""
        return self.coordinates.model_at(self.x[:-MECHANICS])

    @property
    def errors(self) -> dict[str, float]:
        """Standard error of each parameter of the friction, relative to it (a ripple: to its amplitude)."""
        deviations = np.sqrt(np.diag(self.covariance))
        return dict(zip(self.coordinates.names, deviations.tolist(), strict=False))

    @property
    def uncertainty(self) -> tuple[dict[str, float], list[tuple[str, str, float]]]:
        """Standard error of each parameter of the friction, in its unit, and the correlation of each pair."""
        names, m = self.coordinates.names, len(self.coordinates.names)
        slopes = self.coordinates.slopes(self.x[:-MECHANICS])
        covariance = self.covariance[:m, :m] * np.outer(slopes, slopes)
        errors = np.sqrt(np.diag(covariance))
        correlations = covariance / np.outer(errors, errors)
        pairs = [(names[i], names[j], float(correlations[i, j])) for i in range(m) for j in range(i)]
        return dict(zip(names, errors.tolist(), strict=True)), pairs

    @property
    def parameters(self) -> dict[str, float]:
        """Parameters of the friction by name."""
        return self.coordinates.named(self.x[:-MECHANICS])

    def shown(self, others: Array | None = None) -> Array:
        """Return the coordinates with those that nothing has shown left at other values, those at first by default.

        What the record hardly says about a parameter is as likely an error of the model, which another motion would
        suffer from. The shown ones are then those that are most probable with the ``others`` (conditional mean).

        ``others``: (m + 3,) coordinates to keep.
        """
        deviations = np.sqrt(np.diag(self.covariance))
        is_shown = deviations < th.SHOWN * self.first
        is_shown[-MECHANICS:] = True
        if is_shown.all():
            return self.x
        others = np.zeros_like(self.x) if others is None else others
        found = others.copy()
        across = self.covariance[np.ix_(is_shown, ~is_shown)]
        within = self.covariance[np.ix_(~is_shown, ~is_shown)]
        found[is_shown] = self.x[is_shown] + across @ np.linalg.solve(within, (others - self.x)[~is_shown])
        try:
            self.coordinates.model_at(found[:-MECHANICS])
        except UsageError:  # what was shown does not go with the other values
            return self.x
        return found

    def older(self, drift: float, seconds: float) -> "Belief":
        """Return the belief after some time in which the friction may have changed.

        ``drift``: standard deviation of the relative change within a minute; it grows with the square root of time.
        """
        drifts = np.full(len(self.x), drift)
        # an inertia does not change, but the error of a model is the same in all records of one motion
        drifts[-MECHANICS:] = th.MECHANICS_DRIFT * self.first[-MECHANICS:]
        added = drifts**2 * seconds / 60.0
        variance = np.diag(self.covariance)
        # what was known at first limits what can be forgotten
        grown = np.minimum(variance + added, np.maximum(self.first**2, variance))
        return replace(self, covariance=self.covariance + np.diag(grown - variance))

    def doubted(self) -> "Belief":
        """Return the belief after a change that drift does not explain: as uncertain as at first."""
        variance = np.diag(self.covariance)
        return replace(self, covariance=self.covariance + np.diag(np.maximum(self.first**2 - variance, 0.0)))


def first_belief(model: FrictionModel, mechanics: Mechanics, standard_errors: Mapping[str, float]) -> Belief:
    """Return what a model file says; ``standard_errors`` as for `coordinates_of`."""
    coordinates = coordinates_of(model, standard_errors)
    first = np.concatenate([coordinates.errors, [th.INERTIA_ERROR, th.STATIC_ERROR, th.DELAY_PERIODS]])
    return Belief(coordinates, mechanics, np.zeros(first.size), np.diag(first**2), first)


@dataclass(frozen=True, slots=True)
class Estimate:
    """Result of `estimate`."""

    belief: Belief  # with the record taken into account
    residual: float  # weighted root mean square of the residual, N m
    model_error: float  # the same without white noise, N m: what the model, and not the feedback, leaves
    # how far the record contradicts the belief before it: mean square of the parameters' change in its own standard
    # deviations; about 1 or less if it does not
    surprise: float
    # standard deviation of the friction torque along this motion by the errors of the parameters, N m
    torque_error: float


class Uncompensated(NamedTuple):
    """Friction that a compensation would have left in a record, weighted root mean squares, N m."""

    size: float
    lasting: float  # without white noise, which is that of the torque feedback
    lack: float  # part in proportion to the friction; negative for too much torque


@dataclass(frozen=True, slots=True)
class LeftOver:
    """What a belief leaves of the torque of a record of n rows, of which k count."""

    belief: Belief
    window: Window  # the whole record, whose beginning brings the state of the model to where it was
    whole_velocity: Array  # (n,) of the record
    rows: slice  # of the record: those that count
    torque: Array  # (k,) measured less explained torque, N m
    slopes: Array  # (k, m + 3) derivatives of ``torque`` over the coordinates of the belief
    doubt: Array  # (k,) change of the friction within a period, N m: what is not known of when in a period it happened

    @property
    def position(self) -> Array:
        """Position, rad or m."""
        return self.window.position[self.rows]

    @property
    def velocity(self) -> Array:
        """Velocity, rad/s or m/s."""
        return self.whole_velocity[self.rows]

    @property
    def seconds(self) -> float:
        """Length of the rows."""
        return self.torque.size * self.window.period_s

    def friction(self, model: FrictionModel) -> Array:
        """Return the torque of a model, N m."""
        return model.simulate(self.whole_velocity, self.window.period_s, **self.window.inputs())[self.rows]

    def gradient(self, model: FrictionModel, free: Sequence[Mapping[str, float]]) -> Array:
        """Return the derivatives (k, len(free)) of a model's torque over weighted sums of its parameters."""
        period_s, inputs = self.window.period_s, self.window.inputs()
        _, found = model.simulate_with_gradient(self.whole_velocity, period_s, free=free, **inputs)
        return np.asarray(found[self.rows])


def left_over(window: Window, belief: Belief, resolution: float, skipped_s: float = 0.0) -> LeftOver:
    """Return what a belief leaves of the torque of a record; parameters as in `estimate`."""
    problem = _Problem(window, belief, resolution, round(skipped_s / window.period_s))
    torque, slopes = problem.residual(belief.x)
    return LeftOver(belief, window, problem.velocity, problem.rows, torque, slopes, problem.doubt(belief.x))


def uncompensated(
    window: Window,
    belief: Belief,
    resolution: float,
    commands: Iterable[tuple[FrictionModel, float]],
    skipped_s: float = 0.0,
) -> list[Uncompensated]:
    """Return the friction that compensations would have left in a record.

    The friction is the measured torque less inertia and static torque; rows weigh as in `estimate`, so that those whose
    torque nothing explains do not hide the difference.

    ``commands``: model and gain of each compensation; the others as for `estimate`.
    """
    problem = _Problem(window, belief, resolution, round(skipped_s / window.period_s))
    left, _ = problem.residual(belief.x)
    weights, friction = problem.weights(belief.x, left) ** 2, problem.friction(belief.x)
    developed = friction[problem.rows]
    size = max(_size(developed, weights), th.QUANTUM * problem.level)
    found = []
    for model, gain in commands:
        torque = gain * model.simulate(problem.velocity, window.period_s, **window.inputs())
        remaining = left + (friction - torque)[problem.rows]
        lacking = float(np.average(remaining * developed, weights=weights)) / size
        found.append(Uncompensated(_size(remaining, weights), lasting(remaining, weights), lacking))
    return found


def unexplained(
    window: Window, belief: Belief, x: Array, resolution: float, skipped_s: float = 0.0
) -> tuple[Array, Array]:
    """Return the torque of a record that coordinates leave, (k,), and what is not known of it, (k,); without slopes.

    ``x``: (m + 3,) coordinates of the belief; the others as for `estimate`.
    """
    problem = _Problem(window, belief, resolution, round(skipped_s / window.period_s))
    return problem.left(x, problem.friction(x))[problem.rows], problem.doubt(x)


class _Problem:
    """Residual and derivatives along one record."""

    def __init__(self, window: Window, belief: Belief, resolution: float, skipped: int) -> None:
        self.window, self.belief = window, belief
        self.velocity = velocity_of(window, resolution)
        rate = 1.0 / window.period_s
        acceleration = np.append(np.diff(self.velocity), 0.0) * rate
        mechanics = belief.mechanics
        self.level = belief.coordinates.model.level
        self.inertial = mechanics.inertia * acceleration
        self.static = np.asarray(gravity_torque(*mechanics.static, window.position))
        self.slope = np.gradient(window.torque)  # per period
        self.rows = slice(skipped, len(window) - 1)

    def model_torque(self, x: Array) -> tuple[Array, Array]:
        """Return the friction torque (n,) and its derivatives over the coordinates (n, m)."""
        window = self.window
        return self.belief.coordinates.simulate(x[:-MECHANICS], self.velocity, window.period_s, **window.inputs())

    def residual(self, x: Array) -> tuple[Array, Array]:
        """Return measured less explained torque of the rows (k,), and its derivative (k, m + 3)."""
        k = self.rows
        try:
            torque, gradient = self.model_torque(x)
        except UsageError:
            count = k.stop - k.start
            return np.full(count, math.nan), np.zeros((count, len(x)))
        left = self.left(x, torque)
        slopes = np.column_stack([-gradient, -self.inertial, np.full(len(left), -self.level), self.slope])
        return left[k], slopes[k]

    def left(self, x: Array, friction: Array) -> Array:
        """Return measured torque less that of the friction (n,) and of the mechanics, (n,)."""
        inertia, static, delay = x[-MECHANICS:]
        left = self.window.torque + delay * self.slope - friction - (1.0 + inertia) * self.inertial - self.static
        return np.asarray(left - static * self.level)

    def weights(self, x: Array, left: Array) -> Array:
        """Return the weights (k,) of the rows: 1 / standard deviation, less where residuals are large or correlated."""
        period_s = self.window.period_s
        near = _near(left, period_s)
        size = np.maximum(near, max(float(np.quantile(near, th.EQUAL_PART)), th.QUANTUM * self.level))
        size = np.hypot(size, self.doubt(x))
        whitened = left / size
        return np.asarray(1.0 / (size * math.sqrt(_correlation_time(whitened, round(th.CORRELATED_S / period_s)))))

    def doubt(self, x: Array) -> Array:
        """Return the torque (k,) that is uncertain because it changes within a period."""
        return np.asarray(th.TIMING * np.abs(np.gradient(self.friction(x)))[self.rows])

    def friction(self, x: Array) -> Array:
        """Return the friction torque (n,)."""
        model = self.belief.coordinates.model_at(x[:-MECHANICS])
        return model.simulate(self.velocity, self.window.period_s, **self.window.inputs())


def estimate(window: Window, belief: Belief, resolution: float, skipped_s: float = 0.0) -> Estimate:
    """Refine a belief by a record.

    ``resolution``: step of the position, rad or m. ``skipped_s``: beginning of the record that only brings the model's
    state to where it was, s.
    """
    problem = _Problem(window, belief, resolution, round(skipped_s / window.period_s))
    prior = linalg.cholesky(np.linalg.inv(belief.covariance))
    mean, reach = belief.x, th.DEVIATIONS * belief.first
    reach[:-MECHANICS] = np.minimum(reach[:-MECHANICS], th.FARTHEST)
    x = mean
    left, slopes = problem.residual(x)
    weights = problem.weights(x, left)
    residual = math.inf
    for k in range(th.MOST_REWEIGHTINGS):

        def stacked(at: Array, weights: Array = weights) -> tuple[Array, Array]:
            left, slopes = problem.residual(at)
            return (
                np.concatenate([weights * left, prior @ (at - mean)]),
                np.concatenate([weights[:, None] * slopes, prior]),
            )

        x = minimise_bounded(stacked, x, -reach, reach, evaluations=th.EVALUATIONS, tolerance=1e-6).at
        left, slopes = problem.residual(x)
        weights = problem.weights(x, left)
        before, residual = residual, _size(left, weights**2)
        if k >= th.REWEIGHTINGS - 1 and residual > th.ESTIMATE_SETTLED * before:
            break
    weighted = weights[:, None] * slopes
    information = weighted.T @ weighted
    covariance = np.linalg.inv(information + prior.T @ prior)
    covariance = 0.5 * (covariance + covariance.T)
    step = x - mean
    # the step by which independent data would change the parameters has this covariance
    expected = belief.covariance - covariance
    surprise = float(step @ np.linalg.pinv(expected, rcond=1e-6) @ step) / max(np.linalg.matrix_rank(expected), 1)
    friction = slopes[:, :-MECHANICS]
    inner = covariance[:-MECHANICS, :-MECHANICS]
    variance = np.einsum("ki,ij,kj->k", friction, inner, friction)
    return Estimate(
        belief=replace(belief, x=x, covariance=covariance),
        residual=residual,
        model_error=lasting(left, weights**2),
        surprise=surprise,
        torque_error=float(np.sqrt(np.mean(variance))),
    )


def refine(
    window: Window, belief: Belief, resolution: float, skipped_s: float = 0.0, usual: float = math.inf
) -> Estimate:
    """Refine a belief as `estimate` does; where the record contradicts it, it counts as uncertain as at first.

    Large residuals count less, so that a record that contradicts what is known may hardly change it: where much is
    left, an estimate that begins with doubt takes its place if it leaves much less.

    ``usual``: residual of the last record, N m.
    """
    found = estimate(window, belief, resolution, skipped_s)
    is_surprise = found.surprise > th.SURPRISE
    if is_surprise or found.residual > th.CONTRADICTED * usual + th.CONTRADICTED_LEVEL * belief.coordinates.model.level:
        anew = estimate(window, belief.doubted(), resolution, skipped_s)
        if is_surprise or anew.residual < th.LESS_RESIDUAL * found.residual:
            return anew
    return found


def lasting(values: Array, weights: Array) -> float:
    """Return the weighted root mean square of values (k,) without what is white noise in them.

    The covariance of neighbouring rows has the variance of all that lasts longer than a row; white noise has none.
    """
    within = np.sqrt(weights[1:] * weights[:-1])
    return math.sqrt(max(float(np.average(values[1:] * values[:-1], weights=within)), 0.0))


def _size(values: Array, weights: Array) -> float:
    """Return the weighted root mean square of values (k,)."""
    return float(np.sqrt(np.average(values**2, weights=weights)))


def _near(left: Array, period_s: float) -> Array:
    """Return the local root mean square of the residual."""
    return np.asarray(np.sqrt(ndimage.uniform_filter1d(left**2, max(round(th.NEAR_S / period_s), 1), mode="nearest")))


def _correlation_time(values: Array, longest: int) -> float:
    """Return the number of rows that count as one: 1 + 2 sum of the autocorrelations up to their first zero."""
    count = 1 << (2 * values.size - 1).bit_length()
    spectrum = np.fft.rfft(values - 0.0, count)
    products = np.fft.irfft(np.abs(spectrum) ** 2, count)[: min(longest, values.size)]
    if products[0] <= 0.0:
        return 1.0
    correlations = products / products[0]
    ends = np.flatnonzero(correlations <= 0.0)
    end = int(ends[0]) if ends.size else correlations.size
    return float(max(1.0 + 2.0 * np.sum(correlations[1:end]), 1.0))
