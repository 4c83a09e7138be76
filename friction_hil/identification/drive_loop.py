"""Control loops of a drive, identified from a recorded motion: what its torque makes of the following error.

A drive in CSP or CSV has loops of its own. Of the usual cascade, P for the position and PI for the velocity with
feed-forward (`friction_hil.motion.controller`), the torque is linear in signals of the recording. In CSP

    tau = b de/dt + b (k_p + w) e + b k_p w I(e) + J_f dv_d/dt + b (f - 1) (v_d + w q_d),

with the following error e, its integral I(e), the gains b of the velocity and k_p of the position loop, the corner w
of the integral part and the feed-forward f of the velocity. Both sides pass the same band-pass and, the right side, the
lag of the torque. The law has no noise of its own, so that least squares are consistent in the closed loop too, except
for the rounding of the encoder, whose known covariance is subtracted.

Source: bias-eliminated least squares, T. Söderström, Errors-in-Variables Methods in System Identification, 2018,
chapter 5.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from friction_hil.errors import RecordingError
from friction_hil.identification import thresholds as th
from friction_hil.numerics.jit import Array
from friction_hil.recordings import Recording


@dataclass(frozen=True, slots=True)
class DriveLoops:
    """Identified loops of a drive, SI of the axis."""

    position_gain: float  # 1/s; 0 for a velocity loop alone
    velocity_gain: float  # N m s/rad or N s/m
    integral_hz: float  # corner frequency of the velocity loop's integral part
    velocity_feedforward: float  # of the demanded velocity; 1: full
    inertia: float  # feed-forward torque over demanded acceleration, kg m^2 or kg
    torque_lag_s: float  # time constant between the torque that the law demands and the reported torque
    explained: float  # part of the torque's energy in the band that this law explains


@dataclass(frozen=True, slots=True, eq=False)
class _Law:
    """Factors of the columns of a law, with their standard errors, the lag of the torque and the explained part."""

    factors: Array
    errors: Array
    lag_s: float
    explained: float


def identify_loops(recording: Recording, mode: str, resolution: float, own_position_gain: float = 0.0) -> DriveLoops:
    """Identify the loops of a drive from rows of an uncompensated motion.

    The recording has ``position``, ``position_demand``, ``velocity_demand`` and ``torque`` at an even rate. ``mode``:
    ``csp`` or ``csv``. ``resolution``: step of the position, SI. ``own_position_gain``, in ``csv``: gain of the
    daemon's position loop, which is part of the velocity target, 1/s.

    Raises `RecordingError`: the recording is too short, or its torque does not follow such a law.
    """
    names = ("position", "position_demand", "velocity_demand", "torque")
    position, demand, velocity, torque = (np.asarray(recording[name], dtype=np.float64) for name in names)
    is_finite = all(bool(np.all(np.isfinite(each))) for each in (position, demand, velocity, torque))
    if len(torque) * recording.period_s < th.LOOPS_LEAST_S or not is_finite:
        raise _unknown(recording, f"needs {th.LOOPS_LEAST_S:g} s without a gap")
    if mode == "csv":
        law = _fit_law(recording, resolution, _velocity_columns(own_position_gain))
        gain, integral, inertia = law.factors
        loops = DriveLoops(0.0, gain, integral / gain / math.tau, 1.0, inertia, law.lag_s, law.explained)
    else:
        loops = _cascade(_fit_law(recording, resolution, _position_columns(has_full_feedforward=False)))
        if abs(loops.velocity_feedforward - 1.0) < th.FEEDFORWARD_ERROR:
            loops = _cascade(_fit_law(recording, resolution, _position_columns(has_full_feedforward=True)))
    if not (loops.explained >= th.LEAST_EXPLAINED and loops.velocity_gain > 0.0 and loops.position_gain >= 0.0):
        raise _unknown(
            recording,
            f"the usual cascade of gains explains {loops.explained:.0%} of the torque, and {th.LEAST_EXPLAINED:.0%} "
            "would be the least",
        )
    return loops


def _unknown(recording: Recording, reason: str) -> RecordingError:
    return RecordingError(f"{recording.path}: {recording.axis}: the loops of the drive are not identified: {reason}")


_Columns = Callable[[Array, Array, Array, float], Array]


def _position_columns(*, has_full_feedforward: bool) -> _Columns:
    """Return a function of error, position and velocity demand and period that gives the columns of CSP."""

    def columns(error: Array, demand: Array, velocity: Array, period_s: float) -> Array:
        own = [np.gradient(error, period_s), error, np.cumsum(error) * period_s, np.gradient(velocity, period_s)]
        return np.column_stack(own if has_full_feedforward else [*own, velocity, demand])

    return columns


def _velocity_columns(own_gain: float) -> _Columns:
    """Return the function for CSV, where the daemon's position loop is part of the demanded velocity."""

    def columns(error: Array, _: Array, velocity: Array, period_s: float) -> Array:
        # in force from the second period after the sample on, and interpolated until then
        late = own_gain * np.concatenate([np.zeros(2), error[:-2]])
        return np.column_stack(
            [
                np.gradient(error, period_s) + late,
                error + np.cumsum(late) * period_s,
                np.gradient(velocity + late, period_s),
            ]
        )

    return columns


