"""Lag of a drive's torque behind the command, from runs whose command is known and rich.

Each command is held for a period. The reported torque is the response to it, through a first-order lag, plus, in CSP
and CSV, that of the drive's own loops to position, velocity and demand. Each recording is filtered by a high-pass, and
in

    torque = gain * (lagged command) + (loops) . (position, velocity, demand at the last samples)

the loops are free coefficients. Position and velocity contain the rounding of the encoder, and so least squares would
put the response to the command into the loops. The commands and demands of the last samples, which that rounding does
not reach, are therefore used as instruments (two-stage least squares). The lag is integrated over its likelihood, from
zero on: where a sample shows no more than that the lag is short, its standard error says so.

Samples show the sum of delay and lag; the delay is taken as known. A lag below a fifth of the period has nearly ended
when the next sample is taken.

Source: T. Söderström, Errors-in-Variables Methods in System Identification, 2018, chapter 6 (instrumental variables);
W. K. Newey, K. D. West, Econometrica 55, 1987 (standard errors with correlated residuals).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from friction_hil.errors import RecordingError
from friction_hil.identification import thresholds as th
from friction_hil.identification.inference import correlated_square
from friction_hil.numerics.jit import Array
from friction_hil.recordings import Recording

_COMMANDS = 16  # samples for which the response to a command is followed
_SMALLEST = 1e-7  # relative singular value that counts


@dataclass(frozen=True, slots=True)
class LagEstimate:
    """Lag of the reported torque behind the command."""

    lag_s: float  # time constant: mean over its likelihood
    error_s: float  # standard error: standard deviation over the likelihood
    most_s: float  # the lag is below this with a probability of 95 %
    longest_s: float  # longest lag that was looked for
    gain: float  # reported torque over commanded torque: 1 if the drive applies the command, and both are scaled alike


def identify_torque_lag(
    recordings: Sequence[Recording], mode: str, delay_s: float, *, is_mean: bool, resolution: float = 0.0
) -> LagEstimate:
    """Identify the lag of the torque from the same motion with and without compensation, or several such motions.

    The recordings have the rows in which the axis moves, with ``cycle``, ``position``, ``torque``, ``command`` and the
    demand, SI. ``mode``: ``csp``, ``csv`` or ``cst``. ``delay_s``: from the sample of a row until its command is in
    force. ``is_mean``: the reported torque is a mean over the period before the sample; False: that of the instant.
    ``resolution``: step to which commanded and reported torque are rounded; in CST, where nothing else moves the torque
    between the steps, rounding hides a part of the lag: what it hides in a simulation of the result is added again, and
    counts as an error.

    Raises `RecordingError`: the recordings are too short, or the command hardly changes.
    """
    found = _identified(recordings, mode, delay_s, is_mean=is_mean)
    if mode != "cst" or not resolution > 0.0:
        return found
    period_s = recordings[0].period_s
    response = lag_response(found.lag_s / period_s, delay_s / period_s, is_mean=is_mean)
    again = _identified([_rounded(each, response, resolution) for each in recordings], mode, delay_s, is_mean=is_mean)
    hidden_s = found.lag_s - again.lag_s
    return replace(
        found,
        lag_s=max(found.lag_s + hidden_s, 0.0),
        error_s=math.hypot(found.error_s, hidden_s),
        most_s=found.most_s + 2.0 * abs(hidden_s),
    )


def _rounded(recording: Recording, response: Array, resolution: float) -> Recording:
    """Return a recording whose torque is the response to the command, both rounded."""
    command = resolution * np.round(recording["command"] / resolution)
    torque = sum((part * _delayed(command, k) for k, part in enumerate(response)), np.zeros(len(command)))
    return replace(recording, columns={**recording.columns, "torque": resolution * np.round(torque / resolution)})


def _identified(recordings: Sequence[Recording], mode: str, delay_s: float, *, is_mean: bool) -> LagEstimate:
    period_s = recordings[0].period_s
    parts = [_signals(recording, mode, period_s) for recording in recordings]
    torque, commands, loops, demands = (np.concatenate(each) for each in zip(*parts, strict=True))
    if len(torque) < th.LAG_FEWEST_ROWS:
        raise RecordingError(f"{recordings[0].path}: {len(torque)} rows are too few for the lag of the torque")
    if not np.all(np.linalg.norm(commands, axis=0) > 0.0):
        raise RecordingError(f"{recordings[0].path}: the command does not change")
    try:
        return _Likelihood(torque, commands, loops, demands, delay_s / period_s, is_mean=is_mean).estimate(period_s)
    except np.linalg.LinAlgError as error:
        raise RecordingError(f"{recordings[0].path}: the lag of the torque cannot be computed: {error}") from None


def lag_response(lag: float, delay: float, *, is_mean: bool) -> Array:
    """Return how much of each command there is in a torque sample: step response of a first-order lag, differenced.

    Returns (17,), for the command of the same row, of the row before, and so on; their sum approaches 1. ``lag``: time
    constant, and ``delay``: from the sample of a row until its command is in force, for a period; both in periods.
    ``is_mean``: the torque is the mean over the period before the sample.
    """
    ages = np.arange(-2.0, _COMMANDS + 1.0) - delay
    if is_mean:  # of the step response over the period before the sample: difference of its integral
        steps = np.diff(_step_integral(ages, lag))
    else:
        passed = np.maximum(ages[1:], 0.0)
        steps = np.where(ages[1:] > 0.0, -np.expm1(-passed / lag) if lag > 0.0 else 1.0, 0.0)
    return np.diff(steps)


def _step_integral(ages: Array, lag: float) -> Array:
    passed = np.maximum(ages, 0.0)
    return passed + lag * np.expm1(-passed / lag) if lag > 0.0 else passed


class _Likelihood:
    """Residual of the equation over the lag, with all other unknowns at their best.

    All signals are projected on the instruments once, so that a lag costs a few hundred operations.
    """

    def __init__(
        self, torque: Array, commands: Array, loops: Array, demands: Array, delay: float, *, is_mean: bool
    ) -> None:
        self._torque, self._commands, self._delay, self._is_mean = torque, commands, delay, is_mean
        own = np.column_stack([loops, demands])
        self._own = own / np.maximum(np.linalg.norm(own, axis=0), 1e-300)
        self._basis = _basis(np.column_stack([commands, demands]))
        left, right, own = (self._basis.T @ each for each in (torque, commands, self._own))
        self._seen = left, right, own
        free = _basis(own)
        self._left = left - free @ (free.T @ left)
        self._right = right - free @ (free.T @ right)
        # equations beyond the unknowns: lag, gain and the coefficients of the loops
        self._spare = max(self._basis.shape[1] - free.shape[1] - 2, 1)

    def estimate(self, period_s: float) -> LagEstimate:
        """Return the lag; the grid is narrowed to what the likelihood does not rule out."""
        grid = np.linspace(0.0, th.LONGEST, th.LAG_GRID)
        for _ in range(th.LAG_ROUNDS):
            costs, gains = (np.array(each) for each in zip(*map(self._cost, grid), strict=True))
            best = int(np.argmin(costs))
            variance = self._variance(grid, best, float(gains[best]), float(costs[best]))
            logs = (costs[best] - costs) / (2.0 * variance)
            kept = np.flatnonzero(logs > -th.KEPT)
            lowest, highest = grid[max(kept[0] - 1, 0)], grid[min(kept[-1] + 1, len(grid) - 1)]
            if len(kept) >= th.ENOUGH_INSIDE:
                break
            grid = np.linspace(lowest, highest, th.LAG_GRID)
        weights = np.exp(logs)
        weights /= weights.sum()
        mean = float(weights @ grid)
        error = math.sqrt(float(weights @ (grid - mean) ** 2))
        most = float(grid[min(int(np.searchsorted(np.cumsum(weights), th.UPPER)), len(grid) - 1)])
        return LagEstimate(
            mean * period_s, error * period_s, most * period_s, th.LONGEST * period_s, float(gains[best])
        )

    def _response(self, lag: float) -> Array:
        return lag_response(lag, self._delay, is_mean=self._is_mean)

    def _cost(self, lag: float) -> tuple[float, float]:
        """Return the square of the projected residual, and the gain of the command."""
        column = self._right @ self._response(lag)
        gain = float(column @ self._left) / max(float(column @ column), 1e-300)
        residual = self._left - gain * column
        return float(residual @ residual), gain

    def _variance(self, grid: Array, best: int, gain: float, cost: float) -> float:
        """Return the variance of the residual as it counts for the lag.

        It is raised where residuals are correlated, and where the instruments contradict each other.
        """
        left, right, own = self._seen
        response = self._response(float(grid[best]))
        factors = np.linalg.lstsq(own, left - gain * (right @ response), rcond=_SMALLEST)[0]
        residual = self._torque - gain * (self._commands @ response) - self._own @ factors
        variance = max(float(residual @ residual) / len(residual), 1e-300)
        beside = (grid[min(best + 1, len(grid) - 1)], grid[max(best - 1, 0)])
        direction = self._right @ (self._response(float(beside[0])) - self._response(float(beside[1])))
        size = float(direction @ direction)
        if size > 0.0:
            score = residual * (self._basis @ direction)
            variance = max(variance, correlated_square(score, th.LAG_CORRELATED) / size)
        return float(max(variance, cost / self._spare))


def _basis(columns: Array) -> Array:
    """Return an orthonormal basis of columns (n, m), without directions that are only rounding."""
    if not columns.shape[1]:
        return np.zeros((len(columns), 0))
    scaled = columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    left, values, _ = np.linalg.svd(scaled, full_matrices=False)
    found: Array = left[:, values > _SMALLEST * values[0]]
    return found


def _signals(recording: Recording, mode: str, period_s: float) -> tuple[Array, Array, Array, Array]:
    """Return torque (n,), commands (n, 17), what the loops use, and demands of a recording, filtered."""
    names = ["position", "torque", "command"]
    loops: list[Array] = []
    demands: list[Array] = []
    if mode != "cst":
        names += ["position_demand", *(["velocity"] if "velocity" in recording else [])]
    columns, is_known = evenly(recording, names)
    position, torque, command = (columns[name] for name in names[:3])
    commands = [_delayed(command, k) for k in range(_COMMANDS + 1)]
    if mode != "cst":
        demand = columns["position_demand"]
        loops = [_delayed(position, k) for k in range(th.POSITIONS)]
        if "velocity" in columns:
            loops += [_delayed(columns["velocity"], k) for k in range(th.LAG_VELOCITIES)]
        loops.append(np.cumsum(demand - position) * period_s)
        demands = [_delayed(demand, k) for k in th.DEMANDS]
        demands.append(np.cumsum(demand - demand[0]) * period_s)
    left, right, own, asked = (
        _filtered(group, len(torque))[is_known] for group in ([torque], commands, loops, demands)
    )
    return left[:, 0], right, own, asked


def evenly(recording: Recording, names: Sequence[str]) -> tuple[dict[str, Array], NDArray[np.bool_]]:
    """Return columns on all cycles, missing ones interpolated, and which rows no missing one has reached."""
    cycle = np.round(recording["cycle"]).astype(np.intp)
    every = np.arange(cycle[0], cycle[-1] + 1)
    is_there = np.isin(every, cycle)
    is_good = np.ones(len(cycle), dtype=bool)
    for name in names:
        is_good &= np.isfinite(recording[name])
    if "is_fresh" in recording:
        is_good &= recording["is_fresh"] > 0.0
    if not is_good.any():
        raise RecordingError(f"{recording.path}: {recording.axis}: no row has all of {', '.join(names)}")
    columns = {name: np.interp(every, cycle[is_good], recording[name][is_good]) for name in names}
    is_bad = ~is_there
    is_bad[np.searchsorted(every, cycle[~is_good])] = True
    is_bad[0] = True  # the high-pass begins
    reached = np.convolve(is_bad, np.ones(th.EDGE_PERIODS + 1))[: len(every)] > 0.5
    reached |= np.convolve(is_bad[1:], np.ones(3), "full")[1 : len(every) + 1] > 0.5  # later demands
    return columns, ~reached


def _delayed(values: Array, periods: int) -> Array:
    """Return the values of so many rows ago; later ones for a negative number."""
    found = np.roll(values, periods)
    if periods > 0:
        found[:periods] = values[0]
    elif periods < 0:
        found[periods:] = values[-1]
    return found


def _filtered(columns: Sequence[Array], rows: int) -> Array:
    from scipy import signal  # imported here: it is slow to load

    if not columns:
        return np.zeros((rows, 0))
    sections = signal.butter(2, 2.0 * th.HIGHPASS, "highpass", output="sos")
    found: Array = signal.sosfilt(sections, np.column_stack([each - each[0] for each in columns]), axis=0)
    return found
