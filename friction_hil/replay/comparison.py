"""Comparison of the torque that models predict for a recorded motion with the measured torque. Pure.

The model is the inverse one: torque = inertia * acceleration + offset + gravity + friction. For a model that was
identified from a signal of unknown gain, gain * signal = torque + back_emf * velocity. Both sides pass the same
low-pass exactly once: inertia is multiplied by the acceleration of the low-passed position, and everything else is
low-passed itself.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from friction_hil.errors import RecordingError, UsageError
from friction_hil.models.model_file import ModelFile, TorqueSignal
from friction_hil.numerics.jit import Array
from friction_hil.numerics.readable import FORCE_UNITS
from friction_hil.recordings import Recording
from friction_hil.recordings.segments import Segment, default_decimation
from friction_hil.replay.preparation import Reduction, replay_segments

_POOR = 0.5  # relative error of a model: below, no other unit is looked for
_CLEARLY = 0.4  # of that error: what another unit leaves
_TORQUES = (
    (-1.0, "the sign of the torque is turned, or that of the position", "-1"),
    (0.001, "the torque is in thousandths (mN m)", "0.001"),
    (1000.0, "the torque is in thousands (kN m)", "1000"),
    (0.01, "the torque is in hundredths (N cm)", "0.01"),
    (-0.001, "the torque is in thousandths (mN m), and its sign or that of the position is turned", "-0.001"),
)
_MOTIONS = (
    (np.pi / 180.0, "the position is in degrees", "pi/180"),
    (2.0 * np.pi, "the position is in revolutions", "2*pi"),
    (0.001, "the position is in thousandths (mm, mrad)", "0.001"),
    (-1.0, "the sign of the position is turned, or that of the torque", "-1"),
)
Predict = Callable[[Sequence[Segment]], Array]


@dataclass(frozen=True, slots=True)
class Prediction:
    """Torque that one model predicts for a recording, and its error."""

    model: str  # its name in the results
    # (m,), N m or N: the recorded torque over `mechanics.torque_ratio` of the model, or the recorded signal times the
    # gain of the model
    measured: Array
    friction: Array  # (m,), predicted torque, N m or N
    mechanics: Array  # (m,), predicted torque of inertia, offset, gravity and back-EMF, N m or N
    rmse: float  # of measured minus predicted, N m or N
    relative_error: float  # norm(measured - predicted) / norm(measured); NaN if all measured torques are zero
    unit: str  # of torque and rmse: `N m` or `N`

    @property
    def torque(self) -> Array:
        """Predicted torque (m,), N m or N."""
        return self.mechanics + self.friction


@dataclass(frozen=True, slots=True)
class Replay:
    """Predicted torque of a recording, with the measured one, on the filtered and decimated grid; arrays (m,)."""

    path: str
    axis: str
    rows: int
    duration_s: float
    problems: tuple[str, ...]
    time_s: Array
    velocity: Array
    measured: Array  # the column torque; `Prediction.measured` has its gain applied
    predictions: tuple[Prediction, ...]
    segments: tuple[slice, ...]  # rows between gaps


def replay(
    # with `position` and `torque`; velocity and acceleration are derived where there is no `velocity`
    recording: Recording,
    models: Mapping[str, ModelFile],  # by their names in the result
    *,
    # cut-off of a 4th-order Butterworth low-pass, forward and backward, over everything; velocity and acceleration then
    # come from the position; a tenth of the sampling rate where there is no velocity
    lowpass_hz: float | None = None,
    # keep each n-th sample, after an 8th-order Chebyshev filter, forward and backward; None: as identification does by
    # default, so that both have the same error
    decimate: int | None = 1,
) -> Replay:
    """Predict the torque of a recording with each model.

    Raises `RecordingError`: a column is missing or not finite, there are too few rows, or the load that a model depends
    on is not known; `UsageError`: a filter does not fit the sampling rate.
    """
    if decimate is not None and decimate < 1:
        raise UsageError(f"decimate by a whole number from 1, not {decimate}")
    segments, settling, problems = replay_segments(recording, lowpass_hz, decimate)
    reduced = Reduction(settling, decimate or default_decimation(max(len(each.torque) for each in segments)))
    recorded = reduced([each.torque for each in segments])
    predictions = []
    for name, model in models.items():
        problems += _missing_inputs(name, model, segments[0])
        friction, mechanics = map(reduced, zip(*(predict(model, each) for each in segments), strict=True))
        measured, signal = recorded / model.mechanics.torque_ratio, signal_of(model, recording)
        if signal is not None:
            problems += _other_signal(name, signal, recording)
            measured = signal.gain * recorded
            mechanics = mechanics + signal.back_emf * reduced([each.velocity for each in segments])
        predictions.append(_prediction(name, model, measured, friction, mechanics))
        if signal is None and not is_own(recording):
            problems += filter(None, [_wrong_unit(name, model, recording, segments, reduced, predictions[-1])])
    return Replay(
        path=recording.path,
        axis=recording.axis,
        rows=len(recording),
        duration_s=recording.duration_s,
        problems=_without_repetition(problems),
        time_s=reduced.time_s(segments),
        velocity=reduced([each.velocity for each in segments]),
        measured=recorded,
        predictions=tuple(predictions),
        segments=reduced.rows(segments),
    )


def is_own(recording: Recording) -> bool:
    """True if the daemon made the recording, whose units are known."""
    return "configuration" in recording.metadata


def _wrong_unit(
    name: str,
    model: ModelFile,
    recording: Recording,
    segments: Sequence[Segment],
    reduced: Reduction,
    found: Prediction,
) -> str:
    def again(others: Sequence[Segment]) -> Array:
        friction, mechanics = map(reduced, zip(*(predict(model, each) for each in others), strict=True))
        return friction + mechanics

    return wrong_unit(name, recording, segments, found.measured, found.torque, again)


def predict(model: ModelFile, segment: Segment) -> tuple[Array, Array]:
    """Compute the torques of friction and of mechanics that a motion takes, N m or N, low-passed as the segment is.

    A dynamic model starts from rest. Where no load was recorded, the load of a load-dependent model is what the
    transmission carries, as in the daemon: gravity and the inertia of the load, or all of it where that is not known.
    """
    mechanics = model.mechanics
    carried = mechanics.inertia if mechanics.load is None else mechanics.load.inertia
    load = mechanics.gravity.at(segment.position) + carried * segment.acceleration
    friction = model.friction_model.simulate(
        segment.velocity,
        segment.dt,
        position=segment.position,
        load_torque=load if segment.load_torque is None else segment.load_torque,
        temperature=segment.temperature,
    )
    return segment.lowpass(friction), mechanics_torque(model, segment)


def mechanics_torque(model: ModelFile, segment: Segment) -> Array:
    """Compute the torque of inertia, offset and gravity (n,) that a motion takes, low-passed as the segment is.

    What is left of a measured torque is friction. Parameters are those of `predict`.
    """
    static = model.mechanics.gravity.at(segment.position) + model.mechanics.offset
    return model.mechanics.inertia * segment.acceleration + segment.lowpass(static)


def signal_of(model: ModelFile, recording: Recording) -> TorqueSignal | None:
    """Return the signal that the column torque holds, by the model file; None if the torque is in N m or N.

    The daemon records torques, also where its model was identified from a signal of unknown gain.
    """
    return None if is_own(recording) else model.signal


def _other_signal(name: str, signal: TorqueSignal, recording: Recording) -> list[str]:
    """Report that the gain of a model belongs to another signal than the one that was read."""
    column = recording.sources.get("torque", "torque")
    if signal.column in ("", column):
        return []
    return [
        f"the gain of {name}, {signal.gain:.4g}, belongs to the signal {signal.column}; it is applied to {column}: if "
        f"that is in another unit, read --column torque='{signal.column}'"
    ]


def _prediction(name: str, model: ModelFile, measured: Array, friction: Array, mechanics: Array) -> Prediction:
    residual = float(np.linalg.norm(measured - mechanics - friction))
    norm = float(np.linalg.norm(measured))
    return Prediction(
        model=name,
        measured=measured,
        friction=friction,
        mechanics=mechanics,
        rmse=residual / math.sqrt(len(measured)),
        relative_error=residual / norm if norm > 0.0 else math.nan,
        unit=FORCE_UNITS[model.axis],
    )


def _without_repetition(problems: list[str]) -> tuple[str, ...]:
    """Remove sentences that occur twice or that another sentence repeats and continues."""
    return tuple(
        problem
        for problem in dict.fromkeys(problems)
        if not any(other != problem and other.startswith(problem) for other in problems)
    )


def _missing_inputs(name: str, model: ModelFile, segment: Segment) -> list[str]:
    """Report inputs that a model needs and the recording lacks.

    Raises `RecordingError`: friction depends on the load, and neither a column nor the model's mechanics gives it.
    """
    modifiers, mechanics = model.friction.modifiers, model.mechanics
    is_unknown = mechanics.gravity == type(mechanics.gravity)() and mechanics.inertia == 0.0
    if "load" in modifiers and segment.load_torque is None and is_unknown:
        raise RecordingError(
            f"{segment.path}: {name} depends on the load; there is no column load_torque with a number in each row, "
            "and neither gravity nor inertia in the model's mechanics, from which the motion would give it"
        )
    if "temperature" in modifiers and segment.temperature is None:
        return [f"no temperature: {name} is evaluated at its reference temperature"]
    return []


def wrong_unit(
    name: str, recording: Recording, segments: Sequence[Segment], measured: Array, predicted: Array, predict: Predict
) -> str:
    """Return which unit or sign of the recording would explain the error of a model; empty if none does.

    Torques are (m,), N m or N; ``predict`` returns those that the model predicts for other segments.
    """
    size = float(np.linalg.norm(measured))
    if not size > 0.0:
        return ""
    error = float(np.linalg.norm(measured - predicted)) / size
    if error < _POOR:
        return ""
    best, text = min(_others(recording, segments, measured, predicted, predict), default=(error, ""))
    if best > _CLEARLY * min(error, 1.0):  # a torque of zero has an error of 1
        return ""
    return f"{name} has an error of {100.0 * error:.3g} %, and of {100.0 * best:.3g} % if {text}"


def _others(
    recording: Recording, segments: Sequence[Segment], measured: Array, predicted: Array, predict: Predict
) -> Iterator[tuple[float, str]]:
    for factor, text, option in _TORQUES:
        torque = factor * measured
        left = float(np.linalg.norm(torque - predicted) / np.linalg.norm(torque))
        yield left, f"{text}: {_option(recording, 'torque', option)}"
    for factor, text, option in _MOTIONS:
        moved = [
            replace(
                each,
                position=factor * each.position,
                velocity=factor * each.velocity,
                acceleration=factor * each.acceleration,
            )
            for each in segments
        ]
        with np.errstate(all="ignore"):
            left = float(np.linalg.norm(measured - predict(moved)) / np.linalg.norm(measured))
        if np.isfinite(left):
            yield left, f"{text}: {_option(recording, 'position', option)}"


def _option(recording: Recording, name: str, factor: str) -> str:
    return f"--column '{name}={recording.sources.get(name, name)}*{factor}'"
