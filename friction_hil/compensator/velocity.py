"""Velocity of an axis estimated from its position feedback, with known delay and noise.

Pure: one compiled step (`update`, or `predict` without fresh feedback) over flat records that other records embed.
All estimators except the drive's own velocity are one observer: the state is predicted over the cycle,

    x += T v + T^2/2 (u + d)/J,    v += T (u + d)/J,    d *= leak,

and corrected by gains times the innovation, measured minus predicted position. They differ in their gains:

* *difference*: encoder difference through a one-pole filter, poles 0 and 1 - smoothing; no torque.
* *tracking*: critically damped tracking loop of type 2, both poles exp(-w T); no torque.
* *kalman*: u is the known torque, d the unknown torque, of given size and correlation time. The covariance is updated
  too: after a gap the gains of the steady state would not be stable.

Positions are kept as differences from the last sample, so that a great distance costs no precision. A single sample
that no possible motion explains is ignored, as if it were missing. So is one that may be late: a frame of the cycle
before puts the axis back by the way of a cycle, and the frame after it counts as double speed. Such a sample lies off
the line through the ones before, and off the way by the velocity that the drive itself reports. Two such samples in a
row are taken as they are.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from friction_hil.errors import UsageError, choices
from friction_hil.numerics.jit import Array, StructuredArray, inlined

KINDS = ("difference", "tracking", "kalman", "drive")
MAX_GAP_CYCLES = 10  # after a longer gap the estimate starts anew

# Error of a valid sample
_SAMPLE_ERROR_COUNTS = 1.5  # half a count of rounding and one of flicker
_SAMPLE_ERROR_CYCLES = 0.1  # taken early or late, on a jittery bus

# A sample may be late where it is off by more than these
_LATE_CYCLES = 0.5  # of the way in a cycle
_LATE_FRACTION = 0.05  # of the largest acceleration's way in a cycle

SETTINGS = np.dtype(
    [
        ("uses_drive_velocity", "f8"),
        ("period_s", "f8"),
        ("inverse_inertia", "f8"),  # 0: torque not used
        ("leak", "f8"),  # of the unknown torque, a cycle
        ("position_gain", "f8", (MAX_GAP_CYCLES,)),  # [n - 1] after n cycles; not of kalman
        ("velocity_gain", "f8", (MAX_GAP_CYCLES,)),  # 1/s; of the drive's velocity: 1
        ("wander", "f8"),  # variance by which the unknown torque grows a cycle, in the unit of the covariance
        ("covariance", "f8", (6,)),  # after a sample, in the steady state
        ("acceleration_step", "f8"),  # largest acceleration times period squared
        ("sample_error", "f8"),
    ]
)

STATE = np.dtype(
    [
        ("is_running", "f8"),  # 0 before the first position
        ("cycle", "f8"),  # to which the state is predicted
        ("position_cycle", "f8"),  # of the last position used
        ("position", "f8"),
        ("offset", "f8"),  # estimated position, less that
        ("velocity", "f8"),
        ("torque", "f8"),  # estimate of the unknown torque
        ("covariance", "f8", (6,)),  # xx, xv, xa, vv, va, aa; in cycles and rounding errors of the position
        ("drive_velocity", "f8"),  # reported with the last position used; 0 before the first finite one
        ("slope", "f8"),  # between the last two positions used, per cycle
        ("slope_cycles", "f8"),  # between these two; 0 if there is only one
        ("has_suspect", "f8"),  # the last sample was ignored
        ("suspect", "f8"),
        ("suspect_cycle", "f8"),
        ("glitches", "f8"),  # samples ignored
    ]
)


@inlined
def _take(r: Any, cycle: float, position: float, offset: float, v: float, d: float, slope: float, apart: float) -> None:
    if math.isfinite(offset + v + d + slope):
        r.position_cycle, r.position, r.offset, r.velocity, r.torque = cycle, position, offset, v, d
        r.slope, r.slope_cycles, r.has_suspect = slope, apart, 0.0


@inlined
def _keep_drive_velocity(r: Any, drive_velocity: float) -> None:
    if math.isfinite(drive_velocity):
        r.drive_velocity = drive_velocity


@inlined
def begin(c: Any, r: Any, cycle: float, position: float, drive_velocity: float) -> None:
    """Start anew at a finite position, with the drive's velocity, or at rest if that is not finite."""
    r.is_running = 1.0
    r.cycle = cycle
    r.drive_velocity = 0.0
    _keep_drive_velocity(r, drive_velocity)
    _take(r, cycle, position, 0.0, drive_velocity if math.isfinite(drive_velocity) else 0.0, 0.0, 0.0, 0.0)
    for k in range(6):
        r.covariance[k] = c.covariance[k]


