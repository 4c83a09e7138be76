"""Records for what happens inside presliding: motion finer than a count of the encoder, time finer than a sample.

The ordinary record (`friction_hil.identification.data`) low-passes the position once, as strongly as the slowest
part of it needs; what a presliding spring does in a few milliseconds is gone then. Here the position's differences
are split into bands, of which each is kept as far as it stands out from the encoder's noise just then, and the model
runs in several steps a sample.

Sources: quantisation noise q^2 / 12, B. Widrow, I. Kollar, Quantization Noise, 2008; gain max(0, 1 - noise / power)
for each band, S. Boll, IEEE Transactions on Acoustics, Speech and Signal Processing 27(2), 1979 (as a Wiener gain:
P. Vary, R. Martin, Digital Speech Transmission, 2006, section 11.4).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np

from friction_hil.errors import RecordingError
from friction_hil.identification.data import Data, RegressionSegment
from friction_hil.motion.experiment import LEAST_RATE_HZ, is_fast
from friction_hil.numerics.jit import Array

LEAST_S = 5.0  # of a record; its first and last second only let filters and states settle
SLOWEST_SWING_HZ = 8.0
_FASTEST_SWING_HZ = 80.0
_LEAST_SHARE = 0.05  # of the time
_CLEAR = 100.0  # times the noise of the encoder
_FIRST_BAND_HZ = 40.0  # below it everything is kept
LAST_BAND_SHARE = 0.42  # of the sampling rate: the highest frequency that is kept
_NOISE_FACTOR = 2.0  # the noise of so few samples is often twice its mean
_STEPS_HZ = 12000.0  # of the model
ROWS_HZ = 200.0  # of the regression
RESIDUAL_HZ, _RESIDUAL_WIDTH_HZ = 80.0, 60.0
_EDGE_S = 1.0
_ATTENUATION_DB = 80.0
_LONG = 400  # taps from which on Fourier transforms are faster


@dataclass(frozen=True, slots=True, eq=False)
class FineSegment(RegressionSegment):
    """A record whose motion is at the steps of the model; (n, ...) arrays of it hold a row for each step.

    Attributes
    ----------
    fine : int
        Steps in a sample.
    is_mean : bool
        Whether a measured torque is the mean over the period that ends at the sample; else that of the instant.
    samples : array
        Measured torque at the samples 1...
    """

    fine: int
    is_mean: bool
    samples: Array

    @property
    def sample_hz(self) -> float:
        """Sampling rate."""
        return self.rate_hz / self.fine

    def at_samples(self, values: Array) -> Array:
        """From the ends of steps to samples 1..., as the drive would report it."""
        ends = values[self.fine - 1 :: self.fine]
        if not self.is_mean:
            return ends
        mean: Array = values.reshape((-1, self.fine, *values.shape[1:])).mean(axis=1)  # rectangles, half a step late
        mean[1:] -= 0.5 / self.fine * np.diff(ends, axis=0)  # trapezes
        return mean

    def reduce(self, values: Array) -> Array:
        """From the ends of steps, (n,) or (n, m), to the rows of the regression."""
        return self._low(self.at_samples(values))

    def reduce_smooth(self, values: Array) -> Array:
        """`reduce`."""
        return self.reduce(values)

    def reduced_torque(self) -> Array:
        """Measured torque in the rows of the regression."""
        return self._low(self.samples)

    def reduced_time(self) -> Array:
        """Time stamps of the rows of the regression."""
        ends = self.time_s[self.fine - 1 :: self.fine]
        return np.ascontiguousarray(ends[self._edge : len(ends) - self._edge : self.decimation])

    @property
    def _edge(self) -> int:
        kernel = _fir(RESIDUAL_HZ, _RESIDUAL_WIDTH_HZ, self.sample_hz)
        return max(round(_EDGE_S * self.sample_hz), kernel.size + self.decimation)

    def _low(self, values: Array) -> Array:
        """Through the residual's low-pass, without the record's ends; only what is kept is computed."""
        from scipy import signal

        kernel = _fir(RESIDUAL_HZ, _RESIDUAL_WIDTH_HZ, self.sample_hz)
        half, edge, every = kernel.size // 2, self._edge, self.decimation
        ahead = -2 * half % every
        kept: Any = signal.upfirdn(kernel, values[edge - half - ahead :], down=every, axis=0)
        first = (2 * half + ahead) // every
        return np.ascontiguousarray(kept[first : first + -(-(len(values) - 2 * edge) // every)])


def is_fine(record: RegressionSegment) -> bool:
    """Whether a record can be brought to fine steps: known counts, sampled fast and for long enough, all rows count."""
    if record.is_moving is not None:
        return False
    rate = record.rate_hz
    return record.resolution is not None and is_fast(rate) and len(record.encoder) >= LEAST_S * rate


def is_presliding_excited(record: RegressionSegment) -> bool:
    """Whether it also shows presliding: swings faster than 8 Hz, well above the encoder's noise, for some of the time.

    An axis that swings more than it travels reverses in each swing, and each reversal passes through presliding.
    """
    if record.resolution is None or not is_fine(record):
        return False
    rate = record.rate_hz
    moves = np.diff(record.encoder) * rate
    slow_kernel, fast_kernel = (_fir(f, 0.7 * f, rate) for f in (SLOWEST_SWING_HZ, _FASTEST_SWING_HZ))
    slow, fast = _centred(moves, slow_kernel), _centred(moves, fast_kernel)
    swing = _local_power(fast - slow, rate / SLOWEST_SWING_HZ)
    travel = _local_power(slow, rate / SLOWEST_SWING_HZ)
    noise = _noise(slow_kernel, fast_kernel, record.resolution, rate)
    return float(np.mean((swing > travel) & (swing > _CLEAR * noise))) >= _LEAST_SHARE


def shows_presliding(records: Sequence[RegressionSegment], is_wanted: bool | None) -> bool:
    """Whether a fit to all these records is to be refined: by what they show, unless the user has said so.

    Raises
    ------
    RecordingError
        It is wanted, but not possible.
    """
    if is_wanted is None:
        return all(is_presliding_excited(each) for each in records)
    for each in records if is_wanted else ():
        if not is_fine(each):
            raise RecordingError(
                f"{each.path}: to refine a fit takes a position in steps of the encoder, not smoothed or "
                f"interpolated, at {LEAST_RATE_HZ:g} Hz or more, for {LEAST_S:g} s or more without a gap"
            )
    return is_wanted


def fine_data(records: Sequence[RegressionSegment], *, is_mean: bool) -> Data:
    """Bring records whose encoder's counts are known to fine steps."""
    return Data([_fine_record(record, record.encoder, record.torque, is_mean) for record in records])


