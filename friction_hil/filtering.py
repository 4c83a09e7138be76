"""Filters without delay, as identification of drives uses them: forward and backward over the whole record. Pure."""

import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

LOWPASS_ORDER = 4
DECIMATOR_ORDER, DECIMATOR_RIPPLE_DB, DECIMATOR_SHARE = 8, 0.05, 0.8  # the last: of the new Nyquist frequency
SETTLING_PERIODS = 5.0  # of the low-pass's cut-off: what it makes of the ends of a record is not data
_PADDING_PER_ORDER = 3  # samples by which a record is extended (odd) at both ends


def lowpass(values: Array, cutoff_hz: float, rate_hz: float) -> Array:
    """Low-pass a record without delay: 4th-order Butterworth, forward and backward.

    Parameters
    ----------
    values : (n,) or (n, m) array
        Evenly sampled, along the first axis; more than `lowpass_padding` samples.
    cutoff_hz, rate_hz : float
        Cut-off (-3 dB of a single pass) and sampling rate, Hz; the first below half the second.
    """
    from scipy import signal

    sections = signal.butter(LOWPASS_ORDER, cutoff_hz / (rate_hz / 2.0), output="sos")
    filtered: Array = signal.sosfiltfilt(sections, values, axis=0, padlen=lowpass_padding())
    return filtered


def lowpass_padding() -> int:
    """Samples that a record must exceed to be low-passed."""
    return _PADDING_PER_ORDER * LOWPASS_ORDER


def settling_samples(cutoff_hz: float, rate_hz: float) -> int:
    """Samples at either end of a record that a low-pass spoils."""
    return math.ceil(SETTLING_PERIODS * rate_hz / cutoff_hz) - 1


def decimate(values: Array, factor: int) -> Array:
    """Keep each ``factor``-th sample, the last one among them, behind a filter without delay, as MATLAB does.

    8th-order Chebyshev filter of the first kind, 0.05 dB, at 0.8 of the new Nyquist frequency, forward and backward.

    Parameters
    ----------
    values : (n,) or (n, m) array
        Evenly sampled, along the first axis; more than `decimation_padding` samples.
    factor : int
        1 keeps everything as it is.

    Returns
    -------
    (ceil(n / factor),) or (ceil(n / factor), m) array
        The samples that `decimated_rows` names.
    """
    if factor == 1:
        return values
    from scipy import signal

    sections = signal.cheby1(DECIMATOR_ORDER, DECIMATOR_RIPPLE_DB, DECIMATOR_SHARE / factor, output="sos")
    filtered: Array = signal.sosfiltfilt(sections, values, axis=0, padlen=decimation_padding())
    return filtered[decimated_rows(len(values), factor)]


def decimation_padding() -> int:
    """Samples that a record must exceed to be decimated."""
    return _PADDING_PER_ORDER * DECIMATOR_ORDER


def decimated_rows(rows: int, factor: int) -> slice:
    """Which of ``rows`` samples `decimate` keeps."""
    return slice((rows - 1) % factor, None, factor)
