"""Friction over velocity while an axis moves: measured, beside the steady state of its model. Pure."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from friction_hil.drive import DriveState
from friction_hil.errors import FrictionHilError
from friction_hil.friction.steady_curve import steady_curve
from friction_hil.live.reading import Rows
from friction_hil.live.window import Window
from friction_hil.models.model_file import ModelFile
from friction_hil.numerics.jit import Array
from friction_hil.recordings import Recording
from friction_hil.replay.comparison import mechanics_torque
from friction_hil.replay.preparation import replay_segments

BINS = 80  # over all velocities, both directions
_CURVE_POINTS = 100  # on each side
_OVERLAP_S = 0.25  # of rows on either side of those that are prepared, on which filters settle
_LEAST_OVERLAP = 100  # rows
_MOST_POINTS = 20_000
_COLUMNS = ("time_s", "position", "velocity", "torque")
_NO_TORQUE = "the drive does not report its torque"
_OF_AN_ARM = "the arm's weight and inertia are in the measured torque"


@dataclass(frozen=True, slots=True, eq=False)
class FrictionMap:
    """Friction over velocity, SI; torques in N m or N."""

    velocity: Array  # (k,) mean of each bin that has points
    torque: Array  # (k,) mean friction in it: measured torque less inertia, gravity and offset of the model
    low: Array  # (k,) smallest friction in it
    high: Array  # (k,) largest friction in it
    count: "np.typing.NDArray[np.int64]"  # (k,) points in it
    curve_velocity: Array  # (m,) of the steady state of the model; empty before the axis has moved
    curve_torque: Array  # (m,) NaN at rest
    note: str  # why nothing is measured; empty if something is


class FrictionTracer:
    """Friction of one axis over velocity, of the last rows in which its drive was enabled.

    Rows are prepared as `friction_hil.replay` prepares those of a recording.

    ``window_s``: duration of the window, s of motion. ``has_torque``: the drive reports its torque. ``is_of_arm``: the
    axis is a joint of the arm, and nothing is measured.
    """

    def __init__(
        self, axis: str, period_s: float, window_s: float, *, has_torque: bool, is_of_arm: bool = False
    ) -> None:
        self._axis, self._period_s = axis, period_s
        self._overlap = max(round(_OVERLAP_S / period_s), _LEAST_OVERLAP)
        self._block = 2 * self._overlap
        self._done_s = -np.inf  # time up to which rows have been prepared
        self._step = max(1, round(window_s / period_s / _MOST_POINTS))
        self._points = Window(round(window_s / period_s / self._step), 2)
        self._rows = np.empty((0, len(_COLUMNS)))
        self._new = 0  # of the rows: not prepared yet
        self._has_torque, self._obstacle = has_torque and not is_of_arm, _OF_AN_ARM if is_of_arm else _NO_TORQUE
        self._model: ModelFile | None = None
        self._curve: tuple[float, tuple[Array, Array]] | None = None

    def compile(self, model: Mapping[str, Any]) -> None:
        """Have the code compiled that a model and the preparation of rows need, by a motion that is then dropped."""
        count = 3 * self._overlap
        at_s = np.arange(count) * self._period_s
        self.use(model)
        if self._has_torque:
            self._rows = np.stack([at_s, at_s, np.ones(count), np.ones(count)], axis=1)
            self._prepare()
        self._steady(1.0)
        self._rows, self._new, self._done_s = self._rows[:0], 0, -np.inf
        self._model = self._curve = None
        self._points.clear()

    def use(self, model: Mapping[str, Any]) -> None:
        """Take another model: another inertia gives another friction, so what was measured is dropped."""
        self._model = ModelFile.model_validate(model)
        self._points.clear()
        self._curve = None

    def take(self, rows: Rows) -> None:
        """Take further rows."""
        if not self._has_torque or not len(rows):
            return
        columns = np.stack([rows.of(self._axis, name) for name in _COLUMNS], axis=1)
        is_used = rows.of(self._axis, "drive_state") == DriveState.OPERATION_ENABLED
        is_used &= (rows.of(self._axis, "is_fresh") == 1.0) & np.isfinite(columns[:, 0])
        self._rows = np.concatenate([self._rows, columns[is_used]])
        self._new += int(np.count_nonzero(is_used))
        if self._new >= self._block:
            self._prepare()

    def figures(self) -> FrictionMap:
        """Return friction over velocity."""
        points = self._points.values()
        bins = _binned(points[:, 0], points[:, 1])
        fastest = float(np.max(np.abs(points[:, 0]), initial=0.0))
        note = "" if len(points) else "no motion yet" if self._has_torque else self._obstacle
        return FrictionMap(*bins, *self._steady(fastest), note)

    def _prepare(self) -> None:
        """Compute the friction in the rows so far, without the last ones, on which filters have not settled."""
        rows, end_s = self._rows, float(self._rows[-1 - self._overlap, 0])
        after_s, self._done_s = self._done_s, end_s
        self._rows, self._new = rows[-2 * self._overlap :], 0
        recording = Recording("", self._axis, {name: rows[:, k].copy() for k, name in enumerate(_COLUMNS)})
        assert self._model is not None
        try:
            segments, settling, _ = replay_segments(recording)
        except FrictionHilError:
            return  # too few rows without a gap: further ones may do
        for each in segments:
            torque = each.torque / self._model.mechanics.torque_ratio
            friction = torque - mechanics_torque(self._model, each)
            is_new = (each.time_s > after_s) & (each.time_s <= end_s) & np.isfinite(friction)
            is_new[: max(settling, 1)] = is_new[len(is_new) - max(settling, 1) :] = False
            points = np.stack([each.velocity, friction], axis=1)[is_new]
            self._points.extend(points[:: self._step])

    def _steady(self, fastest: float) -> tuple[Array, Array]:
        """Return the curve of the model; computed again only for another range, because it takes a while."""
        if self._model is None or not fastest:
            return np.empty(0), np.empty(0)
        if self._curve is None or not 0.8 <= fastest / self._curve[0] <= 1.0:
            reach = 1.1 * fastest
            self._curve = reach, steady_curve(self._model.friction_model, reach, _CURVE_POINTS)
        return self._curve[1]


def _binned(velocity: Array, torque: Array) -> tuple[Array, Array, Array, Array, "np.typing.NDArray[np.int64]"]:
    """Return mean velocity, mean, smallest and largest torque, and number of points of each bin that has any."""
    fastest = float(np.max(np.abs(velocity), initial=0.0)) or 1.0
    bins = np.minimum(((velocity / fastest + 1.0) * (0.5 * BINS)).astype(np.intp), BINS - 1)
    count = np.bincount(bins, minlength=BINS)
    used = np.flatnonzero(count)
    means = [np.bincount(bins, values, BINS)[used] / count[used] for values in (velocity, torque)]
    low, high = np.full(BINS, np.inf), np.full(BINS, -np.inf)
    np.minimum.at(low, bins, torque)
    np.maximum.at(high, bins, torque)
    return means[0], means[1], low[used], high[used], count[used].astype(np.int64)