@inlined
def _forget(p: Any, leak: float, wander: float) -> None:
    """Predict the covariance over a cycle: F P F' + Q, Q being that of a torque that wanders within the cycle."""
    xx, xv, xa, vv, va, aa = p[0], p[1], p[2], p[3], p[4], p[5]
    p[0] = xx + 2.0 * xv + xa + vv + va + 0.25 * aa + wander / 20.0
    p[1] = xv + xa + vv + 1.5 * va + 0.5 * aa + wander / 8.0
    p[2] = leak * (xa + va + 0.5 * aa) + wander / 6.0
    p[3] = vv + 2.0 * va + aa + wander / 3.0
    p[4] = leak * (va + aa) + wander / 2.0
    p[5] = leak * leak * aa + wander


@inlined
def _learn(p: Any) -> None:
    """Update the covariance with a sample of variance 1; its first row is then the gain."""
    x, v, a = p[0], p[1], p[2]
    p[0], p[1], p[2] = x / (x + 1.0), v / (x + 1.0), a / (x + 1.0)
    p[3] -= v * p[1]
    p[4] -= v * p[2]
    p[5] -= a * p[2]


@inlined
def predict(c: Any, r: Any, cycle: float, net_torque: float) -> None:
    """Predict the state at ``cycle`` without a position: from the torque if it is known, else at constant velocity.

    The prediction ends `MAX_GAP_CYCLES` after the last position; from there on the velocity is held.
    """
    cycles = min(cycle, r.position_cycle + MAX_GAP_CYCLES) - r.cycle
    if r.is_running == 0.0 or not cycles > 0.0:
        return
    known = net_torque if math.isfinite(net_torque) else 0.0
    offset, velocity, torque = r.offset, r.velocity, r.torque
    for _ in range(int(cycles)):
        acceleration = (known + torque) * c.inverse_inertia
        offset += c.period_s * (velocity + 0.5 * c.period_s * acceleration)
        velocity += c.period_s * acceleration
        torque *= c.leak
        if c.inverse_inertia > 0.0:
            _forget(r.covariance, c.leak, c.wander)
    r.cycle = cycle
    if math.isfinite(offset + velocity):
        r.offset, r.velocity, r.torque = offset, velocity, torque


@inlined
def _is_explained(c: Any, r: Any, position: float, cycles: float) -> bool:
    """Return True if a motion within the largest acceleration leads through the last two positions to this one.

    The displacement over n cycles differs from the straight line through two positions m cycles apart by at
    most a T^2 n (n + m) / 2; errors of the samples add.
    """
    if r.slope_cycles == 0.0:
        return True
    error = c.sample_error + _SAMPLE_ERROR_CYCLES * abs(r.slope)
    allowance = c.acceleration_step * 0.5 * cycles * (cycles + r.slope_cycles)
    allowance += 2.0 * error * (1.0 + cycles / r.slope_cycles)
    return bool(abs(position - r.position - r.slope * cycles) <= allowance)


