"""A wrong unit or sign of a recording, found because a model explains the torque with another factor. Pure."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from friction_hil.numerics.jit import Array
from friction_hil.recordings import Recording
from friction_hil.recordings.segments import Segment

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
