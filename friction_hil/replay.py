"""Recordings through friction models: what torque a model says was needed, against what was measured. Pure.

The model is the inverse one: torque = inertia * acceleration + offset + gravity + friction. Every part of both
sides passes the same filters, once: inertia times the acceleration of the low-passed position, and the low-pass
of everything else.
"""

import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from numpy.typing import NDArray

from friction_hil.errors import RecordingError, UsageError
from friction_hil.recordings import Recording

if TYPE_CHECKING:
    from friction_hil.config import ModelFile

Array: TypeAlias = NDArray[np.float64]

DEFAULT_LOWPASS_SHARE = 0.1  # of the sampling rate, where velocity must be derived from position
_LOWPASS_ORDER = 4
_DECIMATOR = (8, 0.05, 0.8)  # order, ripple in dB and share of the new Nyquist frequency of the Chebyshev filter
_PADDING_PER_ORDER = 3  # samples by which a zero-phase filter extends a record at both ends
_TRANSIENT_PERIODS = 5.0  # of the low-pass, left out at both ends: what it makes of the end of a record is not data
_UNEVEN_SHARE = 0.1  # of the period: larger deviations of a time stamp make a record uneven
_GAP_PERIODS = 10.0  # beyond which nothing is interpolated


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
    transient = 0 if motion.lowpass_hz is None else _transient(motion.lowpass_hz, motion.rate_hz)
    shortest = 2 * transient + 1
    if decimate > 1:
        shortest += max(decimate, _PADDING_PER_ORDER * _DECIMATOR[0])
    if len(motion.time_s) <= shortest:
        raise RecordingError(
            f"{recording.path}: {len(motion.time_s)} rows without a gap are too few for these filters, which take "
            f"{shortest} to settle"
        )

    inner = slice(transient, len(motion.time_s) - transient)

    def reduce(values: Array) -> Array:
        return _decimated(values[inner], decimate)

    measured = reduce(motion.torque)
    predictions = []
    problems = [*recording.problems, *motion.problems]
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
        problems=tuple(problems),
        time_s=motion.time_s[inner][::-1][::decimate][::-1],
        velocity=reduce(motion.velocity),
        measured=measured,
        predictions=tuple(predictions),
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

    Where no load was recorded, that of friction is gravity.
    """
    mechanics = model.mechanics
    gravity = mechanics.gravity
    static = gravity.sine * np.sin(motion.position) + gravity.cosine * np.cos(motion.position) + gravity.constant
    friction = model.friction_model.simulate(
        motion.velocity,
        1.0 / motion.rate_hz,
        position=motion.position,
        load_torque=static if motion.load_torque is None else motion.load_torque,
        temperature=motion.temperature,
    )
    static = static + mechanics.offset
    if motion.lowpass_hz is not None:
        friction = _lowpassed(friction, motion.lowpass_hz, motion.rate_hz)
        static = _lowpassed(static, motion.lowpass_hz, motion.rate_hz)
    return friction, mechanics.inertia * motion.acceleration + static


def derive(recording: Recording, lowpass_hz: float | None = None) -> Motion:
    """Bring a recording to an even grid, and derive velocity and acceleration; see `replay`."""
    has_velocity = "velocity" in recording and lowpass_hz is None
    names = ["position", "torque", *(["velocity"] if has_velocity else [])]
    recording.require(*names)
    names += [name for name in ("load_torque", "temperature") if _is_known(recording, name)]
    time, columns, problems = _even(recording, names)
    rate_hz = (len(time) - 1) / (time[-1] - time[0])
    if not has_velocity and lowpass_hz is None:
        lowpass_hz = DEFAULT_LOWPASS_SHARE * rate_hz
        problems.append(f"no velocity: derived from the position below {lowpass_hz:.4g} Hz")
    if lowpass_hz is not None:
        _check_lowpass(recording.path, lowpass_hz, rate_hz, len(time))
        columns = {name: _lowpassed(values, lowpass_hz, rate_hz) for name, values in columns.items()}
    velocity = columns["velocity"] if has_velocity else np.gradient(columns["position"], 1.0 / rate_hz)
    return Motion(
        time_s=time,
        position=columns["position"],
        velocity=velocity,
        acceleration=np.gradient(velocity, 1.0 / rate_hz),
        torque=columns["torque"],
        load_torque=columns.get("load_torque"),
        temperature=columns.get("temperature"),
        rate_hz=rate_hz,
        lowpass_hz=lowpass_hz,
        problems=tuple(problems),
    )


def _is_known(recording: Recording, name: str) -> bool:
    return name in recording and bool(np.all(np.isfinite(recording[name])))


def _even(recording: Recording, names: list[str]) -> tuple[Array, dict[str, Array], list[str]]:
    """Time stamps and columns at an even rate: the longest part without a gap, interpolated where needed."""
    problems: list[str] = []
    time = recording["time_s"]
    columns = {name: recording[name] for name in names}
    for name, values in columns.items():
        wrong = np.flatnonzero(~np.isfinite(values))
        if wrong.size:
            raise RecordingError(
                f"{recording.path}: {name} is not finite in {wrong.size} rows, the first is row {wrong[0]}; "
                "cut the recording, or mend it"
            )
    forward = np.concatenate([[True], time[1:] > np.maximum.accumulate(time)[:-1]])
    time, columns = time[forward], {name: values[forward] for name, values in columns.items()}
    if len(time) < 3:
        raise RecordingError(f"{recording.path}: {len(time)} rows in order of time are too few")
    period = float(np.median(np.diff(time)))
    ends = [0, *(np.flatnonzero(np.diff(time) > _GAP_PERIODS * period) + 1), len(time)]
    begin, end = max(itertools.pairwise(ends), key=lambda part: part[1] - part[0])
    if len(ends) > 2:
        problems.append(f"of {len(ends) - 1} parts between gaps, only the longest is used: {end - begin} rows")
        time, columns = time[begin:end], {name: values[begin:end] for name, values in columns.items()}
    if len(time) < 3:
        raise RecordingError(f"{recording.path}: {len(time)} rows without a gap are too few")
    even = np.linspace(time[0], time[-1], 1 + round((time[-1] - time[0]) / period))
    if len(even) == len(time) and np.max(np.abs(even - time)) <= _UNEVEN_SHARE * period:
        return time, columns, problems
    problems.append(f"the time stamps are uneven: interpolated at {1.0 / period:.6g} Hz")
    return even, {name: np.interp(even, time, values) for name, values in columns.items()}, problems


def _check_lowpass(path: str, lowpass_hz: float, rate_hz: float, rows: int) -> None:
    if not 0.0 < lowpass_hz < rate_hz / 2.0:
        raise UsageError(
            f"{path}: a low-pass lies above 0 and below half the sampling rate, {rate_hz / 2.0:.6g} Hz, "
            f"not at {lowpass_hz:g} Hz"
        )
    slowest_hz = 2.0 * _TRANSIENT_PERIODS * rate_hz / rows
    if rows <= _PADDING_PER_ORDER * _LOWPASS_ORDER or lowpass_hz < slowest_hz:
        raise RecordingError(
            f"{path}: {rows} rows without a gap are too few for a low-pass at {lowpass_hz:g} Hz, "
            f"which takes {_TRANSIENT_PERIODS:g} periods to settle at either end"
        )


def _transient(lowpass_hz: float, rate_hz: float) -> int:
    """Rows at either end that a low-pass spoils."""
    return math.ceil(_TRANSIENT_PERIODS * rate_hz / lowpass_hz) - 1


def _lowpassed(values: Array, lowpass_hz: float, rate_hz: float) -> Array:
    from scipy import signal

    sections = signal.butter(_LOWPASS_ORDER, lowpass_hz / (rate_hz / 2.0), output="sos")
    filtered: Array = signal.sosfiltfilt(sections, values, padlen=_PADDING_PER_ORDER * _LOWPASS_ORDER)
    return filtered


def _decimated(values: Array, factor: int) -> Array:
    """Each ``factor``-th sample, the last one among them, as MATLAB's ``decimate`` does it."""
    if factor == 1:
        return values
    from scipy import signal

    order, ripple_db, share = _DECIMATOR
    sections = signal.cheby1(order, ripple_db, share / factor, output="sos")
    filtered: Array = signal.sosfiltfilt(sections, values, padlen=_PADDING_PER_ORDER * order)
    return filtered[(len(values) - 1) % factor :: factor]
