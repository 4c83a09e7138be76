"""Segments that resolve presliding: motion below a count of the encoder, and several model steps per sample.

An ordinary segment (`friction_hil.identification.data`) low-passes the position once, as strongly as its slowest part
requires, which removes the motion of a presliding spring within milliseconds. Here the differences of the position are
split into bands. Each band is kept in proportion to its power above the encoder's noise at that time, and the model
runs in several steps per sample.

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
from friction_hil.identification import thresholds as th
from friction_hil.identification.data import Data, RegressionSegment
from friction_hil.motion.experiment import LEAST_RATE_HZ, is_fast
from friction_hil.numerics.jit import Array
from friction_hil.recordings.quality import is_last_digit

_ATTENUATION_DB = 80.0
_LONG = 400  # taps; longer kernels are faster by Fourier transforms


@dataclass(frozen=True, slots=True, eq=False)
class FineSegment(RegressionSegment):
    """Segment whose motion is given at the steps of the model; its (n, ...) arrays have a row for each step."""

    fine: int  # steps per sample
    is_mean: bool  # a measured torque is the mean over the period that ends at the sample; False: instantaneous
    samples: Array  # measured torque at the samples 1...
    delay_s: float = 0.0  # further delay of the measured torque, behind the position of the same sample

    @property
    def sample_hz(self) -> float:
        """Sampling rate, Hz."""
        return self.rate_hz / self.fine

    def at_samples(self, values: Array) -> Array:
        """Convert values at the ends of steps to samples 1..., as the drive would report them."""
        if self.delay_s:
            values = _delayed(values, self.delay_s * self.rate_hz)
        ends = values[self.fine - 1 :: self.fine]
        if not self.is_mean:
            return ends
        mean: Array = values.reshape((-1, self.fine, *values.shape[1:])).mean(
            axis=1
        )  # rectangular rule, half a step late
        mean[1:] -= 0.5 / self.fine * np.diff(ends, axis=0)  # trapezoidal rule
        return mean

    def reduce(self, values: Array) -> Array:
        """Convert values at the ends of steps, (n,) or (n, m), to the rows of the regression."""
        return self._low(self.at_samples(values))

    def reduce_smooth(self, values: Array) -> Array:
        """Return the same as `reduce`."""
        return self.reduce(values)

    def reduced_torque(self) -> Array:
        """Return the measured torque in the rows of the regression."""
        return self._low(self.samples)

    def reduced_time(self) -> Array:
        """Return the time stamps of the rows of the regression, s."""
        ends = self.time_s[self.fine - 1 :: self.fine]
        return np.ascontiguousarray(ends[self._edge : len(ends) - self._edge : self.decimation])

    @property
    def _edge(self) -> int:
        kernel = _fir(th.RESIDUAL_HZ, th.RESIDUAL_WIDTH_HZ, self.sample_hz)
        return max(round(th.FINE_EDGE_S * self.sample_hz), kernel.size + self.decimation)

    def _low(self, values: Array) -> Array:
        """Apply the low-pass of the residual without the ends of the segment; compute only the rows that are kept."""
        from scipy import signal  # imported here: it takes longer than the identification of a model

        kernel = _fir(th.RESIDUAL_HZ, th.RESIDUAL_WIDTH_HZ, self.sample_hz)
        half, edge, every = kernel.size // 2, self._edge, self.decimation
        ahead = -2 * half % every
        kept: Any = signal.upfirdn(kernel, values[edge - half - ahead :], down=every, axis=0)
        first = (2 * half + ahead) // every
        return np.ascontiguousarray(kept[first : first + -(-(len(values) - 2 * edge) // every)])


def _delayed(values: Array, steps: float) -> Array:
    """Return (n, ...) values as they were a number of steps ago, not a whole one; the first ones are repeated."""
    at = np.arange(len(values)) - steps
    whole = np.floor(at).astype(int)
    fraction = (at - whole).reshape((-1,) + (1,) * (values.ndim - 1))
    low, high = (np.clip(whole + i, 0, len(values) - 1) for i in (0, 1))
    delayed: Array = (1.0 - fraction) * values[low] + fraction * values[high]
    return delayed


def is_fine(record: RegressionSegment) -> bool:
    """True if a segment can be refined: quantised position, fast sampling, long enough, and all rows count."""
    if record.is_moving is not None:
        return False
    rate = record.rate_hz
    return record.resolution is not None and is_fast(rate) and len(record.encoder) >= th.LEAST_S * rate


def is_presliding_excited(record: RegressionSegment) -> bool:
    """True if a segment shows presliding: oscillations above 8 Hz, well above the encoder's noise, for some time.

    An axis that oscillates by more than it travels reverses in each oscillation, and each reversal passes through
    presliding.
    """
    if record.resolution is None or not is_fine(record):
        return False
    rate = record.rate_hz
    moves = np.diff(record.encoder) * rate
    slow_kernel, fast_kernel = (_fir(f, 0.7 * f, rate) for f in (th.SLOWEST_SWING_HZ, th.FASTEST_SWING_HZ))
    slow, fast = _centred(moves, slow_kernel), _centred(moves, fast_kernel)
    swing = _local_power(fast - slow, rate / th.SLOWEST_SWING_HZ)
    travel = _local_power(slow, rate / th.SLOWEST_SWING_HZ)
    noise = _noise(slow_kernel, fast_kernel, record.resolution, rate)
    return float(np.mean((swing > travel) & (swing > th.FINE_CLEAR * noise))) >= th.LEAST_FRACTION


def shows_presliding(records: Sequence[RegressionSegment], is_wanted: bool | None) -> bool:
    """Decide if a fit to these segments is refined: if all of them show presliding, unless the user has decided.

    Raises `RecordingError`: refinement is wanted, but not possible.
    """
    if is_wanted is None:
        return all(is_presliding_excited(each) for each in records)
    for each in records if is_wanted else ():
        if not is_fine(each):
            raise RecordingError(
                f"{each.path}: to refine a fit takes a position in steps of the encoder, not smoothed or "
                f"interpolated, at {LEAST_RATE_HZ:g} Hz or more, for {th.LEAST_S:g} s or more without a gap"
            )
    return is_wanted


def why_not_refined(records: Sequence[RegressionSegment]) -> list[str]:
    """Return why recordings that are fast enough for presliding are not refined, one sentence for each file."""
    found = []
    for each in records:
        is_long = is_fast(each.rate_hz) and each.is_moving is None and len(each.encoder) >= th.LEAST_S * each.rate_hz
        if each.has_position and is_long and each.resolution is None:
            found.append(
                f"{each.path}: the model is not refined at the encoder's resolution, because the position comes in "
                "no steps that show (it was smoothed, interpolated or rounded): stiffness, damping of the bristles and "
                "inertia are less certain than with a position in counts"
            )
    return list(dict.fromkeys(found))


def rounding_notes(records: Sequence[RegressionSegment]) -> list[str]:
    """Return what depends on the last digit of a position that a file has rounded, one sentence for each file."""
    found = [
        f"{each.path}: the position comes in steps of {each.resolution:g}, its last digit. If the encoder is finer, "
        "stiffness, damping, Stribeck velocity and inertia depend on this rounding: save more digits"
        for each in records
        if each.has_position and each.resolution is not None and is_last_digit(each.resolution, each.encoder)
    ]
    return list(dict.fromkeys(found))


def fine_data(
    records: Sequence[RegressionSegment], *, is_mean: bool, delay_s: float = 0.0, steps_hz: float = th.STEPS_HZ
) -> Data:
    """Refine segments whose position is quantised; the model runs in ``steps_hz`` steps per second.

    ``is_mean`` and ``delay_s`` are those of a `FineSegment`.
    """
    return Data([_fine_record(record, record.encoder, record.torque, is_mean, delay_s, steps_hz) for record in records])


def recounted(
    data: Data, originals: Sequence[RegressionSegment], torques: Sequence[Array], random: np.random.Generator
) -> Data:
    """Return data of the same motion, quantised again by an encoder with another offset, with other torques.

    ``data``: result of `fine_data` for ``originals``. ``torques``: (n,) at samples 1... that replace the measured ones.
    ``random``: source of the offsets of the counts.
    """
    found = []
    for fine, original, torque in zip(data.records, originals, torques, strict=True):
        assert isinstance(fine, FineSegment)
        assert original.resolution is not None
        path = np.concatenate([original.encoder[:1], fine.position[fine.fine - 1 :: fine.fine]])
        offset = random.uniform()
        counts = (np.floor(path / original.resolution + offset) - offset) * original.resolution
        found.append(_fine_record(original, counts, np.concatenate([torque[:1], torque]), fine.is_mean, fine.delay_s))
    return Data(found)


def _fine_record(
    record: RegressionSegment,
    position: Array,
    torque: Array,
    is_mean: bool,
    delay_s: float,
    steps_hz: float = th.STEPS_HZ,
) -> FineSegment:
    rate = record.rate_hz
    assert record.resolution is not None
    fine = 2 * max(1, round(0.5 * steps_hz / rate))
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
        lowpass_hz=th.RESIDUAL_HZ,
        decimation=max(1, round(rate / th.ROWS_HZ)),
        begin=0,
        end=len(velocity),
        problems=record.problems,
        encoder=position,
        resolution=record.resolution,
        group=record.group,
        fine=fine,
        is_mean=is_mean,
        samples=torque[1:],
        delay_s=delay_s,
    )


def velocity_by_bands(position: Array, rate_hz: float, resolution: float, fine: int) -> Array:
    """Compute the velocity in each of ``fine`` steps per sample, ((n - 1) * fine,), from a quantised position (n,).

    It is computed from differences, hence a mean over one sampling period about the step: a sine at a tenth of the
    sampling rate keeps 98 % of its amplitude. ``position`` and its step, ``resolution``, are in rad or m; ``fine`` is
    even.
    """
    from scipy import signal  # imported here: it takes longer than the identification of a model

    kept = moves_by_bands(position, rate_hz, resolution)
    # a difference belongs to the middle of its period, which is between two fine steps: hence the even length
    kernel = fine * _fir(th.LAST_BAND_RATIO * rate_hz, 0.16 * rate_hz, fine * rate_hz, is_even=True)
    spread: Any = signal.upfirdn(kernel, kept, up=fine)[kernel.size // 2 - fine // 2 :]
    return np.concatenate([spread, np.zeros(fine)])[: len(kept) * fine]


def moves_by_bands(position: Array, rate_hz: float, resolution: float) -> Array:
    """Compute the mean velocity over every sampling period, (n - 1,), from a quantised position (n,).

    Each band is kept in proportion to its power above the encoder's noise at that time.
    """
    moves = (
        np.diff(position) * rate_hz
    )  # differences are filtered: images of a large position would look like a velocity
    cuts = _band_edges(rate_hz)
    kernels = [_fir(cut, min(0.7 * cut, 2.0 * (0.48 * rate_hz - cut)), rate_hz) for cut in cuts]
    kept = low = _centred(moves, kernels[0])
    for i, cut in enumerate(cuts[1:], start=1):
        high = _centred(moves, kernels[i])
        band = high - low
        noise = th.NOISE_FACTOR * _noise(kernels[i - 1], kernels[i], resolution, rate_hz)
        power = _local_power(band, rate_hz / cut)
        kept = kept + np.maximum(1.0 - noise / np.maximum(power, 1e-300), 0.0) * band
        low = high
    return kept


def at_full_rate(record: RegressionSegment) -> RegressionSegment:
    """Return a segment with the velocity from bands and the measured torque, instead of both low-passed.

    It keeps what happens within a few samples, such as a reversal. Velocities are means over the sampling period before
    each row, as models expect them.
    """
    assert record.resolution is not None
    rate = record.rate_hz
    velocity = np.concatenate([[0.0], moves_by_bands(record.encoder, rate, record.resolution)])
    edge = _fir(th.FIRST_BAND_HZ, 0.7 * th.FIRST_BAND_HZ, rate).size // 2
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
    """Return octaves from 40 Hz, the last of them up to 0.42 of the sampling rate, Hz."""
    edges = [th.FIRST_BAND_HZ]
    while 2.0 * edges[-1] < 0.3 * rate_hz:
        edges.append(2.0 * edges[-1])
    return [*edges, th.LAST_BAND_RATIO * rate_hz]


def _local_power(values: Array, samples: float) -> Array:
    """Compute the mean square over about two times ``samples``."""
    window = np.hanning(2 * round(samples) + 3)
    return _centred(values * values, window / window.sum())


def _noise(lower: Array, upper: Array, resolution: float, rate_hz: float) -> float:
    """Compute the mean square of the quantisation noise in the band between two low-passes of the differences."""
    size = max(lower.size, upper.size)
    response = np.diff(_padded(upper, size) - _padded(lower, size), prepend=0.0, append=0.0)
    return resolution**2 / 12.0 * rate_hz**2 * float(np.sum(response**2))


def _padded(kernel: Array, size: int) -> Array:
    return np.pad(kernel, (size - kernel.size) // 2)


@cache
def _fir(cut_hz: float, width_hz: float, rate_hz: float, is_even: bool = False) -> Array:
    """Design a symmetric low-pass with 80 dB of attenuation.

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
    """Filter ``values`` (n,) with a symmetric FIR of odd length, without delay, as if they were zero outside."""
    padded = _convolved(values, kernel) if kernel.size > _LONG else np.convolve(values, kernel)
    return padded[kernel.size // 2 :][: len(values)]


def _convolved(values: Array, kernel: Array) -> Array:
    """Compute `np.convolve` by Fourier transforms."""
    size = values.size + kernel.size - 1
    room = 1 << (size - 1).bit_length()
    product: Array = np.fft.irfft(np.fft.rfft(values, room) * np.fft.rfft(kernel, room), room)
    return product[:size]


def local_rms(values: Array, seconds: float) -> Array:
    """Compute the local root mean square of rows of the regression (k,)."""
    return np.sqrt(np.maximum(_local_power(values, 0.5 * seconds * th.ROWS_HZ), 0.0))