def recounted(
    data: Data, originals: Sequence[RegressionSegment], torques: Sequence[Array], random: np.random.Generator
) -> Data:
    """Data of the same motion, counted again by an encoder at another place, with torques (n,) at the samples.

    Parameters
    ----------
    data : Data
        What `fine_data` made of ``originals``.
    originals : sequence of RegressionSegment
    torques : sequence of array
        In place of the measured ones, at samples 1...
    random : Generator
        Where the edges of the counts lie.
    """
    found = []
    for fine, original, torque in zip(data.records, originals, torques, strict=True):
        assert isinstance(fine, FineSegment)
        assert original.resolution is not None
        path = np.concatenate([original.encoder[:1], fine.position[fine.fine - 1 :: fine.fine]])
        place = random.uniform()
        counts = (np.floor(path / original.resolution + place) - place) * original.resolution
        found.append(_fine_record(original, counts, np.concatenate([torque[:1], torque]), fine.is_mean))
    return Data(found)


def _fine_record(record: RegressionSegment, position: Array, torque: Array, is_mean: bool) -> FineSegment:
    rate = record.rate_hz
    assert record.resolution is not None
    fine = 2 * max(1, round(0.5 * _STEPS_HZ / rate))
    velocity = velocity_by_bands(position, rate, record.resolution, fine)
    step_s = 1.0 / (rate * fine)
    steps = np.arange(1, len(velocity) + 1)

    def slow(values: Array | None) -> Array | None:
        return None if values is None else np.interp(steps / fine, np.arange(len(values)), values)

    return FineSegment(
        path=record.path,
        axis=record.axis,
        rows=record.rows,
        time_s=record.time_s[0] + steps * step_s,
        position=position[0] + np.cumsum(velocity) * step_s,
        velocity=velocity,
        acceleration=np.append(np.diff(velocity), 0.0) / step_s,
        torque=np.repeat(torque[1:], fine),
        load_torque=slow(record.load_torque),
        temperature=slow(record.temperature),
        demand=None,
        rate_hz=rate * fine,
        lowpass_hz=RESIDUAL_HZ,
        decimation=max(1, round(rate / ROWS_HZ)),
        begin=0,
        end=len(velocity),
        problems=record.problems,
        encoder=position,
        resolution=record.resolution,
        group=record.group,
        fine=fine,
        is_mean=is_mean,
        samples=torque[1:],
    )


