"""Comparison of the torque that models predict for a recorded motion with the measured torque. Pure.

The model is the inverse one: torque = inertia * acceleration + offset + gravity + friction. Both sides pass the same
low-pass exactly once: inertia is multiplied by the acceleration of the low-passed position, and everything else is
low-passed itself.
"""

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from friction_hil.errors import RecordingError, UsageError
from friction_hil.models.model_file import ModelFile
from friction_hil.numerics.filtering import (
    SETTLING_PERIODS,
    decimated_rows,
    decimation_padding,
    lowpass_padding,
)
from friction_hil.numerics.filtering import decimate as decimated
from friction_hil.numerics.jit import Array
from friction_hil.recordings import Recording
from friction_hil.recordings.segments import (
    LEAST_KNOWN_FRACTION,
    EvenSignals,
    Segment,
    even_signals,
    known_fraction,
)


@dataclass(frozen=True, slots=True)
class Prediction:
    """Torque that one model predicts for a recording, and its error.

    Attributes
    ----------
    model : str
        Name of the model in the results.
    friction, mechanics : (m,) array
        Predicted torque of friction, and of inertia, offset and gravity, N m or N.
    rmse : float
        Root mean square of measured minus predicted, N m or N.
    relative_error : float
        norm(measured - predicted) / norm(measured); NaN if all measured torques are zero.
    unit : str
        Unit of torque and rmse: ``N m`` or ``N``.
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
    """Measured and predicted torque of a recording on the filtered and decimated grid; arrays (m,)."""

    path: str
    axis: str
    rows: int
    duration_s: float
    problems: tuple[str, ...]
    time_s: Array
    velocity: Array
    measured: Array
    predictions: tuple[Prediction, ...]
    segments: tuple[slice, ...]  # rows between gaps


def replay(
    recording: Recording,
    models: Mapping[str, ModelFile],
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
        Model files by their names in the result.
    lowpass_hz : float, optional
        Cut-off of a 4th-order Butterworth low-pass, forward and backward, over everything; velocity and
        acceleration then come from the position. A tenth of the sampling rate where there is no velocity.
    decimate : int
        Keep each n-th sample, after an 8th-order Chebyshev filter, forward and backward.

    Raises
    ------
    RecordingError
        A column is missing or not finite, there are too few rows, or the load that a model depends on is not known.
    UsageError
        A filter does not fit the sampling rate.
    """
    if decimate < 1:
        raise UsageError(f"decimate by a whole number from 1, not {decimate}")
    segments, settling, problems = replay_segments(recording, lowpass_hz, decimate)
    reduced = _Reduction(settling, decimate)
    measured = reduced([each.torque for each in segments])
    predictions = []
    for name, model in models.items():
        problems += _missing_inputs(name, model, segments[0])
        friction, mechanics = map(reduced, zip(*(predict(model, each) for each in segments), strict=True))
        predictions.append(_prediction(name, model, measured, friction, mechanics))
    return Replay(
        path=recording.path,
        axis=recording.axis,
        rows=len(recording),
        duration_s=recording.duration_s,
        problems=_without_repetition(problems),
        time_s=reduced.time_s(segments),
        velocity=reduced([each.velocity for each in segments]),
        measured=measured,
        predictions=tuple(predictions),
        segments=reduced.rows(segments),
    )


def replay_segments(
    recording: Recording, lowpass_hz: float | None = None, decimate: int = 1
) -> tuple[list[Segment], int, list[str]]:
    """Bring a recording to low-passed segments that are long enough for the filters.

    Parameters
    ----------
    recording, lowpass_hz, decimate
        As of `replay`.

    Returns
    -------
    segments : list of Segment
    settling : int
        Rows at either end of each segment in which the low-pass has not settled.
    problems : list of str
        What was found in the recording and what was done about it.

    Raises
    ------
    RecordingError, UsageError
        See `replay`.
    """
    problems = list(recording.problems)
    recording.require("position", "torque")
    signals = even_signals(recording, _known_inputs(recording, problems), lowpass_hz=lowpass_hz)
    problems += signals.problems
    rows = _long_enough(signals, decimate, problems)
    return [signals.segment(each).lowpassed() for each in rows], signals.settling_rows, problems


def predict(model: ModelFile, segment: Segment) -> tuple[Array, Array]:
    """Compute the torques of friction and of mechanics that a motion takes, low-passed as the segment is.

    A dynamic model starts from rest. Where no load was recorded, the load of a load-dependent model is gravity.

    Parameters
    ----------
    model : ModelFile
    segment : Segment
        n rows, low-passed (`Segment.lowpassed`).

    Returns
    -------
    friction, mechanics : (n,) array
        N m or N.
    """
    mechanics = model.mechanics
    gravity = mechanics.gravity
    static = gravity.sine * np.sin(segment.position) + gravity.cosine * np.cos(segment.position) + gravity.constant
    friction = model.friction_model.simulate(
        segment.velocity,
        segment.dt,
        position=segment.position,
        load_torque=static if segment.load_torque is None else segment.load_torque,
        temperature=segment.temperature,
    )
    static = static + mechanics.offset
    return segment.lowpass(friction), mechanics.inertia * segment.acceleration + segment.lowpass(static)


