"""A stretch of an axis's ordinary record, and the motion in it: finer than the counts of the encoder."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from friction_hil.identification.fine import moves_by_bands
from friction_hil.numerics.jit import Array

RECORDED = (
    "cycle",
    "position",
    "torque",
    "position_demand",
    "velocity_demand",
    "load_estimate",
    "temperature_estimate",
    "compensation",
    "gain_factor",
)
COLUMNS = (*RECORDED, "is_disturbed")  # 1 in rows whose error is due to a period that was missed, see `gaps`


@dataclass(frozen=True, slots=True)
class Window:
    """Rows of one axis, (n,) each, without a gap or with gaps that are filled in."""

    period_s: float
    position: Array  # measured, SI
    torque: Array  # measured, SI
    position_demand: Array  # of the same instant; NaN without a set-point
    load_torque: Array  # that the model was given
    temperature: Array  # that the model was given

    def __len__(self) -> int:
        return self.position.size

    def inputs(self) -> dict[str, Any]:
        """Return what a friction model is given beside the velocity."""
        is_known = bool(np.isfinite(self.temperature).all())
        return {
            "position": self.position,
            "load_torque": np.nan_to_num(self.load_torque),
            "temperature": self.temperature if is_known else None,
        }


def velocity_of(window: Window, resolution: float) -> Array:
    """Return the mean velocity over the period before each row, (n,); the first is 0.

    A demand is known exactly. Only what the axis deviates from it has to be separated from the encoder's counts, which
    is done band by band, see `friction_hil.identification.fine`.
    """
    rate = 1.0 / window.period_s
    known = window.position_demand if np.isfinite(window.position_demand).all() else np.zeros(len(window))
    deviation = window.position - known
    velocity = np.diff(known) * rate + moves_by_bands(deviation, rate, resolution)
    return np.concatenate([[0.0], velocity])


def joined(ticks: Sequence[Mapping[str, Array]]) -> dict[str, Array]:
    """Return the rows of ticks, `COLUMNS`, one after the other."""
    return {name: np.concatenate([tick[name] for tick in ticks]) for name in COLUMNS}


def errors_of(rows: Mapping[str, Array]) -> Array:
    """Return the following error of the rows that are not disturbed, (k,), rad or m."""
    return np.asarray((rows["position_demand"] - rows["position"])[rows["is_disturbed"] == 0.0])


def window_of(rows: Mapping[str, Array], period_s: float) -> Window:
    """Return the window of rows, `COLUMNS`."""
    return Window(
        period_s,
        rows["position"],
        rows["torque"],
        rows["position_demand"],
        rows["load_estimate"],
        rows["temperature_estimate"],
    )
