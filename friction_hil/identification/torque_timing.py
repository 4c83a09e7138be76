"""Age of a reported torque relative to the position of the same sample: mean over the last period, instant, or later.

No drive reports it. A torque that comes late by ``delay`` looks like the torque of a motion ``delay`` ago: the residual
of a refined fit contains minus ``delay`` times the time derivative of the predicted torque. The delay is estimated
together with all parameters of the fit by Gauss-Newton steps, without the bias that the counts of the encoder cause
(simulated experiments, as in `friction_hil.identification.refine`).

Damping of presliding explains a delay of the spring's torque, so that only the torque of the inertia and friction at
higher speeds tell them apart. Therefore the standard error is large where the axis accelerates little, and families of
friction models that fit equally well must not contradict each other.

A drive that interpolates its set-points by steps of the acceleration has, at the instant of a sample, an inertia torque
that is half a period old: an instantaneous torque shows as a delay between 0 and half a period.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from friction_hil.identification import thresholds as th
from friction_hil.identification.candidates import CandidateFitter
from friction_hil.identification.data import Data
from friction_hil.identification.fine import FineSegment, recounted
from friction_hil.identification.fits import Fit
from friction_hil.identification.inference import infer
from friction_hil.identification.least_squares import NUMERICAL, scaled_solution
from friction_hil.identification.refine import LAG_ROWS, is_dynamic, sensed, torque_at_steps, weighted_estimate
from friction_hil.identification.regression import Estimate, Regression
from friction_hil.identification.structures import EXTENDS
from friction_hil.numerics.jit import Array

Meaning = Literal["mean", "instant", "late"]

_MEAN_PERIODS = 0.5


@dataclass(frozen=True, slots=True)
class TorqueTiming:
    """Age of a reported torque."""

    delay_s: float  # mean age relative to the position of the sample
    error_s: float  # standard error of the age
    period_s: float  # sampling period
    # ``mean`` over the period before the sample, ``instant``, ``late`` (older than a mean); None: the recordings do not
    # tell
    meaning: Meaning | None
    # what it is taken for if they do not tell: ``instant`` if the driver stated the age of its torque, else ``mean``
    assumed: Meaning = "mean"

    @property
    def text(self) -> str:
        """One sentence for the user."""
        age = f"{1e3 * self.delay_s:.3g} ms (standard error {1e3 * self.error_s:.2g} ms)"
        if self.meaning == "mean":
            return f"torque is averaged over the period before the sample: it is {age} old"
        if self.meaning == "instant":
            return f"torque is sampled, not averaged: it is {age} old"
        if self.meaning == "late":
            return f"torque is {age} old, more than an average over the period: it is moved back by as much"
        taken, other = "averaged", "instant"
        if self.assumed == "instant":
            taken, other = "sampled, because the driver states how old its torque is", "mean"
        return (
            "the recordings do not show whether torque is averaged over the period or sampled. It is taken as "
            f"{taken}; otherwise give --torque-is {other}: the damping of presliding would be wrong by its stiffness "
            f"times half a period, {0.5 * self.period_s:.3g} s"
        )


def torque_timing(fitter: CandidateFitter, fits: Sequence[Fit]) -> TorqueTiming:
    """Find out how old the torque of the recordings is.

    The records of the fitter can be refined. The fits are to ordinary records; those of dynamic families are used.
    """
    [period_s] = {1.0 / each.rate_hz for each in fitter.data.records[:1]}
    dynamic = sorted((each for each in fits if is_dynamic(each.structure)), key=lambda each: each.held_out.rmse)
    families: dict[str, Fit] = {}
    for each in dynamic:
        if EXTENDS.get(each.structure.family) not in fitter.families:
            families.setdefault(each.structure.family, each)
    assumed: Meaning = "instant" if all(each.is_torque_age_stated for each in fitter.data.records) else "mean"
    unknown = TorqueTiming(math.nan, math.inf, period_s, None, assumed)
    tried = []
    for each in list(families.values())[: th.TRIED]:
        fitter.report(each.label)
        regression = _at(fitter, each, th.FIRST_PERIODS * period_s)
        try:
            estimate = weighted_estimate(regression, each.coordinates, fitter.scales, evaluations=th.TIMING_EVALUATIONS)
        except NUMERICAL:  # this family is refined, or left out with a note, later
            continue
        weighted = estimate.weights * estimate.residual
        tried.append((float(weighted @ weighted / (estimate.weights @ estimate.weights)), each, estimate))
    tried.sort(key=lambda each: each[0])
    found = []
    for cost, fit, estimate in tried:
        if cost > th.AS_GOOD * tried[0][0]:
            break
        try:
            found.append(replace(_timing(fitter, fit, estimate, period_s), assumed=assumed))
        except NUMERICAL:
            continue
    if not found:
        return unknown
    first, *others = found
    is_contradicted = any(each.meaning not in (first.meaning, None) for each in others)
    return replace(first, meaning=None) if is_contradicted else first


def _at(fitter: CandidateFitter, fit: Fit, delay_s: float) -> Regression:
    """Return the regression of a fit with a torque that is taken to be so old."""
    records = [replace(each, is_mean=False, delay_s=delay_s) for each in _fine(fitter)]
    return fitter.fine_regression(fit.structure, fit.mechanics, Data(records))


def _fine(fitter: CandidateFitter) -> list[FineSegment]:
    return [each for each in fitter.fine.records if isinstance(each, FineSegment)]


def _timing(fitter: CandidateFitter, fit: Fit, estimate: Estimate, period_s: float) -> TorqueTiming:
    """Return the age of the torque by one fit, whose estimate at the first delay is given."""
    delay_s = th.FIRST_PERIODS * period_s
    regression = _at(fitter, fit, delay_s)
    steps: list[float] = []
    for _ in range(th.STEPS):
        step, error = _step(regression, estimate, estimate.residual, estimate.weights)
        steps.append(step)
        before, delay_s = delay_s, min(max(delay_s + step, th.EARLIEST * period_s), th.LATEST * period_s)
        if abs(delay_s - before) < th.SETTLED_PERIODS * period_s:
            break
        regression = _at(fitter, fit, delay_s)
        estimate = regression.estimate(
            estimate.coordinates, weights=estimate.weights, evaluations=th.TIMING_EVALUATIONS
        )
    # replicas take the first step only; those that follow it lengthen it as much as they did here
    ratio = sum(steps) / steps[0] if steps[0] != 0.0 else 1.0
    bias, spread = min(max(ratio, 1.0), th.MOST_EXTRAPOLATED) * np.array(_bias(fitter, regression, estimate))
    delay_s -= float(bias)
    error = math.sqrt(error**2 + spread**2 + th.SHIFT_DOUBT * bias**2)
    return TorqueTiming(delay_s, error, period_s, _meaning(delay_s / period_s, error / period_s))


def _meaning(delay: float, error: float) -> Meaning | None:
    """Return what a delay means; delay and standard error in periods."""
    if not error <= th.VAGUE_PERIODS:
        return None
    if abs(delay - _MEAN_PERIODS) <= th.NEAR_PERIODS:
        return "mean"
    if delay > max(th.LATE_PERIODS, _MEAN_PERIODS + th.TIMING_CLEAR * error):
        return "late"
    return "instant" if delay < _MEAN_PERIODS - max(th.TIMING_CLEAR * error, th.NEAR_PERIODS) else None


def _step(regression: Regression, estimate: Estimate, residual: Array, weights: Array) -> tuple[float, float]:
    """Return the change of the delay that fits a residual best, all parameters free, and its standard error, s."""
    torques = torque_at_steps(regression, estimate)
    column = regression.data.stack(
        [-np.gradient(torque) / record.dt for torque, record in zip(torques, regression.data.records, strict=True)]
    )
    jacobian = np.column_stack([estimate.jacobian, column])
    change = scaled_solution(jacobian * weights[:, None], residual * weights, 1e-9)
    after = replace(
        estimate, jacobian=jacobian, names=(*estimate.names, "delay"), residual=residual - jacobian @ change
    )
    errors = infer(after, regression.data.parts, lags=LAG_ROWS).standard_errors
    return float(change[-1]), errors["delay"]


def _bias(fitter: CandidateFitter, regression: Regression, estimate: Estimate) -> tuple[float, float]:
    """Return the mean error of the delay in simulated experiments, and the standard error of that mean and one, s."""
    random = np.random.default_rng(fitter.settings.seed)
    torques, found = sensed(regression, estimate), []
    for _ in range(th.TIMING_REPLICAS):
        data = recounted(regression.data, fitter.data.records, torques, random)
        again = regression.on(data)
        linear = {name: estimate.values[name] for name in again.keys}
        residual = data.torque - again.predict(estimate.coordinates, linear)
        local = replace(estimate, jacobian=again.jacobian(estimate.coordinates, estimate.names))
        found.append(_step(again, local, residual, estimate.weights)[0])
    spread = float(np.std(found, ddof=1))
    return float(np.mean(found)), spread / math.sqrt(len(found))
