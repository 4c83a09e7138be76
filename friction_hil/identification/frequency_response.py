"""Frequency response of the motor, torque to velocity, from the parts of recordings in which the axis slides. Pure.

Friction that changes its sign is no part of a linear system. Therefore only windows count in which the axis slides in
one direction; there Coulomb friction is a constant, which the detrending removes.

The torque of a drive comes from its control loops, which see disturbances, and noise of the encoder: the plain ratio
of spectra then mixes the axis with the inverse of the controller. Where a recording has the demand of the motion, it is
the reference: the response of the velocity to it over that of the torque to it has no such bias, and both are smooth
at a resonance, which the loop damps. Without a demand the plain ratio is used, which is right only if the torque did
not come from the measured position.

A window that tapers would smear a lightly damped resonance over its main lobe. Here the windows have hard edges, and
the response and what the edges leak are fitted together over a few neighbouring lines, as a rational function and a
polynomial. The response is common to all windows; each has its own leakage.

Another axis of the same machine that is held in its place is held by control loops, which give way. Its inertia then
looks like a load on a damped spring. Where its motion was recorded too, its response to that of this axis is estimated
in the same way, so that a fit can tell the two apart.

Sources: R. Pintelon, J. Schoukens, G. Vandersteen, K. Barbe, Mechanical Systems and Signal Processing 24(3), 2010
(local polynomials, and the reference in a loop); T. McKelvey, G. Guerin, IFAC Proceedings Volumes 45(16), 2012 (local
rational functions); B. Efron, The Jackknife, the Bootstrap and Other Resampling Plans, 1982.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from friction_hil.identification import thresholds as th
from friction_hil.numerics.jit import Array
from friction_hil.recordings.segments import Segment

Complex = NDArray[np.complex128]

_RIDGE = 1e-12  # of the power of the reference


@dataclass(frozen=True, slots=True, eq=False)
class FrequencyResponse:
    """Frequency response of the motor with its uncertainty; arrays (m,) over the lines of the spectrum."""

    frequency_hz: Array
    response: Complex  # velocity over torque, rad/s per N m or m/s per N
    # part of the power that is a linear response: of the velocity to the torque; with a reference the smaller one of
    # those of velocity and torque to the reference
    coherence: Array
    is_used: NDArray[np.bool_]  # lines with enough coherence
    # (b, m), logarithm of the response without one of ``b`` windows, less its mean, scaled so that the sum of squares
    # is the variance (jackknife)
    deviations: Complex
    windows: int  # their number
    window_s: float  # length of each
    has_instrument: bool  # the demand was used
    period_s: float  # sampling period of the torque
    # (k, m), velocity of each of ``k`` other axes that move with this one, over the velocity of this one
    beside: Complex

    @property
    def errors(self) -> Array:
        """Standard error of the logarithm of the response (m,): relative error of the gain, and of the phase in rad."""
        return np.asarray(np.sqrt(0.5 * np.sum(np.abs(self.deviations) ** 2, axis=0)))

    @property
    def band_hz(self) -> tuple[float, float]:
        """Lowest and highest used frequency, Hz."""
        used = self.frequency_hz[self.is_used]
        return float(used[0]), float(used[-1])


def frequency_response(segments: Sequence[Segment], beside: Sequence[Array] | None = None) -> FrequencyResponse | None:
    """Estimate the frequency response of the motor from segments of one axis and one sampling rate.

    ``encoder`` and ``torque`` are used as they were recorded, ``velocity`` only to find where the axis slides. Lines
    with less than `th.LEAST_COHERENCE` are not used. ``beside``: positions (n, k) of ``k`` other axes at the rows of
    each segment; an axis whose motion is not coherent with that of this one is left out. None: too few windows slide,
    or hardly any line is coherent, as the motion does not excite the axis.
    """
    has_instrument = all(each.demand is not None for each in segments)
    others = beside or [np.empty((len(each.encoder), 0)) for each in segments]
    for window_s in th.WINDOWS_S:
        spectra, lengths = _windows(segments, others, window_s, has_instrument=has_instrument)
        if len(spectra) >= th.LEAST_WINDOWS:
            own, rate_hz = spectra[:, :3], segments[0].rate_hz
            found = _estimate(own, lengths, rate_hz, has_instrument)
            if np.count_nonzero(found.is_used) < th.LEAST_LINES:
                return None
            ratios = [
                _estimate(spectra[:, [0, k, 2]], lengths, rate_hz, has_instrument) for k in range(3, spectra.shape[1])
            ]
            moving = [
                each.response / found.response
                for each in ratios
                if np.median(each.coherence[found.is_used]) >= th.LEAST_COHERENCE
            ]
            return replace(found, beside=np.array(moving, dtype=complex).reshape(len(moving), len(found.response)))
    return None


def sliding_windows(segment: Segment, count: int) -> list[slice]:
    """Return windows of ``count`` rows, one after another, in which the axis slides in one direction."""
    least = th.LEAST_SPEED_RATIO * float(np.max(np.abs(segment.velocity), initial=0.0))
    found = []
    for sign in (1.0, -1.0):
        edges = np.diff(np.concatenate([[0], (sign * segment.velocity > least).astype(int), [0]]))
        for begin, end in zip(np.flatnonzero(edges == 1), np.flatnonzero(edges == -1), strict=True):
            number = int(end - begin) // count
            begin += (end - begin - number * count) // 2  # the rows beside a reversal count least
            found += [slice(int(begin) + k * count, int(begin) + (k + 1) * count) for k in range(number)]
    return sorted(found, key=lambda each: each.start)


def _windows(
    segments: Sequence[Segment], beside: Sequence[Array], window_s: float, *, has_instrument: bool
) -> tuple[Complex, int]:
    """Return the spectra of all windows, and their number of rows.

    The spectra, (w, 3 + k, m), are those of torque, velocity, reference, and the velocities of ``k`` other axes.
    """
    count = 2 * round(0.5 * window_s * segments[0].rate_hz)
    nothing = np.empty((0, 3 + beside[0].shape[1], 0), dtype=complex)
    if count < 2 * (2 * th.REACH + 1 + th.LEAST_LINES):
        return nothing, count
    time = np.arange(count) - 0.5 * (count - 1)
    found = []
    for each, others in zip(segments, beside, strict=True):
        # differences have no leakage of a motion that goes on; what they do to a sine is undone in the spectrum
        velocity, *velocities = (np.diff(q, prepend=q[0]) * each.rate_hz for q in (each.encoder, *others.T))
        signals = [each.torque, velocity, each.torque, *velocities]
        if has_instrument and each.demand is not None:
            signals[2] = np.diff(each.demand, prepend=each.demand[0]) * each.rate_hz
        for rows in sliding_windows(each, count):
            parts = np.array([signal[rows] for signal in signals])
            if not np.all(np.isfinite(parts)):
                continue
            parts = parts - parts.mean(axis=1, keepdims=True)
            parts -= np.outer(parts @ time / (time @ time), time)
            found.append(np.fft.rfft(parts, axis=1))
    return (np.array(found) if found else nothing), count


def _estimate(spectra: Complex, count: int, rate_hz: float, has_instrument: bool) -> FrequencyResponse:
    lines = np.arange(1 + th.REACH, min(count // 2 - th.REACH, math.floor(th.RESPONSE_TOP_RATIO * count) + 1))
    frequency = lines * rate_hz / count
    turn = np.exp(-2j * math.pi * frequency / rate_hz)
    of_difference = (2j * math.pi * frequency / rate_hz) / (1.0 - turn)  # derivative over backward difference
    # (w, 3, m, 2 reach + 1): each line with its neighbours
    near = np.lib.stride_tricks.sliding_window_view(spectra, 2 * th.REACH + 1, axis=2)[:, :, lines - th.REACH]
    powers = (np.arange(-th.REACH, th.REACH + 1)[:, None] / th.REACH) ** np.arange(th.DEGREE + 1)
    leakage = np.linalg.qr(powers)[0]

    def without_leakage(values: Complex) -> Complex:
        return np.asarray(values - np.einsum("...j,jk,lk->...l", values, leakage, leakage))

    # torque and velocity share the poles of the loop, hence the denominator 1 + pole j over the neighbours j; each
    # output is scaled by its size at the line
    sizes = np.sqrt(np.mean(np.abs(near[:, :2]) ** 2, axis=(0, 3)))[None, :, :, None]
    scaled = near[:, :2] / np.where(sizes > 0.0, sizes, 1.0)
    outputs = without_leakage(scaled)
    inputs = without_leakage(near[:, 2, :, None, :] * powers.T)  # (w, m, degree + 1, 2 reach + 1)
    shape = inputs.shape
    rows = np.zeros((shape[0], shape[1], 2 * th.DEGREE + 3, 2, shape[3]), dtype=complex)
    rows[:, :, : th.DEGREE + 1, 0] = rows[:, :, th.DEGREE + 1 : -1, 1] = inputs
    rows[:, :, -1] = -np.moveaxis(without_leakage(scaled * powers[:, 1]), 1, 2)
    rows = rows.reshape(*shape[:2], 2 * th.DEGREE + 3, -1)
    target = np.moveaxis(outputs, 1, 2).reshape(*shape[:2], -1)
    gram = np.einsum("wmpj,wmqj->wmpq", np.conj(rows), rows)
    right = np.einsum("wmpj,wmj->wmp", np.conj(rows), target)
    scale = np.trace(gram.sum(axis=0), axis1=-2, axis2=-1).real[:, None, None]
    ridge = (_RIDGE * np.where(scale > 0.0, scale, 1.0)) * np.eye(2 * th.DEGREE + 3)
    sizes = sizes[0, :, :, 0]

    def ratio(gram: Complex, right: Complex) -> tuple[Complex, Complex]:
        """Return velocity over torque (m,), and all coefficients (m, p)."""
        found = np.asarray(np.linalg.solve(gram + ridge, right[..., None])[..., 0], dtype=np.complex128)
        torque, velocity = found[:, 0] * sizes[0], found[:, th.DEGREE + 1] * sizes[1]
        return np.asarray(velocity / np.where(torque == 0.0, 1e-300, torque)), found

    all_gram, all_right = gram.sum(axis=0), right.sum(axis=0)
    response, found = ratio(all_gram, all_right)
    left = (target - np.einsum("mp,wmpj->wmj", found, rows)).reshape(*shape[:2], 2, -1)
    number = len(spectra)
    freedom = number * (2 * th.REACH - th.DEGREE)
    noise = np.sum(np.abs(left) ** 2, axis=(0, 3)) / (freedom - th.DEGREE - 1.5)
    power = np.sum(np.abs(outputs) ** 2, axis=(0, 3)).T / freedom
    coherences = np.clip(1.0 - noise / np.where(power > 0.0, power, 1.0), 0.0, 1.0)
    coherence = np.min(coherences, axis=1) if has_instrument else coherences[:, 1]
    left_out = np.array([ratio(all_gram - gram[w], all_right - right[w])[0] for w in range(number)])
    with np.errstate(all="ignore"):  # a line without any power has no response
        logs = np.log(left_out / response)
    deviations = (logs - logs.mean(axis=0)) * math.sqrt((number - 1) / number)
    is_used = (coherence >= th.LEAST_COHERENCE) & np.all(np.isfinite(deviations), axis=0)
    return FrequencyResponse(
        frequency,
        response * of_difference,
        coherence,
        is_used,
        deviations,
        number,
        count / rate_hz,
        has_instrument,
        1.0 / rate_hz,
        np.empty((0, len(lines)), dtype=complex),
    )
