"""Encoders and torque feedback of a simulated servo with further parts: where, when and how exactly. Compiled.

Noise is a function of the sample's number and the seed, so that the same calls give the same bits.
"""

import math

import numpy as np

from friction_hil.numerics.jit import Array, StructuredArray, compiled, inner
from friction_hil.servo.mechanics import harmonics
from friction_hil.servo.records import HISTORY_ROOM

_STEP, _FIRST, _SECOND = np.uint64(0x9E3779B97F4A7C15), np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)
_SHIFTS = np.uint64(30), np.uint64(27), np.uint64(31), np.uint64(11)
_UNIT = 1.0 / 9007199254740992.0  # 2^-53
_ENCODER, _TORQUE = 1, 2  # streams of noise


@inner
def _uniform(stream: int, number: int) -> float:
    """Return a number in (0, 1): SplitMix64 (Steele, Lea, Flood, OOPSLA 2014) of a counter."""
    z = (np.uint64(number) + (np.uint64(stream) << np.uint64(48))) * _STEP
    z = (z ^ (z >> _SHIFTS[0])) * _FIRST
    z = (z ^ (z >> _SHIFTS[1])) * _SECOND
    z = z ^ (z >> _SHIFTS[2])
    return (float(z >> _SHIFTS[3]) + 0.5) * _UNIT


@inner
def normal(stream: int, number: int) -> float:
    """Return a normally distributed number of a stream (Box and Muller)."""
    radius = math.sqrt(-2.0 * math.log(_uniform(stream, 2 * number)))
    return radius * math.cos(2.0 * math.pi * _uniform(stream, 2 * number + 1))


@inner
def _delayed(history: Array, head: int, now: float, elapsed: float, delay: float, period: float) -> float:
    """Return a signal ``delay`` ago, linear between the samples; ``history`` is a ring whose newest is at ``head``."""
    if delay <= elapsed:
        return now + (history[head] - now) * (delay / elapsed) if delay > 0.0 else now
    samples = (delay - elapsed) / period
    whole = int(samples)
    after, before = history[(head - whole) % HISTORY_ROOM], history[(head - whole - 1) % HISTORY_ROOM]
    return after + (samples - whole) * (before - after)


@inner
def sample(plant: StructuredArray, s: StructuredArray) -> None:
    """Note position and torque at a sample of the drive's loops, for signals that arrive late."""
    c, r = plant[0], s[0]
    r.samples += 1
    r.sampled_at = r.steps
    if c.has_history > 0.0:
        r.head = (r.head + 1) % HISTORY_ROOM
        r.position_history[r.head] = r.load_position if c.is_load_measured > 0.0 else r.position
        r.torque_history[r.head] = r.torque


@inner
def position_counts(plant: StructuredArray, s: StructuredArray) -> float:
    """Return the present reading of the position loop's encoder, in whole counts."""
    c, r = plant[0], s[0]
    where = r.load_position if c.is_load_measured > 0.0 else r.position
    if c.is_encoder_plain > 0.0:
        return math.floor(where * c.load_counts_per_unit)
    if c.encoder_latency_s > 0.0:
        elapsed = (r.steps - r.sampled_at) * c.step_s
        period = c.steps_per_control * c.step_s
        where = _delayed(r.position_history, r.head, where, elapsed, c.encoder_latency_s, period)
    where += harmonics(c.encoder_error, where)[0]
    if c.encoder_noise > 0.0:
        where += c.encoder_noise * normal(_ENCODER + 16 * int(c.seed), r.samples)
    return math.floor(where * c.load_counts_per_unit)


@inner
def read_encoders(plant: StructuredArray, s: StructuredArray, dt: float) -> float:
    """Sample the encoders, estimate the velocity, and return the position for the drive's loops."""
    c, r = plant[0], s[0]
    sample(plant, s)
    reading = position_counts(plant, s)
    counts = reading
    if c.is_load_measured > 0.0 and c.is_load_velocity_measured == 0.0:
        counts = math.floor(r.position * c.counts_per_unit)
    measured = (counts - r.counts) / (c.counts_per_unit * dt)
    r.counts = counts
    r.velocity_estimate += c.velocity_filter_coefficient * (measured - r.velocity_estimate)
    return reading / c.load_counts_per_unit


@compiled
def reported_torque(plant: StructuredArray, s: StructuredArray) -> float:
    """Return the torque that the drive reports, N m."""
    c, r = plant[0], s[0]
    torque = r.torque
    if c.is_torque_plain > 0.0:
        return torque
    if c.torque_delay_s > 0.0:
        elapsed = (r.steps - r.sampled_at) * c.step_s
        period = c.steps_per_control * c.step_s
        torque = _delayed(r.torque_history, r.head, torque, elapsed, c.torque_delay_s, period)
    torque = c.torque_feedback_gain * torque + c.torque_feedback_offset
    if c.torque_noise > 0.0:
        torque += c.torque_noise * normal(_TORQUE + 16 * int(c.seed), r.samples)
    return torque