class _Reduction:
    """Reduction of the segments to the rows that are compared: settled ends removed, decimated, joined."""

    def __init__(self, settling: int, factor: int) -> None:
        self._settling, self._factor = settling, factor

    def __call__(self, values: Sequence[Array]) -> Array:
        """Reduce one (n,) array of each segment to (m,)."""
        return _joined([decimated(self._settled(each), self._factor) for each in values])

    def time_s(self, segments: Sequence[Segment]) -> Array:
        """Return the time stamps (m,) of the rows that are kept, s."""
        inner = [self._settled(each.time_s) for each in segments]
        return _joined([each[decimated_rows(len(each), self._factor)] for each in inner])

    def rows(self, segments: Sequence[Segment]) -> tuple[slice, ...]:
        """Return the rows of each segment after the reduction."""
        counts = [len(range(0, len(self._settled(each.time_s)), self._factor)) for each in segments]
        ends = np.cumsum([0, *counts]).tolist()
        return tuple(slice(begin, end) for begin, end in itertools.pairwise(ends))

    def _settled(self, values: Array) -> Array:
        return values[self._settling : len(values) - self._settling]


def _joined(parts: Sequence[Array]) -> Array:
    return parts[0] if len(parts) == 1 else np.concatenate(parts)


def _prediction(name: str, model: ModelFile, measured: Array, friction: Array, mechanics: Array) -> Prediction:
    residual = float(np.linalg.norm(measured - mechanics - friction))
    norm = float(np.linalg.norm(measured))
    return Prediction(
        model=name,
        friction=friction,
        mechanics=mechanics,
        rmse=residual / math.sqrt(len(measured)),
        relative_error=residual / norm if norm > 0.0 else math.nan,
        unit="N m" if model.axis == "rotary" else "N",
    )


def _known_inputs(recording: Recording, problems: list[str]) -> list[str]:
    """Return the slow inputs that are used; report a load with too few values."""
    known = [name for name in ("load_torque", "temperature") if name in recording]
    fraction = known_fraction(recording, "load_torque")
    if "load_torque" in known and fraction < LEAST_KNOWN_FRACTION:
        known.remove("load_torque")
        problems.append(f"load_torque is known in {100.0 * fraction:.0f} % of the rows: not used")
    return known


def _long_enough(signals: EvenSignals, factor: int, problems: list[str]) -> list[slice]:
    """Return the segments in which low-pass and decimation settle; report the others."""
    path, segments = signals.recording.path, list(signals.grid.segments)
    if signals.lowpass_hz is not None:
        periods = SETTLING_PERIODS * signals.grid.rate_hz / signals.lowpass_hz
        segments = _split_off_short(
            signals,
            segments,
            max(lowpass_padding() + 1, 2.0 * periods),
            f"a low-pass at {signals.lowpass_hz:.4g} Hz",
            problems,
        )
        if not segments:
            raise RecordingError(
                f"{path}: {signals.longest} rows without a gap are too few for a low-pass at {signals.lowpass_hz:g} "
                f"Hz, which takes {SETTLING_PERIODS:g} periods to settle at either end"
            )
    shortest = 2 * signals.settling_rows + 1
    if factor > 1:
        shortest += max(factor, decimation_padding())
    longest = max(rows.stop - rows.start for rows in segments)
    segments = _split_off_short(signals, segments, shortest + 1, "these filters", problems)
    if not segments:
        raise RecordingError(
            f"{path}: {longest} rows without a gap are too few for these filters, which take {shortest} to settle"
        )
    return segments


def _split_off_short(
    signals: EvenSignals, segments: Sequence[slice], fewest: float, filters: str, problems: list[str]
) -> list[slice]:
    """Return the segments of at least ``fewest`` rows; report the others, unless all of them are too short."""
    kept = [rows for rows in segments if rows.stop - rows.start >= fewest]
    time = signals.grid.time_s
    problems += [
        f"the part from {time[rows.start]:.6g} s to {time[rows.stop - 1]:.6g} s has {rows.stop - rows.start} rows, "
        f"too few for {filters}: left out"
        for rows in segments
        if rows not in kept
    ]
    return kept


def _without_repetition(problems: list[str]) -> tuple[str, ...]:
    """Remove sentences that occur twice or that another sentence repeats and continues."""
    return tuple(
        problem
        for problem in dict.fromkeys(problems)
        if not any(other != problem and other.startswith(problem) for other in problems)
    )


def _missing_inputs(name: str, model: ModelFile, segment: Segment) -> list[str]:
    """Report inputs that a model needs and the recording lacks.

    Raises
    ------
    RecordingError
        Friction depends on the load, and neither a column nor the model's mechanics gives it.
    """
    modifiers, gravity = model.friction.modifiers, model.mechanics.gravity
    if "load" in modifiers and segment.load_torque is None and gravity == type(gravity)():
        raise RecordingError(
            f"{segment.path}: {name} depends on the load; there is no column load_torque with a number in each row, "
            "and no gravity in the model's mechanics from which the position would give it"
        )
    if "temperature" in modifiers and segment.temperature is None:
        return [f"no temperature: {name} is evaluated at its reference temperature"]
    return []