@inlined
def _may_be_late(c: Any, r: Any, position: float, drive_velocity: float, cycles: float) -> bool:
    """Return True if a position seems to be of an earlier cycle, or to follow one that was.

    It lies off the line through the last two positions, and off the way by the velocity that the drive reports. An
    axis that really changes its velocity reports that.
    """
    if r.slope_cycles == 0.0 or not (math.isfinite(drive_velocity) and math.isfinite(c.acceleration_step)):
        return False
    way = position - r.position
    allowance = _LATE_CYCLES * abs(r.slope) + _LATE_FRACTION * c.acceleration_step + 2.0 * c.sample_error
    way_of_drive = 0.5 * (r.drive_velocity + drive_velocity) * c.period_s * cycles
    is_off_line = abs(way - r.slope * cycles) > allowance + 2.0 * c.sample_error * cycles / r.slope_cycles
    return bool(is_off_line and abs(way - way_of_drive) > allowance)


@inlined
def _correct(c: Any, r: Any, cycle: float, position: float, cycles: float) -> None:
    """Correct the state with a position that a possible motion explains."""
    innovation = position - r.position - r.offset
    n = int(cycles) - 1
    position_gain, velocity_gain, torque = c.position_gain[n], c.velocity_gain[n], 0.0
    if c.inverse_inertia > 0.0:
        _learn(r.covariance)
        position_gain, velocity_gain = r.covariance[0], r.covariance[1] / c.period_s
        torque = r.torque + r.covariance[2] * innovation / (c.inverse_inertia * c.period_s * c.period_s)
    offset = (position_gain - 1.0) * innovation
    velocity = r.velocity + velocity_gain * innovation
    _take(r, cycle, position, offset, velocity, torque, (position - r.position) / cycles, cycles)


@inlined
def _jump(c: Any, r: Any, cycle: float, position: float) -> None:
    """Continue from a new position; the velocity changes towards the one seen there within the largest acceleration."""
    apart = cycle - r.suspect_cycle
    slope = (position - r.suspect) / apart
    change = slope - r.velocity * c.period_s
    beyond_noise = max(abs(change) - 2.0 * c.sample_error / apart, 0.0)
    velocity = r.velocity + math.copysign(min(beyond_noise, c.acceleration_step * apart), change) / c.period_s
    _take(r, cycle, position, 0.0, velocity, r.torque, slope, apart)


@inlined
def update(c: Any, r: Any, cycle: float, position: float, drive_velocity: float, net_torque: float) -> None:
    """Update the estimate, ``r.velocity``, with one cycle's fresh feedback.

    ``c``, ``r``: elements of `SETTINGS` and `STATE`; a state of zeros has not started. A ``cycle`` (whole) that does
    not follow the last starts anew. A drive velocity that is not finite counts as unknown. ``net_torque``, for
    ``kalman``: known torque on the inertia over the cycle that ends here, N m: torque of the drive less friction and
    gravity. If a value that is used is not finite, the cycle counts as one without fresh feedback.
    """
    uses_drive = c.uses_drive_velocity > 0.0
    cycles = cycle - r.position_cycle
    is_usable = math.isfinite(drive_velocity) or not uses_drive
    is_usable = is_usable and (math.isfinite(net_torque) or c.inverse_inertia == 0.0)
    if not (math.isfinite(position) and is_usable):
        predict(c, r, cycle, net_torque)
    elif r.is_running == 0.0 or not (cycle > r.cycle and cycles <= MAX_GAP_CYCLES):
        begin(c, r, cycle, position, drive_velocity)
    elif uses_drive:
        r.cycle = cycle
        velocity = r.velocity + c.velocity_gain[int(cycles) - 1] * (drive_velocity - r.velocity)
        _take(r, cycle, position, 0.0, velocity, 0.0, 0.0, 0.0)
    else:
        predict(c, r, cycle, net_torque)
        if _is_explained(c, r, position, cycles) and not _may_be_late(c, r, position, drive_velocity, cycles):
            _correct(c, r, cycle, position, cycles)
            _keep_drive_velocity(r, drive_velocity)
        elif r.has_suspect > 0.0:
            _jump(c, r, cycle, position)  # two in a row are no glitch: a new position, or an impact
            _keep_drive_velocity(r, drive_velocity)
        else:
            r.has_suspect, r.suspect, r.suspect_cycle = 1.0, position, cycle
            r.glitches += 1.0


