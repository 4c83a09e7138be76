"""Motion and torque of the motor at the full rate, ready for the fit of two masses. Pure.

Nothing but the low-pass of the comparison is applied to the position, and to both sides once. The torque is moved back
by its age, and a mean over the period is made the torque of its middle. Friction needs the moment of each reversal
between two samples: its direction is that of a velocity that is interpolated to several points a sample.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from friction_hil.identification import thresholds as th
from friction_hil.numerics import filtering
from friction_hil.numerics.jit import Array, compiled
from friction_hil.recordings.quality import acceleration_noise, resolution
from friction_hil.recordings.segments import Segment, between_counts

Force = Callable[[Array, float], Array]

POINTS = 4  # a sample, of the velocity that gives the direction of friction


@dataclass(frozen=True, slots=True, eq=False)
class MotorMotion:
    """What the fit of two masses needs of one evenly sampled record; arrays (n,) at the samples."""

    dt: float  # sampling period, s
    position: Array  # of the motor, as measured
    fine_velocity: Array  # (n * POINTS,) of the motor
    torque: Array  # measured, as it was at the sample
    # (n, m), terms that are linear: acceleration, delay, offset, viscous friction, gravity; then friction of a known
    # model
    columns: Array
    load: Array  # torque that acts on the load and opposes positive motion: gravity
    cutoff_hz: float  # of the low-pass that both sides pass
    rows: NDArray[np.intp]  # that are compared

    def compared(self, values: Array) -> Array:
        """Low-pass values (n,) or (n, m), and return the rows that are compared."""
        return np.ascontiguousarray(filtering.lowpass(values, self.cutoff_hz, 1.0 / self.dt)[self.rows])

    def bristle(self, stroke: float) -> Array:
        """Return the deflection (n,) of Dahl's bristle, from -1 to 1, that has let go after about ``stroke``."""
        return _at_samples(_deflection(self.fine_velocity * (self.dt / POINTS), stroke), self.dt)

    @property
    def starts(self) -> NDArray[np.intp]:
        """First compared row of each stretch of time, among the compared ones."""
        numbers = self.rows // max(1, round(th.STRETCH_S / self.dt))
        return np.flatnonzero(np.diff(numbers, prepend=-1))


def motor_motion(
    segment: Segment,
    *,
    gravity: Array,  # (n,), known torque of gravity, N m or N, which is taken to act on the load
    # (n, m), torques of gravity per unit of each of its parameters that were identified; their factors are fitted again
    swing: Array,
    delay_s: float,  # age of the measured torque
    is_mean: bool,  # the measured torque is a mean over the sampling period
    inertia: float,  # roughly, of the axis: what the noise of the encoder's counts costs
    friction: Force | None = None,  # torque (n,) of a known friction model over a velocity (n,) and its period
    cutoff_hz: float | None = None,  # of the comparison; None: as high as the encoder allows
) -> MotorMotion | None:
    """Prepare a segment; None if the record is too short, or the encoder too coarse for its accelerations."""
    dt, rate = segment.dt, segment.rate_hz
    count = resolution(segment.encoder) or 0.0
    position = between_counts(segment.encoder)
    if cutoff_hz is None:
        cutoff_hz = _cutoff(segment.torque, inertia, count, rate)
    edge = max(math.ceil(th.SETTLED_S * rate), filtering.settling_samples(cutoff_hz, rate)) if cutoff_hz else 0
    if cutoff_hz is None or len(position) < 4 * edge:
        return None
    velocity = derivatives(filtering.lowpass(position, _direction_hz(position, count, rate), rate), dt)[0]
    fine = _between_samples(velocity)
    torque = _at_its_time(segment.torque, dt, delay_s, is_mean=is_mean)
    known = [] if friction is None else [_at_samples(friction(fine, dt / POINTS), dt)]
    columns = np.column_stack(
        [
            derivatives(position, dt)[1],
            -np.gradient(torque, dt),
            np.ones_like(position),
            velocity,
            *swing.T,
            *known,
        ]
    )
    every = max(1, int(rate / (th.MOTION_ROWS_PER_PERIOD * cutoff_hz)))
    rows = np.arange(edge, len(position) - edge, every)
    rows = rows[~_stuck(segment.encoder, count, round(0.5 * rate / cutoff_hz))[rows]]
    if len(rows) < 100:
        return None
    return MotorMotion(dt, position, fine, torque, columns, gravity, cutoff_hz, rows)


