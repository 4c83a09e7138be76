"""Samples of a training, and the parameter array of a network with its scales before training."""

import math
from collections.abc import Iterable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from friction_hil.errors import UsageError
from friction_hil.friction import network
from friction_hil.friction.network_model import NetworkStructure
from friction_hil.numerics.jit import Array, compiled

_STROKES = 60  # number of strokes tried
_LEAST_REMAINDER = 1e-9  # mean square of a stop outside the span of the velocity curves: a smaller one is rounding
_OUTPUT_MARGIN = 1.5  # bound of the output over the largest torque of the training


@dataclass(frozen=True, slots=True)
class Samples:
    """One or more records with one sampling period, one after the other."""

    dt: float  # sampling period, s
    velocity: Array  # (n,), held over each sample, rad/s
    torque: Array  # (n,), at the end of each sample, N m
    position: Array = field(default_factory=lambda: np.zeros(0))  # (n,), rad; zeros if not given
    load_torque: Array = field(default_factory=lambda: np.zeros(0))  # (n,), N m; zeros if not given
    temperature: Array = field(default_factory=lambda: np.zeros(0))  # (n,), deg C; NaN if unknown or not given
    starts: Array = field(default_factory=lambda: np.zeros(0))  # (n,), 1 where a record begins, else 0
    # (n,), of the squared error of each sample; 0 if it is simulated only, such as in a held-out block
    weight: Array = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        count = np.size(self.velocity)
        if count == 0 or not (math.isfinite(self.dt) and self.dt > 0.0):
            raise UsageError(f"samples need a period above zero and at least one sample, not {self.dt} s and {count}")
        first = np.zeros(count)
        first[0] = 1.0
        defaults = {
            "position": np.zeros(count),
            "load_torque": np.zeros(count),
            "temperature": np.full(count, np.nan),
            "starts": first,
            "weight": np.ones(count),
        }
        for name in ("velocity", "torque", *defaults):
            values = np.ascontiguousarray(getattr(self, name), dtype=np.float64)
            values = defaults[name] if values.size == 0 and name in defaults else values
            if values.shape != (count,):
                raise UsageError(f"{name} has shape {values.shape}, velocity ({count},): they must be the same")
            if name != "temperature" and not np.isfinite(values).all():
                index = int(np.flatnonzero(~np.isfinite(values))[0])
                raise UsageError(f"{name} of sample {index} is {values[index]}, not a finite number")
            object.__setattr__(self, name, values)
        self.starts[0] = 1.0

    def __len__(self) -> int:
        return self.velocity.size

    def weighted(self, weight: Array) -> "Samples":
        """Return the same samples with other weights."""
        return replace(self, weight=weight)

    def with_torque(self, torque: Array) -> "Samples":
        """Return the same samples with another torque."""
        return replace(self, torque=torque)


def join(records: Iterable[Samples]) -> Samples:
    """Concatenate records; a `UsageError`: there is none, or the periods differ."""
    all_of = list(records)
    if not all_of or any(abs(each.dt / all_of[0].dt - 1.0) > 1e-6 for each in all_of):
        raise UsageError("records for one training need the same sampling period: resample the others")
    names = ("velocity", "torque", "position", "load_torque", "temperature", "starts", "weight")
    return Samples(all_of[0].dt, *(np.concatenate([getattr(each, name) for each in all_of]) for name in names))


def empty(structure: NetworkStructure, samples: Samples, speed_factor: float = 1.0) -> Array:
    """Return the parameter array of a network with zero weights and scales taken from ``samples``.

    ``speed_factor`` multiplies the speeds at which the velocity features saturate.
    """
    p = structure.parameter_array()
    p[network.TRAINED_DT] = samples.dt
    used = samples.weight > 0.0
    torque, speed = samples.torque[used], np.abs(samples.velocity[used])
    p[network.TORQUE_SCALE] = float(np.std(torque)) or 1.0
    p[network.BOUND] = _OUTPUT_MARGIN * max(float(np.max(np.abs(torque))) / p[network.TORQUE_SCALE], 1.0)
    p[network.SPEED_LIMIT] = limit = float(np.max(speed)) or 1.0
    p[network.SPEEDS : network.SPEEDS + 3] = speeds = characteristic_speeds(speed) * speed_factor
    p[network.FEATURE_FACTORS : network.FEATURE_FACTORS + 2] = 1.0 / np.arcsinh(limit / speeds[:2])
    for index, values in enumerate((samples.position, samples.load_torque, samples.temperature)):
        known = values[used & np.isfinite(values)]
        low, high = (float(known.min()), float(known.max())) if known.size else (0.0, 0.0)
        p[network.MIDDLES + index] = 0.5 * (low + high)
        p[network.HALF_RANGES + index] = 0.5 * (high - low) or 1.0
    lowest, highest = np.log(rate_bounds(samples))
    p[network.RATE_MIDDLE], p[network.RATE_HALF] = 0.5 * (lowest + highest), 0.5 * (highest - lowest)
    p[network.STROKE] = stroke(samples) if structure.kind == "gated" else 0.0
    return p


@compiled
def _fill_stop(starts: Array, distance: Array, stroke: float, stop: Array) -> None:
    """Fill ``stop`` (n,) with Prandtl's stop of this stroke."""
    now = 0.0
    for k in range(distance.shape[0]):
        now = 0.0 if starts[k] != 0.0 else now
        now = min(max(now + distance[k] / stroke, -1.0), 1.0)
        stop[k] = now


def stroke(samples: Samples) -> float:
    """Return the stroke of the stop that, with a curve over the velocity, explains most of the torque, rad."""
    v, root = samples.velocity, np.sqrt(samples.weight)
    speeds = characteristic_speeds(np.abs(v[samples.weight > 0.0]))
    curve = [np.ones(len(v)), v, *(np.arcsinh(v / speed) for speed in speeds[:2]), np.tanh(v / speeds[2])]
    base, _ = np.linalg.qr(np.column_stack(curve) * root[:, None])
    target, stop, distance = samples.torque * root, np.empty(len(v)), v * samples.dt
    moving = np.abs(distance[distance != 0.0])
    if moving.size == 0:
        return 1.0
    strokes = np.geomspace(float(np.quantile(moving, 0.1)), float(moving.sum()), _STROKES)
    explained = np.zeros(_STROKES)
    for index, one in enumerate(strokes):
        _fill_stop(samples.starts, distance, one, stop)
        beside = stop * root
        beside -= base @ (base.T @ beside)
        length = float(beside @ beside)
        if length > _LEAST_REMAINDER * float(samples.weight.sum()):
            explained[index] = (beside @ target) ** 2 / length
    return float(strokes[int(np.argmax(explained))])


def characteristic_speeds(speed: Array) -> NDArray[np.float64]:
    """Return three speeds at which velocity features saturate, from the speeds that occur, rad/s."""
    moving = speed[speed > 1e-9 * np.max(speed)] if np.max(speed) > 0.0 else np.ones(1)
    low, middle, high = np.quantile(moving, (0.02, 0.1, 0.4))
    return np.asarray(np.maximum(np.array([middle, high, low]), 1e-4 * np.max(moving)))


def rate_bounds(samples: Samples) -> tuple[float, float]:
    """Return bounds of a gate's rate, rad^-1, from the distances travelled in the samples."""
    path = np.abs(samples.velocity) * samples.dt
    moving = path[path > 1e-9 * path.max()] if path.max() > 0.0 else np.ones(1)
    return 1.0 / float(moving.sum() + moving.max()), 3.0 / float(np.quantile(moving, 0.1))
