"""Uncertainty of fitted parameters: standard errors for correlated residuals, correlations, and flags.

Standard errors are those of Newey and West, Econometrica 55(3), 1987. The residual of a friction model is mostly model
error and therefore correlated from row to row; standard errors for independent residuals would be too small by a factor
of several.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from friction_hil.identification import thresholds as th
from friction_hil.identification.least_squares import FitError, column_norms
from friction_hil.identification.regression import Estimate
from friction_hil.numerics.jit import Array

AT_BOUND, COLLINEAR_FLAG, NOT_EXCITED = "at bound: ", "collinear: ", "not excited: "  # beginnings of flags
_RANK = 1e-7  # of the largest singular value: directions below are undetermined


@dataclass(frozen=True, slots=True)
class Inference:
    """Uncertainty of an estimate."""

    names: tuple[str, ...]  # free parameters
    standard_errors: dict[str, float]  # infinite: the data do not determine the parameter
    correlations: Array  # (p, p), in the order of ``names``
    lags: int  # rows over which residuals are taken to be correlated
    same: tuple[tuple[str, ...], ...] = ()  # parameters whose effects cannot be told apart in these data

    def pairs(self, least: float = th.REPORTED_CORRELATION) -> list[tuple[str, str, float]]:
        """Return pairs of parameters whose absolute correlation is ``least`` or more, largest first."""
        found = [
            (self.names[i], self.names[j], float(self.correlations[i, j]))
            for i in range(len(self.names))
            for j in range(i)
            if abs(self.correlations[i, j]) >= least
        ]
        return sorted(found, key=lambda pair: -abs(pair[2]))


def infer(estimate: Estimate, parts: Sequence[slice], *, lags: int | None = None) -> Inference:
    """Return the uncertainty of an estimate.

    ``parts``: rows of each record. ``lags``: rows over which residuals are correlated; None: estimated from the
    residuals.
    """
    names = estimate.names
    weights = estimate.weights[:, None]
    jacobian = estimate.jacobian * weights
    residual = estimate.residual * estimate.weights
    rows, count = jacobian.shape
    if not count:
        return Inference((), {}, np.empty((0, 0)), 0)
    norms = column_norms(jacobian)
    if not (np.isfinite(norms).all() and np.isfinite(residual).all()):
        raise FitError("its torque or a derivative of it is not finite")
    is_seen = norms > 0.0
    size = np.where(is_seen, norms, 1.0)
    # the triangular factor has the same singular values; for the tall matrix itself a BLAS with several threads takes
    # a hundred times as long
    singular, vectors = _singular(np.linalg.qr(jacobian / size, mode="r"))  # type: ignore[arg-type]
    is_kept = singular > _RANK * singular[0]
    inverse = (vectors[is_kept].T / singular[is_kept] ** 2) @ vectors[is_kept]
    # a parameter with a component in an undetermined direction has no finite error
    is_determined = is_seen & (np.sum(vectors[~is_kept] ** 2, axis=0) < _RANK)
    lags = correlated_lags(residual, parts) if lags is None else lags
    scores = jacobian / size * residual[:, None]
    middle = np.zeros((count, count))
    for part in parts:
        own = scores[part]
        middle += own.T @ own
        for lag in range(1, min(lags, len(own) - 1) + 1):
            product = own[lag:].T @ own[:-lag]
            middle += (1.0 - lag / (lags + 1.0)) * (product + product.T)
    covariance = inverse @ middle @ inverse * (rows / max(rows - count, 1))
    deviations = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    errors = np.where(is_determined, deviations / size, math.inf)
    # correlations from the Jacobian alone: what the data can tell apart does not depend on the residuals
    spread = np.sqrt(np.maximum(np.diag(inverse), 1e-300))
    correlations = np.clip(inverse / np.outer(spread, spread), -1.0, 1.0)
    same = tuple(
        tuple(name for name, part in zip(names, vector, strict=True) if abs(part) > th.LEAST_COMPONENT)
        for vector in vectors[~is_kept]
    )
    return Inference(names, dict(zip(names, map(float, errors), strict=True)), correlations, lags, same)


def correlated_square(values: Array, lags: int) -> float:
    """Return the sum of squares of values (k,) as it counts for their sum if so many rows are correlated."""
    total = float(values @ values)
    for lag in range(1, lags + 1):
        total += 2.0 * (1.0 - lag / (lags + 1)) * float(values[lag:] @ values[:-lag])
    return total


def _singular(matrix: Array) -> tuple[Array, Array]:
    """Return the singular values of a matrix, largest first, and its right singular vectors in rows."""
    try:
        _, singular, vectors = np.linalg.svd(matrix, full_matrices=False)
    except np.linalg.LinAlgError:  # divide and conquer can fail where plain iterations do not
        from scipy import linalg  # imported here: it is hardly ever needed

        _, singular, vectors = linalg.svd(matrix, full_matrices=False, lapack_driver="gesvd")
    return np.asarray(singular), np.asarray(vectors)


def correlated_lags(residual: Array, parts: Sequence[slice]) -> int:
    """Return the bandwidth for first-order residuals: D. W. K. Andrews, Econometrica 59(3), 1991, Bartlett kernel."""
    above = sum(float(residual[part][1:] @ residual[part][:-1]) for part in parts)
    below = sum(float(residual[part] @ residual[part]) for part in parts)
    rho = min(max(above / below, -0.97), 0.97) if below > 0.0 else 0.0
    alpha = 4.0 * rho**2 / (1.0 - rho**2) ** 2
    lags = math.ceil(1.1447 * (alpha * len(residual)) ** (1.0 / 3.0))
    return int(min(lags, max(len(residual) // 10, 1)))


_EXPERIMENTS = {
    "inertia": "accelerate harder, over several levels of acceleration",
    "offset": "move in both directions at the same speeds",
    "gravity": "cover a larger range of positions, both ways at the same low speed",
    "viscous": "hold several constant speeds up to the top speed, in both directions",
    "sigma2": "hold several constant speeds up to the top speed, in both directions",
    "quadratic": "hold constant speeds up to the top speed",
    "cubic": "hold constant speeds up to the top speed",
    "coulomb": "slide at several constant speeds, slow ones too, in both directions",
    "static": "creep: constant speeds far below the Stribeck velocity, and slow starts from rest",
    "static_released": "reverse and start again without a rest",
    "static_rested": "start from rests of different length, up to minutes",
    "rise_s": "start from rests of different length, up to minutes",
    "stribeck_velocity": "hold constant speeds about it, a decade to either side",
    "sigma0": "reverse with amplitudes of a few presliding deflections, slowly, with full encoder resolution",
    "stiffness": "reverse with amplitudes of a few presliding deflections, slowly, with full encoder resolution",
    "beta": "reverse with different amplitudes",
    "gamma": "reverse with different amplitudes",
    "exponent": "cover speeds from creep to the top speed, and reverse with different amplitudes",
    "factor": "hold constant speeds from creep to the top speed",
    "sigma1": "reverse fast with presliding amplitudes: 20 to 200 Hz at a few deflections",
    "damping_velocity": "reverse fast with presliding amplitudes, and through them at different speeds",
    "breakaway_ratio": "small cycles inside presliding that drift where the model is wrong: ramp up, vibrate, hold",
    "attraction": "change the speed quickly while sliding in one direction",
    "lag_s": "change the speed quickly while sliding slowly in one direction",
    "points": "hold constant speeds about each point",
    "motoring": "lift different loads",
    "driven": "lower different loads",
    "coefficient": "record cold and warm",
    "cosine": "slide slowly over whole periods",
    "sine": "slide slowly over whole periods",
}
_OFTEN_TOGETHER = {
    frozenset(("coulomb", "static")): "slide at constant speeds on both sides of the Stribeck velocity",
    frozenset(("coulomb", "viscous")): "hold constant speeds over a wider range",
    frozenset(("coulomb", "sigma2")): "hold constant speeds over a wider range",
    frozenset(("coulomb", "factor")): "hold constant speeds over a wider range",
    frozenset(("sigma0", "sigma1")): "reverse with presliding amplitudes at frequencies a decade apart",
    frozenset(("offset", "cosine")): "cover a larger range of positions",
}


def experiment(name: str) -> str:
    """Return the motion that makes a recording show this parameter."""
    last = name.rpartition(".")[2].partition("[")[0]
    if name.startswith("gravity."):
        return _EXPERIMENTS["gravity"]
    return _EXPERIMENTS.get(last, "move at more speeds, accelerations and amplitudes")


def advice(names: Sequence[str]) -> str:
    """Return the motion that lets a recording tell these parameters apart."""
    plain = frozenset(name.rpartition(".")[2].partition("[")[0] for name in names)
    return _OFTEN_TOGETHER.get(plain, experiment(names[0]))


def flags(estimate: Estimate, inference: Inference) -> list[str]:
    """Return sentences on parameters at a bound, not excited or collinear, each with the motion that would help."""
    found = [
        f"{AT_BOUND}{name} = {estimate.values[name]:.6g}; the search would go beyond: {experiment(name)}"
        for name in estimate.at_bound
    ]
    found += [
        f"{COLLINEAR_FLAG}{name} cannot be told from the others and was held at 0: {experiment(name)}"
        for name in estimate.dependent
    ]
    found += [
        f"{COLLINEAR_FLAG}{' and '.join(group)} have the same effect here: {advice(group)}"
        for group in inference.same
        if len(group) > 1
    ]
    for first, second, correlation in inference.pairs(th.COLLINEAR):
        if any(first in group and second in group for group in inference.same):
            continue
        found.append(f"{COLLINEAR_FLAG}{first} and {second} (correlation {correlation:.3f}): {advice((first, second))}")
    for name in inference.names:
        error, value = inference.standard_errors[name], _size(name, estimate.values)
        if name in ("offset", "gravity.constant") and math.isfinite(error):
            continue  # these may well be zero
        if not error <= th.VAGUE * value:
            relative = (
                f"{100.0 * error / value:.0f} % of it" if value > 0.0 and math.isfinite(error) else "without bound"
            )
            found.append(f"{NOT_EXCITED}{name} = {value:.4g}, its standard error {relative}: {experiment(name)}")
    if not estimate.is_converged:
        found.append("not converged: the search ended before the error stopped falling")
    return found


def _size(name: str, values: Mapping[str, float]) -> float:
    """Return the absolute value of a parameter, or the amplitude of the harmonic to which it belongs."""
    harmonic, _, part = name.rpartition(".")
    if part in ("cosine", "sine") and harmonic.startswith("ripple["):
        return math.hypot(*(values[f"{harmonic}.{each}"] for each in ("cosine", "sine")))
    return abs(values[name])


def is_doubtful(flags_of_fit: Sequence[str]) -> bool:
    """Return True if a flag says that the data do not determine a parameter."""
    return any(flag.startswith((AT_BOUND, COLLINEAR_FLAG, NOT_EXCITED)) for flag in flags_of_fit)