def _cutoff(torque: Array, inertia: float, count: float, rate: float) -> float | None:
    """Return the highest frequency at which counts of the encoder make little torque; None if there is none."""
    cutoff, least = th.MOTION_TOP_RATIO * rate, th.MOTION_LEAST_RATIO * rate
    while cutoff > least:
        if inertia * acceleration_noise(count, cutoff, rate) <= th.MOTION_NOISE * float(np.std(torque)):
            return cutoff
        cutoff *= th.MOTION_STEP
    return None


def _direction_hz(position: Array, count: float, rate: float) -> float:
    cutoff = th.DIRECTION_RATIO * rate
    speed = float(np.sqrt(np.mean(np.diff(position) ** 2))) * rate
    while cutoff > th.MOTION_LEAST_RATIO * rate:
        noise = count / math.sqrt(12.0) * math.sqrt(2.0 * cutoff / (3.0 * rate)) * math.tau * cutoff
        if noise <= th.NOISY_SPEED * speed:
            break
        cutoff *= th.MOTION_STEP
    return cutoff


def _stuck(encoder: Array, count: float, reach: int) -> NDArray[np.bool_]:
    """Return the rows (n,) within ``reach`` rows of standstill: there friction is whatever holds the motor."""
    from scipy.ndimage import maximum_filter1d, minimum_filter1d  # imported here: commands start faster without it

    moved = maximum_filter1d(encoder, th.STUCK_ROWS) - minimum_filter1d(encoder, th.STUCK_ROWS)
    least = max(th.STUCK_COUNTS * count, th.STUCK_RATIO * float(np.median(moved)))
    return np.asarray(maximum_filter1d((moved < least).astype(np.uint8), 2 * reach + 1) > 0)


def _at_its_time(torque: Array, dt: float, delay_s: float, *, is_mean: bool) -> Array:
    """Return the torque (n,) moved back by its age; a mean over the period becomes the torque in the middle of it."""
    n = len(torque)
    frequency = np.fft.rfftfreq(2 * n, dt)
    spectrum = np.fft.rfft(np.concatenate([torque, torque[::-1]])) * np.exp(2j * math.pi * frequency * delay_s)
    if is_mean:
        spectrum /= np.sinc(frequency * dt)
    return np.asarray(np.fft.irfft(spectrum, 2 * n)[:n])


def _between_samples(values: Array) -> Array:
    """Interpolate (n,) to `POINTS` a sample, by Fourier series of the record and its mirror image."""
    n = len(values)
    spectrum = np.zeros(n * POINTS + 1, dtype=complex)
    spectrum[: n + 1] = np.fft.rfft(np.concatenate([values, values[::-1]]))
    return np.asarray(np.fft.irfft(spectrum, 2 * n * POINTS)[: n * POINTS] * POINTS)


def _at_samples(fine: Array, dt: float) -> Array:
    low = filtering.lowpass(fine, th.ANTIALIAS / dt, POINTS / dt)
    return np.ascontiguousarray(low[::POINTS])


def derivatives(position: Array, dt: float) -> tuple[Array, Array]:
    """Return velocity and acceleration (n,) by differences of fourth order.

    The gradient of a gradient loses 43 % of an acceleration at a fifth of the sampling rate, which makes an inertia too
    large at low rates; these lose 2 %. Source: B. Fornberg, Mathematics of Computation 51, 1988.
    """
    q = np.pad(position, 2, mode="reflect", reflect_type="odd")
    velocity = (8.0 * (q[3:-1] - q[1:-3]) - (q[4:] - q[:-4])) / (12.0 * dt)
    return velocity, (16.0 * (q[3:-1] + q[1:-3]) - (q[4:] + q[:-4]) - 30.0 * q[2:-2]) / (12.0 * dt * dt)


@compiled
def _deflection(steps: Array, stroke: float) -> Array:
    """Return Dahl's bristle over steps of the position: exact for a step in one direction."""
    found = np.empty_like(steps)
    z = 0.0
    for i in range(len(steps)):
        side = 1.0 if steps[i] > 0.0 else -1.0
        z = side + (z - side) * math.exp(-abs(steps[i]) / stroke)
        found[i] = z
    return found