def velocity_by_bands(position: Array, rate_hz: float, resolution: float, fine: int) -> Array:
    """Velocity in each of ``fine`` steps a sample, ((n - 1) * fine,), from a counted position (n,).

    It is that of differences, hence a mean over one sampling period about the step: of a sine of a tenth of the
    sampling rate 98 % are left.

    Parameters
    ----------
    position : (n,) array
        rad or m.
    rate_hz : float
        Sampling rate.
    resolution : float
        Of the position.
    fine : int
        Even.
    """
    from scipy import signal

    kept = moves_by_bands(position, rate_hz, resolution)
    # a difference stands for the middle of its period, which lies between two fine steps: hence the even length
    kernel = fine * _fir(LAST_BAND_SHARE * rate_hz, 0.16 * rate_hz, fine * rate_hz, is_even=True)
    spread: Any = signal.upfirdn(kernel, kept, up=fine)[kernel.size // 2 - fine // 2 :]
    return np.concatenate([spread, np.zeros(fine)])[: len(kept) * fine]


def moves_by_bands(position: Array, rate_hz: float, resolution: float) -> Array:
    """Mean velocity over every sampling period, (n - 1,), from a counted position (n,).

    Each band is kept as far as it stands out from the encoder's noise just then.
    """
    moves = np.diff(position) * rate_hz  # differences are filtered: images of a large position would be a velocity
    cuts = _band_edges(rate_hz)
    kernels = [_fir(cut, min(0.7 * cut, 2.0 * (0.48 * rate_hz - cut)), rate_hz) for cut in cuts]
    kept = low = _centred(moves, kernels[0])
    for i, cut in enumerate(cuts[1:], start=1):
        high = _centred(moves, kernels[i])
        band = high - low
        noise = _NOISE_FACTOR * _noise(kernels[i - 1], kernels[i], resolution, rate_hz)
        power = _local_power(band, rate_hz / cut)
        kept = kept + np.maximum(1.0 - noise / np.maximum(power, 1e-300), 0.0) * band
        low = high
    return kept


def at_full_rate(record: RegressionSegment) -> RegressionSegment:
    """Motion of a record by bands and its torque as it was measured, instead of both low-passed.

    What happens in a few samples stays, such as a reversal; velocities are means over the sampling period before each
    row, as models take them.
    """
    assert record.resolution is not None
    rate = record.rate_hz
    velocity = np.concatenate([[0.0], moves_by_bands(record.encoder, rate, record.resolution)])
    edge = _fir(_FIRST_BAND_HZ, 0.7 * _FIRST_BAND_HZ, rate).size // 2
    return replace(
        record,
        position=record.encoder,
        velocity=velocity,
        acceleration=np.append(np.diff(velocity) * rate, 0.0),
        lowpass_hz=None,
        begin=edge,
        end=len(velocity) - edge,
    )


def _band_edges(rate_hz: float) -> list[float]:
    """Octaves from 40 Hz, the last of them up to 0.42 of the sampling rate."""
    edges = [_FIRST_BAND_HZ]
    while 2.0 * edges[-1] < 0.3 * rate_hz:
        edges.append(2.0 * edges[-1])
    return [*edges, LAST_BAND_SHARE * rate_hz]


def _local_power(values: Array, samples: float) -> Array:
    """Mean square over about two times ``samples``."""
    window = np.hanning(2 * round(samples) + 3)
    return _centred(values * values, window / window.sum())


def _noise(lower: Array, upper: Array, resolution: float, rate_hz: float) -> float:
    """Mean square that an encoder's counts leave in the band between two low-passes of its differences."""
    size = max(lower.size, upper.size)
    response = np.diff(_padded(upper, size) - _padded(lower, size), prepend=0.0, append=0.0)
    return resolution**2 / 12.0 * rate_hz**2 * float(np.sum(response**2))


def _padded(kernel: Array, size: int) -> Array:
    return np.pad(kernel, (size - kernel.size) // 2)


@cache
def _fir(cut_hz: float, width_hz: float, rate_hz: float, is_even: bool = False) -> Array:
    """Symmetric low-pass, 80 dB.

    Source of length and window: J. F. Kaiser, Nonrecursive digital filter design using the I0-sinh window function,
    IEEE International Symposium on Circuits and Systems, 1974.
    """
    taps = math.ceil((_ATTENUATION_DB - 7.95) / (2.285 * math.tau * width_hz / rate_hz)) + 1
    taps += (taps % 2 == 0) != is_even
    kernel: Array = np.sinc(2.0 * cut_hz / rate_hz * (np.arange(taps) - 0.5 * (taps - 1)))
    kernel *= np.kaiser(taps, 0.1102 * (_ATTENUATION_DB - 8.7))
    kernel /= kernel.sum()
    return kernel


def _centred(values: Array, kernel: Array) -> Array:
    """``values`` (n,) through a symmetric FIR of odd length, without delay, as if they were zero outside."""
    padded = _convolved(values, kernel) if kernel.size > _LONG else np.convolve(values, kernel)
    return padded[kernel.size // 2 :][: len(values)]


def _convolved(values: Array, kernel: Array) -> Array:
    """`np.convolve` by Fourier transforms."""
    size = values.size + kernel.size - 1
    room = 1 << (size - 1).bit_length()
    product: Array = np.fft.irfft(np.fft.rfft(values, room) * np.fft.rfft(kernel, room), room)
    return product[:size]


def local_rms(values: Array, seconds: float) -> Array:
    """Root mean square nearby of rows of the regression (k,)."""
    return np.sqrt(np.maximum(_local_power(values, 0.5 * seconds * ROWS_HZ), 0.0))
