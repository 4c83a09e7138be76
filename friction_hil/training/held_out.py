"""What a physical model leaves of data that it was not fitted to, and comparison of errors by paired differences."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from friction_hil.identification.data import Data, Mask
from friction_hil.identification.fits import MECHANICS, Fit
from friction_hil.identification.prediction_errors import blocks, speed_groups
from friction_hil.identification.regression import Regression
from friction_hil.models.model_file import ModelFile
from friction_hil.numerics.jit import Array
from friction_hil.training import thresholds as th

SPEEDS, BLOCKS, OTHERS = "strokes of other speeds", "blocks of time", "other recordings"


@dataclass(frozen=True, slots=True)
class Gain:
    """Decrease of the mean square error on held-out data, over the mean square error before."""

    mean: float  # over the held-out parts
    error: float  # standard error of the mean, from the differences of each part

    @property
    def is_clear(self) -> bool:
        """True if the decrease exceeds its standard error, and is large enough to matter."""
        return self.mean > max(self.error, th.LEAST_GAIN)

    @property
    def words(self) -> str:
        """The decrease or increase of an error, as words after "is"."""
        way = "lower" if self.mean >= 0.0 else "higher"
        return f"{way} by {100.0 * abs(self.mean):.1f} +- {100.0 * self.error:.1f} %"

    def __str__(self) -> str:
        return f"{100.0 * self.mean:.1f} +- {100.0 * self.error:.1f} %"


def gain(errors: Sequence[float], before: Sequence[float]) -> Gain:
    """Compare mean square errors of the same parts, pair by pair."""
    after, base = np.asarray(errors), np.asarray(before)
    scale = float(np.mean(base)) or 1.0
    difference = (base - after) / scale
    count = len(difference)
    error = float(np.std(difference, ddof=1)) / math.sqrt(count) if count > 1 else math.inf
    return Gain(float(np.mean(difference)), error)


def kinds(data: Data, check: Data | None) -> dict[str, list[Mask]]:
    """Return the masks of held-out rows by kind; the first kind decides.

    Other recordings decide if there are any. Otherwise strokes of other speeds do, because a record often repeats one
    motion, of which a network knows every block from the other ones; blocks of time are then judged as well.
    """
    if check is not None:
        return {OTHERS: blocks(check)}
    speeds = speed_groups(data)
    return {**({SPEEDS: speeds} if speeds else {}), BLOCKS: blocks(data)}


def beside(mask: Mask) -> Mask:
    """Return the rows that may be used for training while those of a mask are held out."""
    return np.convolve(mask, np.ones(2 * th.MARGIN + 1), mode="same") == 0.0


class Physical(Protocol):
    """A physical model of the axis."""

    @property
    def is_refitted(self) -> bool:
        """True if rows that are held out are held out of this model as well."""

    def left(self, data: Data, rows: Mask | None = None) -> Array:
        """Return measured minus predicted torque (k,) of a model that is fitted to the given rows only."""


class Given:
    """A model file as it is: nothing is held out of it."""

    is_refitted = False

    def __init__(self, known: ModelFile) -> None:
        self._known, self._model = known, known.friction_model

    def left(self, data: Data, rows: Mask | None = None) -> Array:
        """See `Physical.left`."""
        mechanics, torques = self._known.mechanics, []
        for record in data.records:
            load = mechanics.gravity.at(record.position)
            friction = self._model.simulate(
                record.velocity,
                record.dt,
                position=record.position,
                load_torque=load if record.load_torque is None else record.load_torque,
                temperature=record.temperature,
            )
            torques.append(friction + load + mechanics.offset)
        torque = data.stack(torques) + mechanics.inertia * data.column("inertia")
        return data.torque - mechanics.torque_ratio * torque


class Refitted:
    """A fit of `identify`, fitted again to the rows that are not held out."""

    is_refitted = True

    def __init__(self, fitted: Fit, loads: Sequence[Array] | None) -> None:
        self._fit, self._loads = fitted, loads
        self._regression: Regression | None = None
        self._data: Data | None = None

    def left(self, data: Data, rows: Mask | None = None) -> Array:
        """See `Physical.left`."""
        estimate = self._fit.estimate
        if self._regression is None or self._data is not data:
            held = {name: value for name, value in self._fit.mechanics.items() if name not in estimate.values}
            names = [name for name in MECHANICS if name in estimate.values]
            self._regression = Regression(data, self._fit.structure, names, held, self._loads)
            self._data = data
        regression = self._regression
        if rows is None:
            linear = {name: estimate.values[name] for name in regression.keys}
            return data.torque - regression.predict(estimate.coordinates, linear)
        pinned = [name for name in estimate.at_bound if name in regression.keys]
        at, torque = regression.refit(estimate.coordinates, rows=rows, pinned=pinned)
        linear = regression.linear(torque, rows=rows, pinned=pinned)
        return data.torque - regression.predict(at, linear, torque)
