"""Frequency response of the motor, torque to velocity, from the parts of recordings in which the axis slides. Pure.

Friction that changes its sign is no part of a linear system. Therefore only windows count in which the axis slides in
one direction; there Coulomb friction is a constant, which the detrending removes.

The torque of a drive comes from its control loops, which see disturbances, and noise of the encoder: the plain ratio
of spectra then mixes the axis with the inverse of the controller. Where a recording has the demand of the motion, it is
the instrument: the ratio of the cross spectra demand-velocity and demand-torque has no such bias. Without a demand the
plain ratio is used, which is right only if the torque did not come from the measured position.

Sources: P. D. Welch, IEEE Transactions on Audio and Electroacoustics 15(2), 1967 (averaging); P. E. Wellstead,
Automatica 17(1), 1981 (instrument in a loop); B. Efron, The Jackknife, the Bootstrap and Other Resampling Plans, 1982.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from friction_hil.numerics.jit import Array
from friction_hil.recordings.segments import Segment

Complex = NDArray[np.complex128]

LEAST_COHERENCE = 0.8
LEAST_WINDOWS = 12  # of fewer, the coherence of noise is not small
_WINDOWS_S = (4.0, 2.0, 1.0, 0.5, 0.25)
_LEAST_SPEED_RATIO = 0.02  # of the top speed: what is slower does not slide
_TOP_RATIO = 0.4  # of the sampling rate: highest line
_LEAST_LINES = 8


@dataclass(frozen=True, slots=True, eq=False)
class FrequencyResponse:
    """Frequency response of the motor with its uncertainty; arrays (m,) over the lines of the spectrum.

    Attributes
    ----------
    frequency_hz : array
    response : array of complex
        Velocity over torque, rad/s per N m or m/s per N.
    coherence : array
        Between velocity and torque; with an instrument the smaller one of those between the instrument and either.
    is_used : array of bool
        Lines with enough coherence.
    deviations : (b, m) array of complex
        Logarithm of the response without one of ``b`` blocks of windows, less its mean, scaled so that the sum of
        squares is the variance (jackknife).
    windows : int
        Number of windows, which overlap by half.
    window_s : float
        Length of each, s.
    has_instrument : bool
        True if the demand was used.
    period_s : float
        Sampling period of the torque.
    """

    frequency_hz: Array
    response: Complex
    coherence: Array
    is_used: NDArray[np.bool_]
    deviations: Complex
    windows: int
    window_s: float
    has_instrument: bool
    period_s: float

    @property
    def errors(self) -> Array:
        """Standard error of the logarithm of the response (m,): relative error of the gain, and of the phase in rad."""
        return np.asarray(np.sqrt(0.5 * np.sum(np.abs(self.deviations) ** 2, axis=0)))

    @property
    def band_hz(self) -> tuple[float, float]:
        """Lowest and highest used frequency, Hz."""
        used = self.frequency_hz[self.is_used]
        return float(used[0]), float(used[-1])


def frequency_response(
    segments: Sequence[Segment], least_coherence: float = LEAST_COHERENCE
) -> FrequencyResponse | None:
    """Estimate the frequency response of the motor.

    Parameters
    ----------
    segments : sequence of Segment
        Of one axis and one sampling rate. ``encoder`` and ``torque`` are used as they were recorded, ``velocity`` only
        to find where the axis slides.
    least_coherence : float
        Lines with less are not used.

    Returns
    -------
    FrequencyResponse or None
        None if too few windows slide, or hardly any line is coherent: the motion does not excite the axis.
    """
    has_instrument = all(each.demand is not None for each in segments)
    for window_s in _WINDOWS_S:
        spectra, lengths = _windows(segments, window_s, has_instrument=has_instrument)
        if len(spectra) >= LEAST_WINDOWS:
            found = _estimate(spectra, lengths, segments[0].rate_hz, has_instrument, least_coherence)
            return found if np.count_nonzero(found.is_used) >= _LEAST_LINES else None
    return None


def sliding_windows(segment: Segment, count: int) -> list[slice]:
    """Return windows of ``count`` rows, half of each in the next one, in which the axis slides in one direction."""
    least = _LEAST_SPEED_RATIO * float(np.max(np.abs(segment.velocity), initial=0.0))
    found = []
    for sign in (1.0, -1.0):
        edges = np.diff(np.concatenate([[0], (sign * segment.velocity > least).astype(int), [0]]))
        for begin, end in zip(np.flatnonzero(edges == 1), np.flatnonzero(edges == -1), strict=True):
            found += [slice(at, at + count) for at in range(int(begin), int(end) - count + 1, count // 2)]
    return sorted(found, key=lambda each: each.start)


def _windows(segments: Sequence[Segment], window_s: float, *, has_instrument: bool) -> tuple[Complex, int]:
    """Return the spectra (w, 3, m) of torque, velocity and instrument of all windows, and their number of rows."""
    count = 2 * round(0.5 * window_s * segments[0].rate_hz)
    if count < 2 * _LEAST_LINES:
        return np.empty((0, 3, 0), dtype=complex), count
    shape = np.hanning(count + 1)[:count]
    time = np.arange(count) - 0.5 * (count - 1)
    found = []
    for each in segments:
        # differences have no leakage of a motion that goes on; what they do to a sine is undone in the spectrum
        velocity = np.diff(each.encoder, prepend=each.encoder[0]) * each.rate_hz
        signals = [each.torque, velocity]
        if has_instrument and each.demand is not None:
            signals.append(np.diff(each.demand, prepend=each.demand[0]) * each.rate_hz)
        for rows in sliding_windows(each, count):
            parts = np.array([signal[rows] for signal in signals])
            if not np.all(np.isfinite(parts)):
                continue
            parts = parts - parts.mean(axis=1, keepdims=True)
            parts -= np.outer(parts @ time / (time @ time), time)
            found.append(np.fft.rfft(parts * shape, axis=1))
    return (np.array(found) if found else np.empty((0, 3, 0), dtype=complex)), count


def _estimate(
    spectra: Complex, count: int, rate_hz: float, has_instrument: bool, least_coherence: float
) -> FrequencyResponse:
    frequency = np.arange(count // 2 + 1) * rate_hz / count
    kept = (frequency > 1.5 * rate_hz / count) & (frequency <= _TOP_RATIO * rate_hz)
    frequency, spectra = frequency[kept], spectra[:, :, kept]
    turn = np.exp(-2j * math.pi * frequency / rate_hz)
    of_difference = (2j * math.pi * frequency / rate_hz) / (1.0 - turn)  # derivative over backward difference
    spectra = spectra.copy()
    spectra[:, 1] *= of_difference
    torque, velocity = spectra[:, 0], spectra[:, 1]
    instrument = spectra[:, 2] if has_instrument else torque

    def ratio(weights: Any) -> Complex:
        up, down = (np.tensordot(weights, np.conj(instrument) * each, 1) for each in (velocity, torque))
        return np.asarray(up / np.where(down == 0.0, 1e-300, down))

    coherence = _coherence(instrument, velocity)
    if has_instrument:
        coherence = np.minimum(coherence, _coherence(instrument, torque))
    response = ratio(np.ones(len(spectra)))
    blocks = np.arange(len(spectra)) // 2  # windows overlap by half: neighbours are no independent data
    number = int(blocks[-1]) + 1
    left_out = np.array([ratio((blocks != b).astype(float)) for b in range(number)])
    logs = np.log(left_out / response)
    deviations = (logs - logs.mean(axis=0)) * math.sqrt((number - 1) / number)
    is_used = (coherence >= least_coherence) & np.all(np.isfinite(deviations), axis=0)
    return FrequencyResponse(
        frequency,
        response,
        coherence,
        is_used,
        deviations,
        len(spectra),
        count / rate_hz,
        has_instrument,
        1.0 / rate_hz,
    )


def _coherence(one: Complex, other: Complex) -> Array:
    """Return the coherence (m,) of two signals by their spectra (w, m)."""
    cross = np.abs(np.sum(np.conj(one) * other, axis=0)) ** 2
    powers = np.sum(np.abs(one) ** 2, axis=0) * np.sum(np.abs(other) ** 2, axis=0)
    return np.where(powers > 0.0, cross / np.where(powers > 0.0, powers, 1.0), 0.0)
