"""Velocities, temperatures and weights at which an export that loses torque is fitted and judged."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from friction_hil.errors import UsageError
from friction_hil.friction import FrictionModel
from friction_hil.friction.steady_curve import velocity_range
from friction_hil.models.model_file import ModelFile
from friction_hil.numerics.jit import Array
from friction_hil.recordings import files
from friction_hil.recordings.segments import LEAST_KNOWN_FRACTION, even_signals, known_fraction

_CELLS = 200  # of the velocity, on each side of rest
_SLOWEST = 1e-4  # of the largest speed: below it the axis counts as resting
_TEMPERATURES = 5
_MOST = 1e100  # of velocity and torque, whose squares are fitted
_TEMPERATURE_SPAN = 20.0  # K to either side of the reference, where no recording tells the temperatures


@dataclass(frozen=True, slots=True, eq=False)
class Points:
    """Every combination of velocity and temperature, with its weight.

    The velocities lie closer together near rest, and each stands for the cell around it.
    """

    velocity: Array  # (n,), rad/s or m/s, without zero
    temperature: Array  # (n,), deg C; NaN for a model that does not depend on it
    weight: Array  # (n,), share of the time; the sum is 1
    low: float  # end of the range of velocity, rad/s or m/s; not above zero
    high: float  # the other end, not below zero
    origin: str  # what range and weights come from, as the end of a sentence

    def torque(self, model: FrictionModel) -> Array:
        """Return the steady torque of a model without load and ripple, (n,), N m or N."""
        torque = np.empty(self.velocity.size)
        load = 0.0 if model.depends_on_load else None
        for celsius in np.unique(self.temperature):  # NaN is one value here
            rows = np.isnan(self.temperature) if np.isnan(celsius) else self.temperature == celsius
            known = None if np.isnan(celsius) else float(celsius)
            torque[rows] = model.steady_state(self.velocity[rows], load_torque=load, temperature=known)
        return torque


def points(
    model_file: ModelFile, recording: str | Path | None = None, *, axis: str | None = None, speed: float | None = None
) -> Points:
    """Return the points for a model file.

    The range of validity of ``model_file`` limits the velocity; without one, it is the range in which the model is
    drawn. Velocities (and temperatures) of ``recording`` give the weights; without it all velocities count alike.
    ``axis``: of a recording that has several. ``speed``: largest, rad/s or m/s. Raises `RecordingError`: the recording
    cannot be used, or its axis rests; `UsageError`: ``speed`` is not above zero, or nothing of the range lies below it.
    """
    if speed is not None and not 0.0 < speed < np.inf:
        raise UsageError(f"--speed {speed:g}: the largest speed must be a number above zero, rad/s or m/s")
    model = model_file.friction_model
    if recording is None:
        low, high, origin = _range(model_file, model, speed)
        celsius, why = _temperatures(model)
        samples, measured = None, None
        origin += ", all speeds alike" + why
    else:
        samples, measured = _recorded(recording, axis, model)
        if speed is not None:
            kept = np.abs(samples) <= speed
            samples, measured = samples[kept], None if measured is None else measured[kept]
        if samples.size == 0 or not np.any(samples):
            raise UsageError(f"{recording}: the axis does not move{'' if speed is None else f' below {speed:g}'}")
        low, high = float(np.min(samples, initial=0.0)), float(np.max(samples, initial=0.0))
        celsius, why = _temperatures(model, measured)
        origin = f"speeds of {recording}, {_span(low, high, model)}, by their share of its time{why}"
        known = identified(model_file, "velocity")
        if known is not None and not (known[0] <= low and high <= known[1]):
            origin += f"; the model was identified at {_span(*known, model)} only"
    edges = _edges(low, high)
    velocity, temperature, weight = _combined(edges, celsius, samples, measured)
    found = Points(velocity, temperature, weight, low, high, origin)
    if not max(-low, high, np.max(np.abs(found.torque(model)))) < _MOST:
        raise UsageError(f"{_span(low, high, model)} is too wide a range to fit in; --speed V gives a narrower one")
    return found


def _combined(
    edges: Sequence[Array], celsius: Array, samples: Array | None, measured: Array | None
) -> tuple[Array, Array, Array]:
    """Return velocity, temperature and weight of all cells at all temperatures, (n,) each."""
    velocity = np.concatenate([0.5 * (each[1:] + each[:-1]) for each in edges])
    if samples is None:
        width = np.concatenate([np.diff(each) for each in edges])
        weight = np.repeat(width[:, None], celsius.size, axis=1)
    elif measured is None:
        counts = np.concatenate([np.histogram(samples, each)[0] for each in edges]).astype(np.float64)
        weight = np.repeat(counts[:, None], celsius.size, axis=1)
    else:
        bounds = np.concatenate([[-np.inf], 0.5 * (celsius[1:] + celsius[:-1]), [np.inf]])
        rows = [(measured >= first) & (measured < last) for first, last in pairwise(bounds)]
        columns = [np.concatenate([np.histogram(samples[own], each)[0] for each in edges]) for own in rows]
        weight = np.stack(columns, axis=1).astype(np.float64)
    grid = np.broadcast_to(velocity[:, None], weight.shape), np.broadcast_to(celsius, weight.shape)
    return grid[0].ravel().copy(), grid[1].ravel().copy(), weight.ravel() / np.sum(weight)


def _edges(low: float, high: float) -> list[Array]:
    """Return the edges of the cells on either side of rest, rising."""
    unit = np.geomspace(_SLOWEST, 1.0, _CELLS + 1)
    fastest = max(-low, high)
    sides = []
    if low < -_SLOWEST * fastest:
        sides.append(low * unit[::-1])
    if high > _SLOWEST * fastest:
        sides.append(high * unit)
    return sides


def _range(model_file: ModelFile, model: FrictionModel, speed: float | None) -> tuple[float, float, str]:
    known = identified(model_file, "velocity")
    if known is not None:
        low, high, source = min(known[0], 0.0), max(known[1], 0.0), "range of the identification, {}"
    else:
        fastest = velocity_range(model) if speed is None else speed
        low, high, source = -fastest, fastest, "range {} (the model file states none)"
    if speed is not None:
        low, high = max(low, -speed), min(high, speed)
    if not low < high:
        raise UsageError("the range of velocity in the model file (fit.range.velocity) is empty; --speed V gives one")
    return low, high, source.format(_span(low, high, model))


def identified(model_file: ModelFile, name: str) -> tuple[float, float] | None:
    """Return the range of velocity, position, ... of the identification; None if the model file does not state it."""
    ranges = (model_file.fit or {}).get("range")
    ends = ranges.get(name) if isinstance(ranges, dict) else None
    if not isinstance(ends, list | tuple) or len(ends) != 2:
        return None
    if not all(isinstance(each, int | float) and math.isfinite(each) for each in ends):
        return None
    return float(ends[0]), float(ends[1])


def _span(low: float, high: float, model: FrictionModel) -> str:
    return f"{low:.4g} to {high:.4g} {'rad/s' if model.axis == 'rotary' else 'm/s'}"


def _temperatures(model: FrictionModel, measured: Array | None = None) -> tuple[Array, str]:
    """Return the temperatures, deg C, and the words about them; one NaN if the model does not depend on them."""
    if not model.depends_on_temperature:
        return np.full(1, np.nan), ""
    if measured is not None:
        low, high = float(np.min(measured)), float(np.max(measured))
        return np.unique(
            np.linspace(low, high, _TEMPERATURES)
        ), f"; recorded temperatures {low:.4g} to {high:.4g} deg C"
    middle = model.reference_temperature
    celsius = middle + _TEMPERATURE_SPAN * np.linspace(-1.0, 1.0, _TEMPERATURES)
    return celsius, f"; temperatures {celsius[0]:.4g} to {celsius[-1]:.4g} deg C, which no recording states"


def _recorded(path: str | Path, axis: str | None, model: FrictionModel) -> tuple[Array, Array | None]:
    """Return velocities and, if the model needs and the recording has them, temperatures of all rows, (n,) each."""
    recording = files.read(path, axis)
    needed = model.depends_on_temperature and known_fraction(recording, "temperature") >= LEAST_KNOWN_FRACTION
    signals = even_signals(recording, ("temperature",) if needed else ())
    segments = [signals.segment(rows) for rows in signals.grid.segments]
    velocity = np.concatenate([each.velocity for each in segments])
    if not needed:
        return velocity, None
    celsius = np.concatenate([each.temperature for each in segments if each.temperature is not None])
    known = np.isfinite(celsius)
    return velocity[known], celsius[known]
