"""CUSUM charts with a stated rate of false alarms. Pure.

The first observations are the baseline. They give the value at their mean temperature, the coefficient of temperature,
the scatter and its correlation. Of every later observation, what the baseline predicts for its temperature is
subtracted, and the rest is added up in two sums, one for each sign (Page 1954):

    sum = max(0, sum + rest / scatter - allowance)

An alarm is given where a sum exceeds a threshold, by which the mean time between false alarms is as stated (Siegmund
1985). What the baseline does not know exactly would be added up as if it were a change. So twice the standard error of
the prediction is added to the allowance, and the scatter is the one that it does not exceed with a probability of 90 %.
Correlation of successive observations, of first order, enlarges the scatter to that of long sums.

Sources: E. S. Page, Biometrika 41, 1954; D. Siegmund, Sequential Analysis, Springer 1985, equation 2.57 with the
correction of 1.166; J. M. Lucas, R. B. Crosier, Technometrics 24(3), 1982 (outliers); L. A. Jones, C. W. Champ,
S. E. Rigdon, Technometrics 46(3), 2004 (why an estimated baseline needs care).
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from friction_hil.health import thresholds as th
from friction_hil.numerics.jit import Array

_OVERSHOOT = 1.166  # of the threshold, in discrete time
_NORMAL_90 = 1.2816
_LEAST_SCATTER = 1e-150  # where all observations are equal, as no measurement is


@dataclass(frozen=True, slots=True, eq=False)
class Baseline:
    """What the first observations show."""

    value: float  # at ``temperature``
    error: float  # standard error of the value
    temperature: float | None  # mean, °C; None: temperature is not removed
    slope: float  # per K; 0 without temperature
    slope_error: float  # as the slope
    scatter: float  # standard deviation of one observation about the baseline, with its own uncertainty
    correlation: float  # of successive observations, from 0
    mean_error: float  # standard error that the observations themselves state, root of the mean square
    inverse: Array  # (p, p), of the normal matrix

    @property
    def inflation(self) -> float:
        """Standard deviation of long sums over that of independent observations."""
        return math.sqrt((1.0 + self.correlation) / (1.0 - self.correlation))

    def predict(self, temperatures: Array) -> tuple[Array, Array]:
        """Return the prediction (n,) for temperatures (n,), and its standard error over the scatter."""
        rows = _design(temperatures, self.temperature)
        value = self.value + (self.slope * rows[:, 1] if rows.shape[1] > 1 else 0.0)
        leverage = np.sqrt(np.einsum("ij,jk,ik->i", rows, self.inverse, rows))
        return np.broadcast_to(value, temperatures.shape).astype(float), leverage

    def scatters(self, errors: Array) -> Array:
        """Return the standard deviation (n,) of observations with these standard errors, at least that of the baseline.

        Observations that are less exact than those of the baseline count less.
        """
        return np.sqrt(self.scatter**2 + np.maximum(errors**2 - self.mean_error**2, 0.0))


@dataclass(frozen=True, slots=True, eq=False)
class Chart:
    """Sums of the observations after the baseline."""

    rest: Array  # (n,), observations less their prediction
    upper: Array  # (n,), sums for a rise, standard deviations
    lower: Array  # (n,), sums for a fall, standard deviations
    threshold: float
    sign: int  # 1: risen, -1: fallen, 0: no alarm at the end
    begin: int  # first observation after the most likely step before the alarm; n without an alarm
    alarm: int  # observation at which the alarm was given; n without an alarm
    change: float  # mean change since ``begin``; 0 without an alarm
    change_error: float  # as the change


def average_run_length(threshold: float) -> float:
    """Return the mean number of observations until a one-sided sum gives a false alarm (Siegmund 1985)."""
    b = 2.0 * th.ALLOWANCE * (threshold + _OVERSHOOT)
    return (math.exp(b) - b - 1.0) / (2.0 * th.ALLOWANCE**2)


def threshold_for(run_length: float) -> float:
    """Return the threshold of a one-sided sum with this mean number of observations between false alarms."""
    if not 1.0 < run_length < math.inf:
        raise ValueError(f"a run length is a number above 1, not {run_length:g}")
    from scipy.optimize import bisect  # imported here: commands that do not need it start faster

    wanted = max(run_length, average_run_length(0.0))
    return float(bisect(lambda each: average_run_length(each) - wanted, 0.0, 2.0 + math.log(2.0 + run_length)))


def fit_baseline(values: Array, errors: Array, temperatures: Array | None) -> Baseline:
    """Learn a baseline from observations and their standard errors, (n,) each, `th.LEAST_BASELINE` or more.

    ``temperatures``: (n,), °C; None if temperature is not to be removed.
    """
    n = len(values)
    if n < th.LEAST_BASELINE:
        raise ValueError(f"{n} observations are too few for a baseline, which needs {th.LEAST_BASELINE}")
    has_slope = temperatures is not None and float(np.std(temperatures)) >= th.LEAST_SPREAD_K
    centre = float(np.mean(temperatures)) if has_slope and temperatures is not None else None
    rows = _design(np.zeros(n) if temperatures is None else temperatures, centre)
    inverse = np.asarray(np.linalg.inv(rows.T @ rows), dtype=np.float64)
    factors = inverse @ rows.T @ values
    residual = values - rows @ factors
    freedom = n - rows.shape[1]
    correlation = _correlation(residual)
    variance = float(residual @ residual) / freedom
    # the chi-squared distribution: E. B. Wilson, M. M. Hilferty, PNAS 17, 1931
    least = (1.0 - 2.0 / (9.0 * freedom) - _NORMAL_90 * math.sqrt(2.0 / (9.0 * freedom))) ** 3
    mean_error = float(np.sqrt(np.mean(errors**2)))
    scatter = max(math.sqrt(variance / least), mean_error, _LEAST_SCATTER)
    inflation = math.sqrt((1.0 + correlation) / (1.0 - correlation))
    doubts = scatter * inflation * np.sqrt(np.diag(inverse))
    slope, slope_error = (float(factors[1]), float(doubts[1])) if has_slope else (0.0, 0.0)
    return Baseline(
        value=float(factors[0]),
        error=float(doubts[0]),
        temperature=centre,
        slope=slope,
        slope_error=slope_error,
        scatter=scatter,
        correlation=correlation,
        mean_error=mean_error,
        inverse=inverse,
    )


def draw_chart(baseline: Baseline, values: Array, errors: Array, temperatures: Array, threshold: float) -> Chart:
    """Add up the observations (n,) after the baseline; ``temperatures`` are not used if the baseline has none."""
    predicted, leverage = baseline.predict(temperatures)
    rest = values - predicted
    scatters = baseline.scatters(errors) * baseline.inflation
    doubt = th.PREDICTION * leverage * baseline.scatter * baseline.inflation / scatters
    steps = np.clip(rest / scatters, -th.LARGEST_REST - doubt, th.LARGEST_REST + doubt)
    upper, rise = _sum(steps - doubt - th.ALLOWANCE, th.HIGHEST * threshold)
    lower, fall = _sum(-steps - doubt - th.ALLOWANCE, th.HIGHEST * threshold)
    n = len(values)
    for sign, sums, begins in ((1, upper, rise), (-1, lower, fall)):
        if n and sums[-1] > threshold:
            begin = int(begins[-1])
            alarm = begin + int(np.argmax(sums[begin:] > threshold))
            # the sum may begin with noise before the change: the most likely step up to the alarm is reported
            evidence = np.cumsum(steps[begin:][::-1])[::-1] * sign / np.sqrt(np.arange(n - begin, 0, -1))
            begin += int(np.argmax(evidence[: alarm - begin + 1]))
            late = slice(begin, None)
            weights = scatters[late] ** -2.0
            weights /= weights.sum()
            own = float(np.sqrt(np.sum((weights * scatters[late]) ** 2)))
            shared = float(weights @ leverage[late]) * baseline.scatter * baseline.inflation
            change = float(weights @ rest[late])
            return Chart(rest, upper, lower, threshold, sign, begin, alarm, change, math.hypot(own, shared))
    return Chart(rest, upper, lower, threshold, 0, n, n, 0.0, 0.0)


def _sum(steps: Array, highest: float) -> tuple[Array, NDArray[np.intp]]:
    """Return the sums after each step, and the step with which each of them began."""
    sums, begins = np.zeros(len(steps)), np.zeros(len(steps), dtype=np.intp)
    total, begin = 0.0, 0
    for i, step in enumerate(steps.tolist()):
        if total == 0.0:
            begin = i
        total = min(max(0.0, total + step), highest)
        sums[i], begins[i] = total, begin
    return sums, begins


def _design(temperatures: Array, centre: float | None) -> Array:
    ones = np.ones((len(temperatures), 1))
    return ones if centre is None else np.column_stack([ones, temperatures - centre])


def _correlation(residual: Array) -> float:
    """Return the correlation of successive residuals, corrected for its bias: F. H. C. Marriott, J. A. Pope 1954."""
    power = float(residual @ residual)
    if power <= 0.0:
        return 0.0
    found = float(residual[1:] @ residual[:-1]) / power
    return min(max(found + (1.0 + 4.0 * found) / len(residual), 0.0), th.MOST_CORRELATION)