@dataclass(frozen=True)
class VelocityEstimator:
    """Settings, delay and noise of an estimator; a value that is missing or out of range raises a `UsageError`.

    SI; NaN stands for a value that is not given.
    """

    kind: str  # one of `KINDS`
    period_s: float  # of the loop
    resolution: float  # smallest step of the position
    # `difference`, `drive`: coefficient of the one-pole filter, 0 < smoothing <= 1; 1 filters nothing
    smoothing: float = 0.5
    # `tracking`: acceleration to follow, from which the bandwidth with the least sum of squares of lag and noise is
    # computed
    acceleration: float = math.nan
    bandwidth_hz: float = math.nan  # or the natural frequency itself
    inertia: float = math.nan  # `kalman`: inertia, kg m^2, or mass
    # `kalman`: standard deviation of the unknown torque, N m; if it and the next are too small, an error of the torque
    # appears as velocity
    torque_uncertainty: float = math.nan
    uncertainty_time_s: float = 0.05  # its correlation time
    drive_delay_cycles: float = 0.0  # `drive`: age of the drive's own velocity
    drive_noise: float = math.nan  # rms; by default noisy as an encoder difference
    # largest possible one, torque / inertia: a position beyond it is a glitch, and one off by more than a twentieth of
    # it may be late; infinity disables both checks
    max_acceleration: float = math.inf

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise UsageError(f"velocity: {self.kind!r} is no kind of estimator; {choices(self.kind, KINDS)}")
        if not 0.0 < self.smoothing <= 1.0:
            raise UsageError(f"velocity: smoothing = {self.smoothing:g} must be above 0 and at most 1")
        if not self.max_acceleration > 0.0:
            raise UsageError(f"velocity: max_acceleration = {self.max_acceleration:g} must be above 0")
        needed = ["period_s", "resolution", "uncertainty_time_s"]
        if self.kind == "tracking":
            needed += ["acceleration" if math.isnan(self.bandwidth_hz) else "bandwidth_hz"]
        elif self.kind == "kalman":
            needed += ["inertia", "torque_uncertainty"]
        for name in needed:
            value = getattr(self, name)
            if not 0.0 < value < math.inf:
                raise UsageError(f"velocity: {self.kind} needs {name}, finite and above zero, not {value:g}")

    @cached_property
    def record(self) -> StructuredArray:
        """Settings as a record of type `SETTINGS`, (1,)."""
        record = np.zeros(1, SETTINGS)
        c = record[0]
        c["uses_drive_velocity"] = self.kind == "drive"
        c["period_s"] = self.period_s
        c["acceleration_step"] = self.max_acceleration * self.period_s**2
        c["sample_error"] = _SAMPLE_ERROR_COUNTS * self.resolution
        if self.kind == "kalman":
            c["inverse_inertia"] = 1.0 / self.inertia
            c["leak"] = 1.0 - self._loss
            c["wander"] = self._wander
            c["covariance"] = self._kalman[1]
        else:
            c["position_gain"], velocity_gain, _ = self._gains.T
            c["velocity_gain"] = velocity_gain if self.kind == "drive" else velocity_gain / self.period_s
        return record

    @cached_property
    def delay_cycles(self) -> float:
        """Delay of the estimate: cycles of lag under constant acceleration, for ``kalman`` by an unknown torque."""
        position, velocity, torque = self._gains[0]
        if self.kind == "drive":
            return float(1.0 / velocity - 1.0 + self.drive_delay_cycles)
        # the acceleration consists of the correction of the velocity and of the unknown torque, held against its leak
        return float((position - 0.5 * velocity) / (velocity + torque / self._loss))

    @cached_property
    def noise(self) -> float:
        """Root mean square of the velocity, SI, that rounding the position causes, taken as white."""
        per_cycle = self.resolution / math.sqrt(12.0) / self.period_s
        g, h, _ = self._gains[0]
        if self.kind == "drive":
            own = math.sqrt(2.0) * per_cycle if math.isnan(self.drive_noise) else self.drive_noise
            return float(own * math.sqrt(h / (2.0 - h)))
        if self.kind == "kalman":
            return self._kalman[2] * per_cycle
        return float(per_cycle * h * math.sqrt(2.0 / (g * (4.0 - 2.0 * g - h))))  # of an alpha-beta filter

    @property
    def _loss(self) -> float:
        """Fraction of the unknown torque that decays in a cycle."""
        return max(-math.expm1(-self.period_s / self.uncertainty_time_s), 1e-12)

    @cached_property
    def _gains(self) -> Array:
        """Gains for position, velocity and acceleration, per cycle, after 1, 2, ... cycles (kalman: 1); (n, 3)."""
        if self.kind == "kalman":
            return self._kalman[0]
        n = np.arange(1.0, MAX_GAP_CYCLES + 1.0)
        if self.kind != "tracking":
            learned = 1.0 - (1.0 - self.smoothing) ** n
            return np.column_stack((np.ones_like(n), learned if self.kind == "drive" else learned / n, 0.0 * n))
        frequency = 2.0 * math.pi * self.bandwidth_hz * self.period_s
        if math.isnan(frequency):
            # least (2 a/w)^2 + w^3/4, in roundings and cycles, w small; with a greater one it is a plain difference
            step = self.acceleration * self.period_s**2 / (self.resolution / math.sqrt(12.0))
            frequency = (32.0 / 3.0 * step**2) ** 0.2
        learned = -np.expm1(-n * frequency)  # by each of the two poles
        return np.column_stack((learned * (2.0 - learned), learned**2 / n, 0.0 * n))

    @property
    def _wander(self) -> float:
        """Variance by which the unknown acceleration grows in a cycle, in roundings and cycles."""
        unit = self.resolution / math.sqrt(12.0) / self.period_s**2
        unknown = self.torque_uncertainty / self.inertia / unit
        return min(max(unknown * unknown * self._loss * (2.0 - self._loss), 1e-24), 1e9)  # beyond, gains stay the same

    @cached_property
    def _kalman(self) -> tuple[Array, Array, float]:
        """Steady state: gains, (1, 3); covariance after a sample, (6,); and noise in roundings a cycle."""
        # imported here: scipy is slow to load, and only this estimator needs it
        from scipy import linalg

        loss, wander = self._loss, self._wander
        bandwidth = min(1.0, wander ** (1.0 / 6.0), (wander / loss**2) ** 0.25)
        scale = bandwidth ** np.arange(3.0)  # else the equation is badly conditioned
        F = np.array([[1.0, 1.0, 0.5], [0.0, 1.0, 1.0], [0.0, 0.0, 1.0 - loss]]) * scale / scale[:, None]
        Q = np.array([[1 / 20, 1 / 8, 1 / 6], [1 / 8, 1 / 3, 1 / 2], [1 / 6, 1 / 2, 1.0]]) * wander
        H = np.array([[1.0, 0.0, 0.0]])
        before = linalg.solve_discrete_are(F.T, H.T, Q / np.outer(scale, scale), np.eye(1))
        gains = before[:1] / (before[0, 0] + 1.0)
        learned = np.eye(3) - gains.T @ H
        after = learned @ before * np.outer(scale, scale)
        error = linalg.solve_discrete_lyapunov(learned @ F, gains.T @ gains)
        return gains * scale, after[np.triu_indices(3)], float(bandwidth * math.sqrt(error[1, 1]))
