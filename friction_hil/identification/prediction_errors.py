"""Prediction errors of a fit: on its data, on blocks held out of it, and on other recordings."""

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from friction_hil.identification import thresholds as th
from friction_hil.identification.data import Data, Mask
from friction_hil.identification.least_squares import FitError
from friction_hil.identification.regression import Estimate, Regression
from friction_hil.numerics.jit import Array


@dataclass(frozen=True, slots=True)
class PredictionError:
    """Error of predicted torque."""

    rmse: float  # root mean square error, N m or N
    relative_error: float  # norm(measured - predicted) / norm(measured); NaN if all measured torques are zero
    blocks: tuple[float, ...] = ()  # mean square error of each block or recording
    # Mean square error of each of many short stretches of equal length, in the order of time. Those of two fits to the
    # same rows belong to the same stretches. If the recordings are in groups, of each group.
    stretches: tuple[float, ...] = ()


def prediction_error(
    measured: Array, predicted: Array, blocks: Sequence[Mask] = (), *, is_grouped: bool = False
) -> PredictionError:
    """Return the error of (k,) predicted torques, in all rows and in those that each mask of ``blocks`` selects.

    With ``is_grouped`` the blocks are groups of recordings, and the only stretches: what the user grouped is alike.
    """
    square = (measured - predicted) ** 2
    norm = float(np.linalg.norm(measured))
    count = max(min(th.STRETCHES, len(square) // th.LEAST_STRETCH), 1)
    each_block = tuple(float(np.mean(square[block])) for block in blocks)
    each_stretch = tuple(float(np.mean(each)) for each in np.array_split(square, count))
    return PredictionError(
        rmse=float(np.sqrt(np.mean(square))),
        relative_error=math.sqrt(float(np.sum(square))) / norm if norm > 0.0 else math.nan,
        blocks=each_block,
        stretches=each_block if is_grouped else each_stretch,
    )


def blocks(data: Data) -> list[Mask]:
    """Return masks of the rows of each block: a stretch of time, a recording, or a group of recordings."""
    owners = [record.group or record.path for record in data.records]
    masks = []
    if is_grouped(data) or len(set(owners)) >= th.RECORDINGS_AS_BLOCKS:
        for owner in dict.fromkeys(owners):
            mask = np.zeros(len(data), dtype=bool)
            for each, part in zip(owners, data.parts, strict=True):
                mask[part] |= each == owner
            masks.append(mask)
        return masks
    edges = np.linspace(0, len(data), th.BLOCKS + 1).round().astype(int)
    for begin, end in itertools.pairwise(edges):
        mask = np.zeros(len(data), dtype=bool)
        mask[begin:end] = True
        masks.append(mask)
    return masks


def is_grouped(data: Data) -> bool:
    """Return True if the user grouped the recordings, so that each group is held out as a whole."""
    return len({record.group for record in data.records if record.group}) > 1


def speed_groups(data: Data) -> list[Mask]:
    """Return masks of groups of strokes (motions between two reversals), ordered by their top speed.

    A record often repeats one motion, so that its blocks are alike and a model flexible enough to memorise that motion
    predicts them all. Holding out the strokes of some speeds tests whether they follow from those of other speeds.
    The list is empty if there are too few strokes, or if the recordings are grouped already.
    """
    if is_grouped(data):
        return []
    stroke, lengths, tops = _strokes(data)
    if np.count_nonzero(lengths >= th.HELD_OUT_LEAST_STROKE) < 2 * th.SPEED_GROUPS:
        return []
    order = np.argsort(tops, kind="stable")
    middles = np.cumsum(lengths[order]) - 0.5 * lengths[order]
    group = np.empty(len(lengths), dtype=int)
    group[order] = np.minimum(middles * th.SPEED_GROUPS / len(data), th.SPEED_GROUPS - 1).astype(int)
    masks = [group[stroke] == i for i in range(th.SPEED_GROUPS)]
    return masks if all(np.count_nonzero(mask) > th.HELD_OUT_LEAST_STROKE for mask in masks) else []


def _strokes(data: Data) -> tuple[NDArray[np.intp], NDArray[np.intp], Array]:
    """Return the number of the stroke of each row (k,), and the rows and the top speed of each stroke (n,)."""
    velocity = data.motion("velocity")
    is_first = np.diff(np.sign(velocity), prepend=0.0) != 0.0
    is_first[[part.start for part in data.parts]] = True
    stroke = np.cumsum(is_first) - 1
    tops = np.zeros(stroke[-1] + 1)
    np.maximum.at(tops, stroke, np.abs(velocity))
    return stroke, np.bincount(stroke), tops


def speeds_alike(data: Data) -> tuple[float, float] | None:
    """Return the lowest and the highest speed that strokes reach if these are about the same, else None.

    What was held out is then like what was fitted, however it was divided.
    """
    _, lengths, tops = _strokes(data)
    reached = tops[lengths >= th.HELD_OUT_LEAST_STROKE]
    if not len(reached):
        return None
    low, high = float(np.min(reached)), float(np.max(reached))
    return (low, high) if high < th.ALIKE * low else None


def cross_validate(
    regression: Regression, estimate: Estimate, masks: Sequence[Mask], *, is_linear: bool = False
) -> PredictionError:
    """Fit with the rows of each mask held out in turn, and return the error of predicting these rows.

    The models run through the whole record: only the torque is held out, not the motion. With ``is_linear`` the torque
    of each of these fits is extrapolated with the gradient of the fit to all rows, which takes no simulation.
    """
    data = regression.data
    predicted = np.empty(len(data))
    pinned = [name for name in estimate.at_bound if name in regression.keys]
    robust = None if np.all(estimate.weights == 1.0) else estimate.weights
    for mask in masks:
        near = np.convolve(mask, np.ones(2 * th.MARGIN + 1), mode="same") > 0.0
        rows = ~near
        at, torque = regression.refit(
            estimate.coordinates, rows=rows, weights=robust, pinned=pinned, is_linear=is_linear
        )
        linear = regression.linear(torque, rows=rows, weights=robust, pinned=pinned)
        predicted[mask] = regression.predict(at, linear, torque)[mask]
    if not np.isfinite(predicted).all():
        raise FitError("the torque of a fit to a part of the data is not finite")
    return prediction_error(data.torque, predicted, masks, is_grouped=is_grouped(data))


def validate(regression: Regression, estimate: Estimate) -> PredictionError:
    """Return the error of an estimate on the data of another regression with the same structure."""
    linear: Mapping[str, float] = {name: estimate.values[name] for name in regression.keys}
    predicted = regression.predict(estimate.coordinates, linear)
    data = regression.data
    return prediction_error(data.torque, predicted, blocks(data), is_grouped=is_grouped(data))
