"""What a model is worth on the machine: the following error of a recorded run, without and with it. Pure."""

import math
from dataclasses import asdict, dataclass

import numpy as np

from friction_hil.analysis import following
from friction_hil.analysis.following import SETTLE_S, Figures
from friction_hil.config import AxisConfig
from friction_hil.daemon.safety import LoopState
from friction_hil.errors import RecordingError
from friction_hil.numerics.jit import Array
from friction_hil.recordings import Recording
from friction_hil.tuning.motions import period_s

LEAST_REDUCTION = 1.05  # of the RMS; less may be chance


@dataclass(frozen=True, slots=True, eq=False)
class Trial:
    """One axis in a run that tries a model.

    Attributes
    ----------
    uncompensated, compensated : Figures
        Of whole periods of the motion, as many without as with compensation.
    time_s : (m,) array
        Time in the motion's period; the demand at a time is the same without and with compensation.
    errors : ((m,) array, (m,) array)
        Following error at these times, rad or m, without and with; NaN where the computer was always late.
    """

    uncompensated: Figures
    compensated: Figures
    time_s: Array
    errors: tuple[Array, Array]

    @property
    def reduction(self) -> Figures:
        """How many times smaller the following error is with compensation."""
        before, after = self.uncompensated, self.compensated
        return Figures(_ratio(before.rms, after.rms), _ratio(before.peak, after.peak))

    @property
    def figures(self) -> dict[str, dict[str, float]]:
        """RMS and peak, ``uncompensated`` and ``compensated``, as plain values."""
        return {"uncompensated": asdict(self.uncompensated), "compensated": asdict(self.compensated)}

    @property
    def has_helped(self) -> bool:
        """Whether the following error is clearly smaller with compensation, and no larger at its peak."""
        return self.reduction.rms >= LEAST_REDUCTION and self.reduction.peak >= 1.0


def _ratio(before: float, after: float) -> float:
    """How many times smaller; an error below the encoder's resolution is zero."""
    if after == 0.0:
        return math.inf if before > 0.0 else 1.0
    return before / after


def judge(recording: Recording, axis: AxisConfig, cycle_s: float, start_s: float) -> Trial:
    """Compare the last whole periods without compensation with the last ones of the run.

    Parameters
    ----------
    recording : Recording
        Of the run of `friction_hil.tuning.motions.trial_run`.
    axis : AxisConfig
        The axis in that run.
    cycle_s : float
        Period of the loop, s.
    start_s : float
        How long the axes take to start.

    Raises
    ------
    RecordingError
        The run was too short, or too much of it was missed.
    """
    recording.require("cycle", *following.COLUMNS)
    cycle, columns = recording["cycle"], {name: recording[name] for name in following.COLUMNS}
    error = following.error(columns)
    is_running, is_enabled = columns["state"] == LoopState.RUNNING, columns["is_enabled"] == 1.0
    is_usable = ~following.is_recovering(cycle, [columns], cycle_s)
    phases = (
        following.settled(cycle, is_running & ~is_enabled, (start_s + SETTLE_S) / cycle_s),
        following.settled(cycle, is_running & is_enabled, (axis.compensation.fade_s + SETTLE_S) / cycle_s),
    )
    length = period_s(axis) / cycle_s
    count = min(int((stop - start) / length + 1e-6) for start, stop in phases)
    if count < 1:
        raise RecordingError(
            f"{recording.path}: {recording.axis}: no whole period of {period_s(axis):g} s without and with compensation"
        )
    figures, errors = [], []
    grid = np.arange(int(length))
    for _, stop in phases:
        rows = (cycle >= stop - count * length - 1e-6) & (cycle < stop - 1e-6) & is_usable
        following.refuse_too_few(recording.path, int(np.count_nonzero(rows)), round(count * length))
        figures.append(Figures(float(np.sqrt(np.mean(error[rows] ** 2))), float(np.max(np.abs(error[rows])))))
        errors.append(_on_grid(cycle[rows] % length, error[rows], len(grid)))
    return Trial(figures[0], figures[1], np.asarray(grid * cycle_s, dtype=np.float64), (errors[0], errors[1]))


def _on_grid(place: Array, error: Array, count: int) -> Array:
    """The last error known of each of ``count`` places in a period; NaN where there is none."""
    values = np.full(count, np.nan)
    values[np.minimum(np.floor(place + 1e-6).astype(np.intp), count - 1)] = error
    return values
