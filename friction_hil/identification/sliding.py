"""Rows in which an axis slides, friction there as any curve of the velocity, and mechanics beside it. Pure.

    torque = inertia a + sine sin q + cosine cos q + friction(v)

is linear if ``friction`` is a piecewise linear curve of the velocity, one for each direction. It needs no model of
presliding, because rows in which bristles may still turn do not count: there the torque is that of a spring, which
hides gravity and inertia from a fit of Coulomb friction to all rows. Both sides pass a low-pass far below the
resonances of usual axes: after each reversal the load swings on its coupling, and near its anti-resonance the motor
accelerates much under little torque, so that a fit of all frequencies takes the axis for too light.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from friction_hil.identification import thresholds as th
from friction_hil.identification.compliance import sandwich
from friction_hil.identification.data import RegressionSegment, moved_since_reversal
from friction_hil.numerics import filtering
from friction_hil.numerics.jit import Array
from friction_hil.recordings.quality import acceleration_noise

LOW_HZ = 12.0  # of the low-pass: the load follows the motor as one mass
WIDE_HZ = 100.0


@dataclass(frozen=True, slots=True, eq=False)
class SlidingRows:
    """Rows of one record in which the axis slides, behind a low-pass."""

    record: RegressionSegment
    low_hz: float  # cut-off of the low-pass
    rows: NDArray[np.intp]  # at the full rate

    def compared(self, values: Array) -> Array:
        """Low-pass values (n,) or (n, m), and return the rows."""
        return np.ascontiguousarray(self.low(values)[self.rows])

    def low(self, values: Array) -> Array:
        """Low-pass values (n,) or (n, m)."""
        return filtering.lowpass(values, self.low_hz, self.record.rate_hz)

    @property
    def torque(self) -> Array:
        """Measured torque (k,)."""
        return self.compared(self.record.torque)

    def friction(self, top: float) -> Array:
        """Return hat functions (n, m) of the speed in either direction, up to the speed ``top``."""
        velocity = self.record.velocity
        speeds = np.geomspace(th.SLIDING_SLOW * top, top, th.SLIDING_KNOTS)
        hats = [np.interp(np.abs(velocity), speeds, each) for each in np.eye(th.SLIDING_KNOTS)]
        return np.column_stack([side * hat * (side * velocity > 0.0) for hat in hats for side in (1.0, -1.0)])


def sliding_rows(records: Sequence[RegressionSegment], low_hz: float = LOW_HZ) -> list[SlidingRows]:
    """Return the rows of each record in which the axis has slid for a while; none if there are too few in all."""
    top = top_speed(records)
    travel = max(float(np.ptp(each.position)) for each in records)
    found = []
    for each in records:
        cut = min(low_hz, th.SLIDING_BAND * each.rate_hz)
        rows = _rows(each, cut, th.SLIDING_SLOW * top, th.SLIDING_MOVED * travel)
        if len(rows):
            found.append(SlidingRows(each, cut, rows))
    return found if sum(len(each.rows) for each in found) >= th.SLIDING_LEAST_ROWS else []


def top_speed(records: Sequence[RegressionSegment]) -> float:
    """Return the highest speed of records."""
    return max(float(np.max(np.abs(each.velocity), initial=0.0)) for each in records)


def _rows(record: RegressionSegment, cut: float, least: float, distance: float) -> NDArray[np.intp]:
    from scipy.ndimage import maximum_filter1d  # imported here: commands start faster without it

    rate, velocity = record.rate_hz, record.velocity
    edge = filtering.settling_samples(cut, rate)
    if len(velocity) <= max(2 * edge, filtering.lowpass_padding()):
        return np.zeros(0, dtype=np.intp)
    reach = max(1, round(th.TURNED_S * rate), round(0.5 * rate / cut))
    is_slow = (np.abs(velocity) < least) | (velocity * np.roll(velocity, 1) < 0.0)
    rests = maximum_filter1d(is_slow.astype(np.uint8), 2 * reach + 1) > 0
    counts = ~rests & (moved_since_reversal(velocity, record.position) >= distance)
    rows = record.kept_rows(np.arange(len(velocity)))
    rows = rows if record.is_moving is None else rows[record.is_moving]
    rows = rows[(rows >= edge) & (rows < len(velocity) - edge)]
    every = max(1, int(rate / (th.SLIDING_ROWS_PER_PERIOD * cut * record.decimation)))
    return np.asarray(rows[counts[rows]][::every], dtype=np.intp)


def compared(parts: Sequence[SlidingRows], columns: Sequence[Array]) -> Array:
    """Return the compared rows (k, m) of columns (n, m) of each part."""
    return np.concatenate([part.compared(each) for part, each in zip(parts, columns, strict=True)])


def fitted(parts: Sequence[SlidingRows], matrix: Array) -> tuple[Array, Array, Array, NDArray[np.intp]]:
    """Fit columns (k, m), as of `compared`, to the torque.

    Returns the factors (m,), 0 for a column that is zero in all rows; their covariance (m, m), for residuals that are
    correlated within a stretch of time; the residual (k,) of all parts; and the first row of each stretch of time.
    """
    torque = np.concatenate([part.torque for part in parts])
    norms = np.linalg.norm(matrix, axis=0)
    norms[norms == 0.0] = 1.0
    factors = np.linalg.lstsq(matrix / norms, torque, rcond=1e-9)[0] / norms
    residual = torque - matrix @ factors
    starts, begin = [], 0
    for part in parts:
        stretch = np.floor(part.rows / max(1.0, th.SLIDING_STRETCH_S * part.record.rate_hz))
        starts.append(begin + np.flatnonzero(np.diff(stretch, prepend=np.nan)))
        begin += len(stretch)
    all_starts: NDArray[np.intp] = np.concatenate(starts).astype(np.intp)
    return factors, sandwich(matrix / norms, residual, all_starts) / np.outer(norms, norms), residual, all_starts


@dataclass(frozen=True, slots=True)
class SlidingMechanics:
    """Inertia and gravity where the axis slides."""

    inertia: float  # kg m^2 or kg
    inertia_error: float  # standard error
    sine: float  # of gravity, N m; 0 if not fitted
    cosine: float  # of gravity, N m; 0 if not fitted
    has_swing: bool  # this gravity is many standard errors above zero, and no small part of the torque
    noise: float  # part of the variance of the acceleration that counts of the encoder make, which hides inertia

    def differs(self, other: "SlidingMechanics") -> bool:
        """True if a wider band of frequencies shows another inertia: then the load swings on a coupling.

        Noise in the acceleration makes an inertia smaller by its part of the variance (errors in variables): so much of
        a difference says nothing of the axis.
        """
        difference = abs(self.inertia - other.inertia) - other.noise * self.inertia
        doubt = math.hypot(self.inertia_error, other.inertia_error)
        is_known = 0.0 < self.inertia_error < th.SLIDING_KNOWN * self.inertia
        return is_known and difference > max(th.SWUNG * self.inertia, th.SWUNG_ERRORS * doubt)


def sliding_mechanics(
    records: Sequence[RegressionSegment], *, can_swing: bool, low_hz: float = LOW_HZ
) -> SlidingMechanics | None:
    """Find inertia and, if ``can_swing``, gravity as sine and cosine; None if the axis slides in too few rows."""
    parts, top = sliding_rows(records, low_hz), top_speed(records)
    if not parts:
        return None
    waves = (np.sin, np.cos) if can_swing else ()
    columns = [
        np.column_stack([each.record.acceleration, *(wave(each.record.position) for wave in waves), each.friction(top)])
        for each in parts
    ]
    matrix = compared(parts, columns)
    factors, covariance, _, _ = fitted(parts, matrix)
    error, noise = math.sqrt(max(float(covariance[0, 0]), 0.0)), _noise_share(parts, matrix)
    if not can_swing:
        return SlidingMechanics(float(factors[0]), error, 0.0, 0.0, has_swing=False, noise=noise)
    pair, doubt = factors[1:3], covariance[1:3, 1:3]
    wald = float(pair @ np.linalg.pinv(doubt, hermitian=True) @ pair)
    torque = np.concatenate([part.torque for part in parts])
    is_felt = float(np.std(matrix[:, 1:3] @ pair)) > th.SLIDING_FELT * float(np.sqrt(np.mean(torque**2)))
    return SlidingMechanics(
        float(factors[0]),
        error,
        float(pair[0]),
        float(pair[1]),
        has_swing=is_felt and wald > th.SLIDING_CLEAR**2,
        noise=noise,
    )


def _noise_share(parts: Sequence[SlidingRows], matrix: Array) -> float:
    """Return the part of the variance of the acceleration, column 0, beside the others, that the counts make."""
    others = matrix[:, 1:] / np.maximum(np.linalg.norm(matrix[:, 1:], axis=0), np.finfo(float).tiny)
    seen = matrix[:, 0] - others @ np.linalg.lstsq(others, matrix[:, 0], rcond=1e-9)[0]
    made = 0.0
    for part in parts:
        cut_hz, step = min(part.low_hz, part.record.lowpass_hz or math.inf), part.record.resolution or 0.0
        made += len(part.rows) * acceleration_noise(step, cut_hz, part.record.rate_hz) ** 2
    return min(1.0, made / float(seen @ seen)) if np.any(seen) else 1.0