def _cascade(law: _Law) -> DriveLoops:
    """Return the gains of the cascade in CSP. Which corner is the position loop's makes no difference to the torque."""
    gain, proportional, integral, inertia, *feedforward = law.factors
    total, product = proportional / gain, integral / gain
    root = math.sqrt(max(0.25 * total * total - product, 0.0))
    position_gain, corner = 0.5 * total + root, max(0.5 * total - root, 0.0)
    fraction = 1.0 + feedforward[0] / gain if feedforward else 1.0
    return DriveLoops(position_gain, gain, corner / math.tau, fraction, inertia, law.lag_s, law.explained)


def _fit_law(recording: Recording, resolution: float, columns: _Columns) -> _Law:
    """Fit a law in several bands and with several lags; return the one with the most certain velocity gain."""
    period_s = recording.period_s
    demand, velocity, torque = (recording[name] for name in ("position_demand", "velocity_demand", "torque"))
    right = columns(demand - recording["position"], demand - demand[0], velocity, period_s)
    still = np.zeros(len(torque))
    impulse = still.copy()
    impulse[len(impulse) // 2] = 1.0
    rounding = columns(impulse, still, still, period_s) * resolution * math.sqrt(len(torque) / 12.0)
    edge = round(th.LOOPS_EDGE_S / period_s)
    found = []
    for band in th.LOOPS_BANDS:
        left, filtered, noise = (
            _filtered(each, band / period_s, period_s) for each in (torque[:, None], right, rounding)
        )
        fits = [
            _least_squares(
                left[edge:, 0],
                _lagged(filtered, lag_s, period_s)[edge:],
                _lagged(noise, lag_s, period_s)[edge:],
                lag_s,
            )
            for lag_s in th.LAGS_S
        ]
        found.append(max(fits, key=lambda fit: fit.explained))
    return min(found, key=lambda fit: float(fit.errors[0] / abs(fit.factors[0])))


def _filtered(values: Array, highest_hz: float, period_s: float) -> Array:
    from scipy import signal  # imported here: it is slow to load

    sections = signal.butter(2, [th.LOWEST_HZ, highest_hz], "bandpass", fs=1.0 / period_s, output="sos")
    found: Array = signal.sosfilt(sections, values, axis=0)
    return found


def _lagged(values: Array, lag_s: float, period_s: float) -> Array:
    """Filter with 1 / (1 + s lag), discretised by the trapezoidal rule."""
    from scipy import signal

    lag = 2.0 * lag_s / period_s
    found: Array = signal.lfilter([1.0, 1.0], [1.0 + lag, 1.0 - lag], values, axis=0)
    return found


def _least_squares(left: Array, right: Array, rounding: Array, lag_s: float) -> _Law:
    """Return the factors of ``right`` (n, m) that give ``left`` (n,), without the bias by the rounding of positions."""
    bias = rounding.T @ rounding
    normal = right.T @ right - bias
    scale = np.sqrt(np.diag(right.T @ right))
    scale[scale == 0.0] = 1.0
    inverse = np.linalg.pinv(normal / np.outer(scale, scale)) / np.outer(scale, scale)
    factors = inverse @ (right.T @ left)
    residual = left - right @ factors
    variance = float(residual @ residual) / len(left)
    unexplained = float(residual @ residual - factors @ bias @ factors) / max(float(left @ left), 1e-300)
    errors = np.sqrt(np.maximum(np.diag(inverse), 0.0) * variance)
    return _Law(factors, errors, lag_s, 1.0 - unexplained)
