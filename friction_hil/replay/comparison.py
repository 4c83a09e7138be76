"""Recordings through friction models: what torque a model says was needed, against what was measured. Pure.

The model is the inverse one: torque = inertia * acceleration + offset + gravity + friction. Every part of both
sides passes the same filters, once: inertia times the acceleration of the low-passed position, and the low-pass
of everything else.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from friction_hil.errors import RecordingError, UsageError
from friction_hil.numerics.filtering import (
    SETTLING_PERIODS,
    decimation_padding,
    lowpass,
    lowpass_padding,
    settling_samples,
)
from friction_hil.numerics.filtering import decimate as decimated
from friction_hil.recordings import Recording
from friction_hil.recordings.even import even_grid
from friction_hil.recordings.quality import is_coarse, resolution

if TYPE_CHECKING:
    from friction_hil.models.model_file import ModelFile

Array = NDArray[np.float64]

DEFAULT_LOWPASS_SHARE = 0.1  # of the sampling rate, where velocity must be derived from position
_KNOWN_SHARE = 0.9  # of the rows: below it a load is not known


@dataclass(frozen=True, slots=True)
class Motion:
    """A recording on an even grid of time, ready for models; every array (n,).

    Attributes
    ----------
    time_s, position, velocity, acceleration : array
        SI; low-passed where ``lowpass_hz`` is set.
    torque : array
        Measured, likewise.
    load_torque, temperature : array or None
        Where they were recorded.
    rate_hz : float
        Sampling rate.
    lowpass_hz : float or None
        Cut-off of the zero-phase low-pass.
    problems : tuple of str
        What had to be done to the recording.
    segments : tuple of slice
        The parts between gaps, in order, which together are all rows: nothing is filtered, differentiated or
        simulated across their bounds. One for the whole when not given.
    """

    time_s: Array
    position: Array
    velocity: Array
    acceleration: Array
    torque: Array
    load_torque: Array | None
    temperature: Array | None
    rate_hz: float
    lowpass_hz: float | None
    problems: tuple[str, ...]
    segments: tuple[slice, ...] = ()

    def __post_init__(self) -> None:
        if not self.segments:
            object.__setattr__(self, "segments", (slice(0, len(self.time_s)),))


@dataclass(frozen=True, slots=True)
class Prediction:
    """What one model makes of a recording.

    Attributes
    ----------
    model : str
        Its name for people.
    friction, mechanics : (m,) array
        Predicted torque of friction, and of inertia, offset and gravity, N m or N.
    rmse : float
        Root mean square of measured minus predicted.
    relative_error : float
        norm(measured - predicted) / norm(measured); NaN where nothing was measured but zeros.
    unit : str
        Of torque and rmse: ``N m`` or ``N``.
    """

    model: str
    friction: Array
    mechanics: Array
    rmse: float
    relative_error: float
    unit: str

    @property
    def torque(self) -> Array:
        """Predicted torque (m,), N m or N."""
        return self.mechanics + self.friction


@dataclass(frozen=True, slots=True)
class Replay:
    """A recording and what models make of it, on the filtered and decimated grid; arrays (m,)."""

    path: str
    axis: str
    rows: int
    duration_s: float
    problems: tuple[str, ...]
    time_s: Array
    velocity: Array
    measured: Array
    predictions: tuple[Prediction, ...]
    segments: tuple[slice, ...]  # the parts between gaps


def replay(
    recording: Recording,
    models: "Mapping[str, ModelFile]",
    *,
    lowpass_hz: float | None = None,
    decimate: int = 1,
) -> Replay:
    """Predict the torque of a recording with each model.

    Parameters
    ----------
    recording : Recording
        With ``position`` and ``torque``; velocity and acceleration are derived where there is no ``velocity``.
    models : dict
        Model files by the name they shall have in the result.
    lowpass_hz : float, optional
        Cut-off of a 4th-order Butterworth low-pass, forward and backward, over everything; velocity and
        acceleration then come from the position. A tenth of the sampling rate where there is no velocity.
    decimate : int
        Keep each n-th sample, behind an 8th-order Chebyshev filter, forward and backward.

    Raises
    ------
    RecordingError
        A column is missing or not finite, there are too few rows, or nothing tells the load on which a model depends.
    UsageError
        A filter does not fit the sampling rate.
    """
    if decimate < 1:
        raise UsageError(f"decimate by a whole number from 1, not {decimate}")
    motion = derive(recording, lowpass_hz)
    problems = [*recording.problems, *motion.problems]
    inner = _inner(recording.path, motion, decimate, problems)

    def reduce(values: Array) -> Array:
        parts = [decimated(values[part], decimate) for part in inner]
        return parts[0] if len(parts) == 1 else np.concatenate(parts)

    rows = [slice(part.start + (part.stop - part.start - 1) % decimate, part.stop, decimate) for part in inner]
    time = _taken(motion.time_s, tuple(rows))
    measured = reduce(motion.torque)
    predictions = []
    for name, model in models.items():
        problems += _missing_inputs(recording, name, model, motion)
        friction, mechanics = map(reduce, predict(model, motion))
        residual = float(np.linalg.norm(measured - mechanics - friction))
        norm = float(np.linalg.norm(measured))
        predictions.append(
            Prediction(
                model=name,
                friction=friction,
                mechanics=mechanics,
                rmse=residual / math.sqrt(len(measured)),
                relative_error=residual / norm if norm > 0.0 else math.nan,
                unit="N m" if model.axis == "rotary" else "N",
            )
        )
    return Replay(
        path=recording.path,
        axis=recording.axis,
        rows=len(recording),
        duration_s=recording.duration_s,
        problems=_without_repetition(problems),
        time_s=time,
        velocity=reduce(motion.velocity),
        measured=measured,
        predictions=tuple(predictions),
        segments=_closed_up(tuple(slice(0, len(range(part.start, part.stop, decimate))) for part in inner)),
    )


def _inner(path: str, motion: Motion, factor: int, problems: list[str]) -> tuple[slice, ...]:
    """Segments without the ends that the low-pass spoils, those that are long enough for all filters."""
    transient = 0 if motion.lowpass_hz is None else settling_samples(motion.lowpass_hz, motion.rate_hz)
    shortest = 2 * transient + 1
    if factor > 1:
        shortest += max(factor, decimation_padding())
    kept = tuple(segment for segment in motion.segments if segment.stop - segment.start > shortest)
    if not kept:
        rows = max(segment.stop - segment.start for segment in motion.segments)
        raise RecordingError(
            f"{path}: {rows} rows without a gap are too few for these filters, which take {shortest} to settle"
        )
    _note_short(motion.segments, kept, "these filters", motion.time_s, problems)
    return tuple(slice(segment.start + transient, segment.stop - transient) for segment in kept)


def _without_repetition(problems: list[str]) -> tuple[str, ...]:
    """A sentence that another one continues says nothing more."""
    return tuple(
        problem
        for problem in dict.fromkeys(problems)
        if not any(other != problem and other.startswith(problem) for other in problems)
    )


def _missing_inputs(recording: Recording, name: str, model: "ModelFile", motion: Motion) -> list[str]:
    """Say what a model needs and the recording does not tell."""
    modifiers = model.friction.modifiers
    if (
        "load" in modifiers
        and motion.load_torque is None
        and model.mechanics.gravity == type(model.mechanics.gravity)()
    ):
        raise RecordingError(
            f"{recording.path}: {name} depends on the load; there is no column load_torque with a number in each row, "
            "and no gravity in the model's mechanics to tell it from the position"
        )
    if "temperature" in modifiers and motion.temperature is None:
        return [f"no temperature: {name} is taken at its reference"]
    return []


def predict(model: "ModelFile", motion: Motion) -> tuple[Array, Array]:
    """Torques (n,) that the model says the motion takes for friction and for mechanics, low-passed as it is.

    A dynamic model starts from rest in each segment. Where no load was recorded, that of friction is gravity.
    """
    mechanics = model.mechanics
    gravity = mechanics.gravity
    static = gravity.sine * np.sin(motion.position) + gravity.cosine * np.cos(motion.position) + gravity.constant
    load = static if motion.load_torque is None else motion.load_torque
    friction = np.empty(len(motion.velocity))
    for part in motion.segments:
        friction[part] = model.friction_model.simulate(
            motion.velocity[part],
            1.0 / motion.rate_hz,
            position=motion.position[part],
            load_torque=load[part],
            temperature=None if motion.temperature is None else motion.temperature[part],
        )
    static = static + mechanics.offset
    if motion.lowpass_hz is not None:
        friction = _lowpassed(friction, motion.segments, motion.lowpass_hz, motion.rate_hz)
        static = _lowpassed(static, motion.segments, motion.lowpass_hz, motion.rate_hz)
    return friction, mechanics.inertia * motion.acceleration + static


def derive(recording: Recording, lowpass_hz: float | None = None) -> Motion:
    """Bring a recording to an even grid, and derive velocity and acceleration; see `replay`."""
    recording.require("position", "torque")
    problems: list[str] = []
    has_velocity = "velocity" in recording and lowpass_hz is None
    why = "no velocity"
    if has_velocity and is_coarse(recording["velocity"]):
        has_velocity = False
        why = f"velocity comes in steps of {resolution(recording['velocity']):.4g}, and mostly stands still"
    held = _known(recording, problems)
    grid = even_grid(recording, ["position", "torque", *(["velocity"] if has_velocity else [])], held)
    problems += grid.problems
    if not has_velocity and lowpass_hz is None:
        lowpass_hz = DEFAULT_LOWPASS_SHARE * grid.rate_hz
        problems.append(f"{why}: derived from the position below {lowpass_hz:.4g} Hz")
    time, columns, segments = grid.time_s, grid.columns, grid.segments
    if lowpass_hz is not None:
        kept = _long_enough(recording.path, segments, lowpass_hz, grid.rate_hz, time, problems)
        time, columns = _taken(time, kept), {name: _taken(values, kept) for name, values in columns.items()}
        segments = _closed_up(kept)
        for name, values in columns.items():
            columns[name] = _lowpassed(values, segments, lowpass_hz, grid.rate_hz)
    velocity = columns["velocity"] if has_velocity else _rate(columns["position"], segments, grid.rate_hz)
    return Motion(
        time_s=time,
        position=columns["position"],
        velocity=velocity,
        acceleration=_rate(velocity, segments, grid.rate_hz),
        torque=columns["torque"],
        load_torque=columns.get("load_torque"),
        temperature=columns.get("temperature"),
        rate_hz=grid.rate_hz,
        lowpass_hz=lowpass_hz,
        problems=tuple(problems),
        segments=segments,
    )


def _known(recording: Recording, problems: list[str]) -> list[str]:
    """Which of the slow inputs are known well enough to be taken."""
    known = []
    for name in ("load_torque", "temperature"):
        if name not in recording:
            continue
        share = float(np.mean(np.isfinite(recording[name])))
        if name == "load_torque" and share < _KNOWN_SHARE:
            problems.append(f"{name} is known in {100.0 * share:.0f} % of the rows: not used")
        else:
            known.append(name)
    return known


def _taken(values: Array, segments: tuple[slice, ...]) -> Array:
    if len(segments) == 1:
        return values[segments[0]]
    return np.concatenate([values[segment] for segment in segments])


def _closed_up(segments: tuple[slice, ...]) -> tuple[slice, ...]:
    """The same lengths, one after the other."""
    ends = np.cumsum([segment.stop - segment.start for segment in segments]).tolist()
    return tuple(slice(begin, end) for begin, end in zip([0, *ends], ends, strict=False))


def _rate(values: Array, segments: tuple[slice, ...], rate_hz: float) -> Array:
    """Derivative by central differences."""
    derivative = np.empty(len(values))
    for segment in segments:
        derivative[segment] = np.gradient(values[segment], 1.0 / rate_hz)
    return derivative


def _lowpassed(values: Array, segments: tuple[slice, ...], lowpass_hz: float, rate_hz: float) -> Array:
    if len(segments) == 1:
        return lowpass(values, lowpass_hz, rate_hz)
    return np.concatenate([lowpass(values[segment], lowpass_hz, rate_hz) for segment in segments])


def _long_enough(
    path: str,
    segments: tuple[slice, ...],
    lowpass_hz: float,
    rate_hz: float,
    time: Array,
    problems: list[str],
) -> tuple[slice, ...]:
    """Segments in which a low-pass settles; the others are told."""
    if not 0.0 < lowpass_hz < rate_hz / 2.0:
        raise UsageError(
            f"{path}: a low-pass lies above 0 and below half the sampling rate, {rate_hz / 2.0:.6g} Hz, "
            f"not at {lowpass_hz:g} Hz"
        )
    fewest = max(lowpass_padding() + 1, 2.0 * SETTLING_PERIODS * rate_hz / lowpass_hz)
    kept = tuple(segment for segment in segments if segment.stop - segment.start >= fewest)
    if not kept:
        rows = max(segment.stop - segment.start for segment in segments)
        raise RecordingError(
            f"{path}: {rows} rows without a gap are too few for a low-pass at {lowpass_hz:g} Hz, "
            f"which takes {SETTLING_PERIODS:g} periods to settle at either end"
        )
    _note_short(segments, kept, f"a low-pass at {lowpass_hz:.4g} Hz", time, problems)
    return kept


def _note_short(
    segments: tuple[slice, ...], kept: tuple[slice, ...], what: str, time: Array, problems: list[str]
) -> None:
    problems += [
        f"the part from {time[segment.start]:.6g} s to {time[segment.stop - 1]:.6g} s has "
        f"{segment.stop - segment.start} rows, too few for {what}: left out"
        for segment in segments
        if segment not in kept
    ]
