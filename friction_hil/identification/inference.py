"""How well the data determine parameters: standard errors that allow for correlated residuals, correlations, flags.

Standard errors are those of Newey and West, Econometrica 55(3), 1987: residuals of a friction model are mostly what
the model leaves out, hence alike from row to row, and errors that took them for independent would be too small by
a factor of several.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from friction_hil.identification.problem import Estimate
from friction_hil.numerics.jit import Array

COLLINEAR = 0.98  # correlation from which two parameters count as one
VAGUE = 0.5  # standard error over value from which a parameter counts as not excited
REPORTED_CORRELATION = 0.9
_SHARE = 0.1  # in a direction that the data do not see
_RANK = 1e-7  # of the largest singular value


@dataclass(frozen=True, slots=True)
class Inference:
    """Uncertainty of an estimate.

    Attributes
    ----------
    names : tuple of str
        Parameters that were free.
    standard_errors : dict
        By name; infinite for one that the data do not determine.
    correlations : (p, p) array
        In the order of ``names``.
    lags : int
        Over how many rows residuals are taken to be correlated.
    same : tuple of tuple of str
        Groups of parameters whose effects are the same in these data.
    """

    names: tuple[str, ...]
    standard_errors: dict[str, float]
    correlations: Array
    lags: int
    same: tuple[tuple[str, ...], ...] = ()

    def pairs(self, least: float = REPORTED_CORRELATION) -> list[tuple[str, str, float]]:
        """Pairs of parameters whose correlation is at least that, largest first."""
        found = [
            (self.names[i], self.names[j], float(self.correlations[i, j]))
            for i in range(len(self.names))
            for j in range(i)
            if abs(self.correlations[i, j]) >= least
        ]
        return sorted(found, key=lambda pair: -abs(pair[2]))


def infer(estimate: Estimate, parts: Sequence[slice], *, lags: int | None = None) -> Inference:
    """Uncertainty of an estimate from the residuals of records, which are the ``parts`` of its rows.

    Over how many rows residuals are correlated, ``lags``, is read off them where it is not given.
    """
    names = estimate.names
    weights = estimate.weights[:, None]
    jacobian = estimate.jacobian * weights
    residual = estimate.residual * estimate.weights
    rows, count = jacobian.shape
    if not count:
        return Inference((), {}, np.empty((0, 0)), 0)
    norms = np.linalg.norm(jacobian, axis=0)
    is_seen = norms > 0.0
    size = np.where(is_seen, norms, 1.0)
    # of the triangular factor, which has the same: for a tall matrix a BLAS of several threads takes a hundred times
    # as long
    _, singular, vectors = np.linalg.svd(np.linalg.qr(jacobian / size, mode="r"), full_matrices=False)
    is_kept = singular > _RANK * singular[0]
    inverse = (vectors[is_kept].T / singular[is_kept] ** 2) @ vectors[is_kept]
    # a parameter with a share in a direction that nothing in the data sees has no error to speak of
    is_determined = is_seen & (np.sum(vectors[~is_kept] ** 2, axis=0) < _RANK)
    lags = _lags(residual, parts) if lags is None else lags
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
    # correlation of what the data can tell apart, whatever the residuals are
    spread = np.sqrt(np.maximum(np.diag(inverse), 1e-300))
    correlations = np.clip(inverse / np.outer(spread, spread), -1.0, 1.0)
    same = tuple(
        tuple(name for name, part in zip(names, vector, strict=True) if abs(part) > _SHARE)
        for vector in vectors[~is_kept]
    )
    return Inference(names, dict(zip(names, map(float, errors), strict=True)), correlations, lags, same)


def _lags(residual: Array, parts: Sequence[slice]) -> int:
    """Bandwidth for residuals of first order: D. W. K. Andrews, Econometrica 59(3), 1991, Bartlett kernel."""
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
    """What to do so that a recording shows this parameter."""
    last = name.rpartition(".")[2].partition("[")[0]
    if name.startswith("gravity."):
        return _EXPERIMENTS["gravity"]
    return _EXPERIMENTS.get(last, "move at more speeds, accelerations and amplitudes")


def advice(names: Sequence[str]) -> str:
    """What to do so that a recording tells these parameters apart."""
    plain = frozenset(name.rpartition(".")[2].partition("[")[0] for name in names)
    return _OFTEN_TOGETHER.get(plain, experiment(names[0]))


def flags(estimate: Estimate, inference: Inference) -> list[str]:
    """Sentences about parameters at a bound, not excited, and collinear, each with the experiment that would help."""
    found = [
        f"at bound: {name} = {estimate.values[name]:.6g}; the data ask for less or more: {experiment(name)}"
        for name in estimate.at_bound
    ]
    found += [
        f"collinear: {name} cannot be told from the others and was held at 0: {experiment(name)}"
        for name in estimate.dependent
    ]
    found += [
        f"collinear: {' and '.join(group)} have the same effect here: {advice(group)}"
        for group in inference.same
        if len(group) > 1
    ]
    for first, second, correlation in inference.pairs(COLLINEAR):
        if any(first in group and second in group for group in inference.same):
            continue
        found.append(f"collinear: {first} and {second} (correlation {correlation:.3f}): {advice((first, second))}")
    for name in inference.names:
        error, value = inference.standard_errors[name], abs(estimate.values[name])
        if name in ("offset", "gravity.constant") and math.isfinite(error):
            continue  # next to nothing is a fair value for these
        if not error <= VAGUE * value:
            share = f"{100.0 * error / value:.0f} % of it" if value > 0.0 and math.isfinite(error) else "without bound"
            found.append(f"not excited: {name} = {value:.4g}, its standard error {share}: {experiment(name)}")
    if not estimate.is_converged:
        found.append("not converged: the search ended before the error stopped falling")
    return found


def explained(values: Mapping[str, float], inference: Inference) -> dict[str, float | None]:
    """Standard errors by name, None for what was held, at a bound, or is not determined."""
    return {
        name: error if math.isfinite(error := inference.standard_errors.get(name, math.inf)) else None
        for name in values
    }
