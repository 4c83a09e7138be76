"""Reported over commanded torque of a drive, from runs of the same motion with and without a commanded torque.

A drive adds the commanded torque to that of its own loops (60B2h in CSP and CSV), and reports the sum. Below a fiftieth
of the sampling rate the loops are a linear law of the following error e and the demand r, and delays and lags are
Taylor series:

    reported = ratio (c + a1 c' + a2 c'') + b0 e + b1 e' + b2 e'' + b3 (integral of e)
               + d0 r + d1 r' + d2 r'' + constant of the run

Friction, inertia and weight do not occur in it: the equation is that of the drive, whatever it moves. The ratio is told
from the loops because the following error differs between the runs. In CST the command is the whole torque, and there
are no loops to be fitted.

The rounding of the encoder in e, loops that are not linear, and a reported torque that aliases faster oscillations
bias the ratio by up to the fraction of the torque that the equation leaves unexplained; that fraction is part of the
standard error.

Source: W. K. Newey, K. D. West, Econometrica 55, 1987 (standard errors with correlated residuals).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from friction_hil.errors import RecordingError
from friction_hil.identification import thresholds as th
from friction_hil.identification.inference import correlated_square
from friction_hil.identification.torque_lag import evenly
from friction_hil.numerics.jit import Array
from friction_hil.recordings import Recording

_SMALLEST = 1e-9  # relative singular value that counts


@dataclass(frozen=True, slots=True)
class RatioEstimate:
    """Reported over commanded torque."""

    ratio: float
    error: float  # standard error of the ratio; contains ``unexplained``
    unexplained: float  # fraction of the reported torque (RMS) that command and loops leave unexplained


def identify_torque_ratio(recordings: Sequence[Recording], mode: str) -> RatioEstimate:
    """Identify the reported over the commanded torque from runs that differ in the commanded torque.

    The recordings have the rows in which the axis moves, with ``cycle``, ``position``, ``torque``, ``command`` and
    ``position_demand``, SI. ``mode``: ``csp``, ``csv`` or ``cst``.

    Raises `RecordingError`: the recordings are too short, or the commanded torque does not change by itself.
    """
    parts = [_signals(each, has_loops=mode != "cst") for each in recordings]
    torque = np.concatenate([each[0] for each in parts])
    columns = np.concatenate([each[1] for each in parts])
    if len(torque) < th.RATIO_FEWEST_ROWS:
        raise RecordingError(f"{recordings[0].path}: the runs are too short for the ratio of the torques")
    runs = np.repeat(np.arange(len(parts)), [len(each[0]) for each in parts])
    columns = np.column_stack([columns, runs[:, None] == np.arange(len(parts))])
    sizes: Array = np.linalg.norm(columns, axis=0)
    if not sizes[0] > 0.0:
        raise RecordingError(f"{recordings[0].path}: the command does not change")
    columns = columns[:, sizes > 0.0] / sizes[sizes > 0.0]
    others = _basis(columns[:, 1:])
    own = columns[:, 0] - others @ (others.T @ columns[:, 0])
    square = float(own @ own)
    if square < th.LEAST_OWN**2:
        raise RecordingError(f"{recordings[0].path}: the command follows from the motion of the axis")
    factor = float(own @ torque) / square
    left = torque - others @ (others.T @ torque) - factor * own
    total = correlated_square(left * own, th.RATIO_CORRELATED)
    ratio, error = factor / float(sizes[0]), math.sqrt(max(total, 0.0)) / square / float(sizes[0])
    unexplained = float(np.linalg.norm(left)) / max(float(np.linalg.norm(torque)), 1e-300)
    return RatioEstimate(ratio, math.hypot(error, unexplained * max(abs(ratio), 1.0)), unexplained)


def _signals(recording: Recording, *, has_loops: bool) -> tuple[Array, Array]:
    """Return the reported torque (n,) and what explains it (n, m), the command first, in the slow band."""
    from scipy import signal  # imported here: it is slow to load

    period_s = recording.period_s
    names = ["torque", "command", *(["position", "position_demand"] if has_loops else [])]
    columns, is_known = evenly(recording, names)
    rows = len(is_known)
    settling = round(1.0 / th.RATIO_BAND)
    if rows < 4 * settling:
        return np.empty(0), np.empty((0, 10 if has_loops else 3))
    sections = signal.butter(4, 2.0 * th.RATIO_BAND, "lowpass", output="sos")
    unit = 1.0 / (math.tau * th.RATIO_BAND)  # of the derivatives, so that all columns are of similar size

    def slow(values: Array, derivatives: int) -> list[Array]:
        found = [signal.sosfiltfilt(sections, values)]
        for _ in range(derivatives):
            found.append(np.gradient(found[-1]) * unit)
        return found

    explained = slow(columns["command"], 2)
    if has_loops:
        error = columns["position_demand"] - columns["position"]
        explained += [*slow(error, 2), *slow(np.cumsum(error) * period_s, 0), *slow(columns["position_demand"], 2)]
    kept = np.arange(settling, rows - settling, max(round(1.0 / (th.RATIO_ROWS_PER_PERIOD * th.RATIO_BAND)), 1))
    kept = kept[is_known[kept]]
    return slow(columns["torque"], 0)[0][kept], np.column_stack(explained)[kept]


def _basis(columns: Array) -> Array:
    """Return an orthonormal basis of columns, without directions that are only rounding."""
    left, values, _ = np.linalg.svd(columns, full_matrices=False)
    found: Array = left[:, values > _SMALLEST * values[0]]
    return found
