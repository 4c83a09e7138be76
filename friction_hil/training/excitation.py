"""Velocity signals for training that excite friction from presliding to the top speed. Pure."""

import math
from collections.abc import Callable
from functools import partial

import numpy as np

from friction_hil.errors import UsageError
from friction_hil.numerics.jit import Array
from friction_hil.training import thresholds as th

_KINDS = ("multisine", "ramps", "multisine", "pulses")

Draw = Callable[[float, float], float]


def excitation(top_speed: float, dt: float, samples: int, *, seed: int = 0) -> Array:
    """Design a training signal: multi-sines, ramps with reversals, and pulses with rests, in many short segments.

    Amplitudes, rates and frequencies are spread over decades, so that presliding, creep and fast motion occur with slow
    and with sudden changes. Every segment begins and ends at rest.

    Returns (samples,), rad/s, held over each sample. ``top_speed``: rad/s; the smallest amplitude is a thousandth
    of it. ``dt``: s. The same seed gives the same bits. Raises `UsageError`: a number is not finite or not
    above zero.
    """
    if not (0.0 < top_speed < math.inf and 0.0 < dt < math.inf and samples > 0):
        raise UsageError(
            "an excitation needs a top speed, a period and a number of samples above zero, all finite, "
            f"not {top_speed}, {dt}, {samples}"
        )
    slowest = top_speed / 10.0**th.DECADES
    random = np.random.default_rng(seed)
    mean_length = max(2, round(sum(th.SEGMENT_S) / 2.0 / dt))
    count = -(-samples // mean_length)
    # stratified samples of the logarithmic range, in which large amplitudes are more frequent
    exponents = np.sqrt((np.arange(count) + random.uniform(size=count)) / count)
    amplitudes = slowest * (top_speed / slowest) ** random.permutation(exponents)
    amplitudes[0] = top_speed
    draw = partial(_log_uniform, random)
    parts: list[Array] = []
    length = 0
    while length < samples:
        number = len(parts)
        amplitude = float(amplitudes[number % count])
        one = _segment(_KINDS[number % len(_KINDS)], amplitude, slowest, dt, random, draw)
        parts.append(one)
        length += one.size
    return np.concatenate(parts)[:samples]


def _log_uniform(random: np.random.Generator, low: float, high: float) -> float:
    return float(low * (high / low) ** random.uniform())


def _segment(kind: str, amplitude: float, slowest: float, dt: float, random: np.random.Generator, draw: Draw) -> Array:
    length = max(2, round(random.uniform(*th.SEGMENT_S) / dt))
    if kind == "multisine":
        return _multisine(amplitude, length, dt, random, draw)
    if kind == "ramps":
        return _ramps(amplitude, slowest, length, dt, random, draw)
    return _pulses(amplitude, slowest, length, dt, random, draw)


def _multisine(amplitude: float, length: int, dt: float, random: np.random.Generator, draw: Draw) -> Array:
    """Return a sum of three to six sines with random phases, scaled to ``amplitude``."""
    t = np.arange(length) * dt
    fastest = min(th.HERTZ[1], 0.1 / dt)
    slow = min(th.HERTZ[0], fastest)
    sines = [
        random.uniform(0.3, 1.0) * np.sin(2.0 * math.pi * draw(slow, fastest) * t + random.uniform(0.0, 2.0 * math.pi))
        for _ in range(random.integers(3, 7))
    ]
    total = np.sum(sines, axis=0)
    edge = np.clip(np.minimum(np.arange(length), np.arange(length)[::-1]) / (th.EDGE_FRACTION * length), 0.0, 1.0)
    total *= 0.5 - 0.5 * np.cos(math.pi * edge)
    return np.asarray(total * (amplitude / max(float(np.max(np.abs(total))), 1e-12)))


def _ramps(amplitude: float, slowest: float, length: int, dt: float, random: np.random.Generator, draw: Draw) -> Array:
    """Return straight lines between random velocities of changing sign, from rest to rest."""
    times, levels = [0.0], [0.0]
    sign = 1.0 if random.uniform() < 0.5 else -1.0
    while times[-1] < length * dt:
        times.append(times[-1] + draw(*th.RAMPS_S))
        levels.append(sign * draw(min(slowest, 0.5 * amplitude), amplitude))
        sign = -sign if random.uniform() < 0.7 else sign
    times.append(times[-1] + draw(*th.RAMPS_S))
    levels.append(0.0)
    return np.asarray(np.interp(np.arange(round(times[-1] / dt) + 1) * dt, times, levels))


def _pulses(amplitude: float, slowest: float, length: int, dt: float, random: np.random.Generator, draw: Draw) -> Array:
    """Return pulses with rounded edges of random steepness and rests between them."""
    parts: list[Array] = []
    while sum(part.size for part in parts) < length:
        rise = np.arange(1, max(2, round(draw(*th.EDGES_S) / dt)))
        edge = 0.5 - 0.5 * np.cos(math.pi * rise / (rise.size + 1))
        height = draw(max(slowest, 0.1 * amplitude), amplitude) if amplitude > slowest else amplitude
        height *= 1.0 if random.uniform() < 0.5 else -1.0
        flat = np.ones(round(draw(*th.RESTS_S) / dt))
        parts += [height * np.concatenate([edge, flat, edge[::-1]]), np.zeros(max(1, round(draw(*th.RESTS_S) / dt)))]
    return np.concatenate(parts)
