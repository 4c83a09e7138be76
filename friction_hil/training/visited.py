"""Speeds that recordings visit and the encoder resolves: below, a network beside a physical model fades out."""

import math
from collections.abc import Sequence

import numpy as np

from friction_hil.identification.data import RegressionSegment
from friction_hil.numerics.jit import Array
from friction_hil.recordings.quality import resolution
from friction_hil.training import thresholds as th


def least_speed(records: Sequence[RegressionSegment]) -> float:
    """Return the slowest speed that the records visit and whose direction the encoder shows, rad/s or m/s.

    The noise of a velocity from counts q at the rate f behind a low-pass with the cut-off c is that of differences of
    white noise of variance q^2 / 12: its variance is q^2 / 12 (2 / f) (2 pi)^2 c^3 / 3. A recorded velocity is resolved
    in its own steps. Source of the variance of counts: B. Widrow, I. Kollar, Quantization Noise, 2008.
    """
    noise = max(map(_noise, records))
    speed = np.abs(np.concatenate([record.reduce_smooth(record.velocity) for record in records]))
    moving = speed[speed > max(noise, 1e-6 * float(np.max(speed)))]
    return max(th.CLEAR * noise, float(np.quantile(moving, th.RARE)) if moving.size else 0.0)


def _noise(record: RegressionSegment) -> float:
    if record.lowpass_hz is None:
        return (resolution(record.velocity) or 0.0) / th.CLEAR  # a whole step is clear
    if record.resolution is None:
        return 0.0
    power = record.resolution**2 / 12.0 * 2.0 / record.rate_hz * (2.0 * math.pi) ** 2 * record.lowpass_hz**3 / 3.0
    return math.sqrt(power)


def visited(velocity: Array, slowest: float) -> Array:
    """Return the factor of the residual, (n,), for speeds around the least one; see `network.support`."""
    if slowest <= 0.0:
        return np.ones(len(velocity))
    return np.asarray(np.clip(2.0 * np.abs(velocity) / slowest - 1.0, 0.0, 1.0))
