"""Zero-phase filters for the identification of drives: forward and backward over the whole record. Pure.

They equal `scipy.signal.sosfiltfilt` to rounding, which the tests check. They are not taken from SciPy because they
filter the columns of a gradient in one pass (2 to 12 times as fast, the more so the more columns), and because
importing `scipy.signal` takes 0.7 s of processor time, about as long as the identification of one model.
"""

import cmath
import math
from functools import cache

import numpy as np

from friction_hil.numerics.jit import Array, compiled

LOWPASS_ORDER = 4
DECIMATOR_ORDER, DECIMATOR_RIPPLE_DB = 8, 0.05
DECIMATOR_SHARE = 0.8  # cut-off over the new Nyquist frequency
SETTLING_PERIODS = 5.0  # of the cut-off frequency: time over which the low-pass spoils each end of a record
_PADDING_PER_ORDER = 3  # samples per order by which a record is extended oddly at both ends


def lowpass(values: Array, cutoff_hz: float, rate_hz: float) -> Array:
    """Low-pass a record without delay: 4th-order Butterworth, forward and backward.

    ``values``: (n,) or (n, m), evenly sampled along the first axis, more than `lowpass_padding` samples. ``cutoff_hz``:
    -3 dB of a single pass; below half of ``rate_hz``, the sampling rate.
    """
    sections = _low_pass_sections(LOWPASS_ORDER, 0.0, cutoff_hz / (rate_hz / 2.0))
    return _forward_backward(_columns(values), sections, lowpass_padding()).reshape(values.shape)


def lowpass_padding() -> int:
    """Return the number of samples that a record must exceed to be low-passed."""
    return _PADDING_PER_ORDER * LOWPASS_ORDER


def settling_samples(cutoff_hz: float, rate_hz: float) -> int:
    """Return the number of samples at each end of a record that a low-pass spoils."""
    return math.ceil(SETTLING_PERIODS * rate_hz / cutoff_hz) - 1


def decimate(values: Array, factor: int) -> Array:
    """Keep every ``factor``-th sample, including the last, after a zero-phase low-pass, as MATLAB's decimate does.

    8th-order Chebyshev filter of the first kind, 0.05 dB, at 0.8 of the new Nyquist frequency, forward and backward.
    Returns the samples that `decimated_rows` names: ceil(n / factor) of them.

    ``values``: (n,) or (n, m), evenly sampled along the first axis, more than `decimation_padding` samples. ``factor``:
    1 keeps everything as it is.
    """
    if factor == 1:
        return values
    sections = _low_pass_sections(DECIMATOR_ORDER, DECIMATOR_RIPPLE_DB, DECIMATOR_SHARE / factor)
    filtered = _forward_backward(_columns(values), sections, decimation_padding())
    kept: Array = np.ascontiguousarray(filtered[decimated_rows(len(values), factor)])
    return kept.reshape(-1, *values.shape[1:])


def decimation_padding() -> int:
    """Return the number of samples that a record must exceed to be decimated."""
    return _PADDING_PER_ORDER * DECIMATOR_ORDER


def decimated_rows(rows: int, factor: int) -> slice:
    """Return the slice of ``rows`` samples that `decimate` keeps."""
    return slice((rows - 1) % factor, None, factor)


def _columns(values: Array) -> Array:
    return np.ascontiguousarray(values.reshape(len(values), -1), dtype=np.float64)


def _forward_backward(values: Array, sections: Array, padding: int) -> Array:
    """Filter the columns of ``values`` (n, m) forward and backward, extended oddly by ``padding`` rows at each end."""
    if len(values) <= padding:
        raise ValueError(f"{len(values)} samples are too few: the filter extends a record by {padding} at either end")
    head = 2.0 * values[0] - values[padding:0:-1]
    tail = 2.0 * values[-1] - values[-2 : -padding - 2 : -1]
    extended = np.concatenate([head, values, tail])
    _cascade(sections, extended, False)
    _cascade(sections, extended, True)
    return extended[padding:-padding]


@cache
def _low_pass_sections(order: int, ripple_db: float, cutoff: float) -> Array:
    """Return the second-order sections (order / 2, 5) of a low-pass: b0, b1, b2, a1, a2 with a0 = 1.

    Butterworth for a ripple of zero, else Chebyshev of the first kind with that ripple; ``order`` is even, ``cutoff``
    is the end of the pass band over the Nyquist frequency. The poles of the prewarped analog filter are mapped by the
    bilinear transform. Source: A. V. Oppenheim, R. W. Schafer, Discrete-Time Signal Processing, 3rd ed., section 7.2
    and appendix B.
    """
    warped = math.tan(0.5 * math.pi * cutoff)
    gain, real, imaginary = 1.0, 1.0, 1.0
    if ripple_db > 0.0:
        gain = 10.0 ** (-ripple_db / 20.0)  # of an even order at zero frequency
        bend = math.asinh(1.0 / math.sqrt(gain**-2 - 1.0)) / order
        real, imaginary = math.sinh(bend), math.cosh(bend)
    sections = np.empty((order // 2, 5))
    for k in range(order // 2):
        on_circle = cmath.rect(1.0, 0.5 * math.pi * (2 * k + 1) / order)
        pole = warped * complex(-real * on_circle.imag, imaginary * on_circle.real)
        square = abs(pole) ** 2
        leading = 1.0 - 2.0 * pole.real + square
        b = square / leading * (gain if k == 0 else 1.0)
        sections[k] = b, 2.0 * b, b, 2.0 * (square - 1.0) / leading, (1.0 + 2.0 * pole.real + square) / leading
    return sections


@compiled
def _cascade(sections: Array, x: Array, is_backward: bool) -> None:
    """Apply second-order sections along the rows of ``x`` (n, m), in place, settled on the first row at the start.

    The innermost loop runs over the columns, which are independent, so that the compiler vectorises it.
    """
    n, m = x.shape
    count = sections.shape[0]
    state = np.empty((count, 2, m))
    first = n - 1 if is_backward else 0
    gain = 1.0
    for i in range(count):
        b0, b1, b2 = sections[i, 0], sections[i, 1], sections[i, 2]
        a1, a2 = sections[i, 3], sections[i, 4]
        settled = gain * (b0 + b1 + b2) / (1.0 + a1 + a2)
        for j in range(m):
            state[i, 0, j] = (settled - b0 * gain) * x[first, j]
            state[i, 1, j] = (b2 * gain - a2 * settled) * x[first, j]
        gain = settled
    for step in range(n):
        k = n - 1 - step if is_backward else step
        for i in range(count):
            b0, b1, b2 = sections[i, 0], sections[i, 1], sections[i, 2]
            a1, a2 = sections[i, 3], sections[i, 4]
            for j in range(m):
                value = x[k, j]
                y = b0 * value + state[i, 0, j]
                state[i, 0, j] = b1 * value - a1 * y + state[i, 1, j]
                state[i, 1, j] = b2 * value - a2 * y
                x[k, j] = y
