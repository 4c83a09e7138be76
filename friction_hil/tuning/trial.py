"""Trial of a model on the machine: following error of a recorded run without and with compensation. Pure."""

from dataclasses import asdict, dataclass

import numpy as np

from friction_hil.analysis import following
from friction_hil.analysis.following import SETTLE_S, Figures
from friction_hil.config import AxisConfig
from friction_hil.daemon.figures import reduction
from friction_hil.daemon.safety import LoopState
from friction_hil.errors import RecordingError
from friction_hil.numerics.jit import Array
from friction_hil.recordings import Recording
from friction_hil.tuning.motions import period_s

LEAST_REDUCTION = 1.05  # of the RMS; smaller ones may be chance


@dataclass(frozen=True, slots=True, eq=False)
class Trial:
    """Result of one axis in a run that tries a model.

    Attributes
    ----------
    uncompensated, compensated : Figures
        Following error of whole periods of the motion, as many without as with compensation.
    time_s : (m,) array
        Time within a period of the motion; the demand is the same without and with compensation.
    errors : ((m,) array, (m,) array)
        Following error at these times without and with compensation, rad or m; NaN if the computer was always late.
    """

    uncompensated: Figures
    compensated: Figures
    time_s: Array
    errors: tuple[Array, Array]

    @property
    def reduction(self) -> Figures:
        """Ratios of the following error without to with compensation."""
        return reduction(self.uncompensated, self.compensated)

    @property
    def figures(self) -> dict[str, dict[str, float]]:
        """RMS and peak, ``uncompensated`` and ``compensated``, as plain values."""
        return {"uncompensated": asdict(self.uncompensated), "compensated": asdict(self.compensated)}

    @property
    def has_helped(self) -> bool:
        """True if the RMS following error is clearly smaller with compensation, and its peak is not larger."""
        return self.reduction.rms >= LEAST_REDUCTION and self.reduction.peak >= 1.0


def judge(recording: Recording, axis: AxisConfig, cycle_s: float, start_s: float) -> Trial:
    """Compare the last whole periods without compensation with the last ones of the run.

    Parameters
    ----------
    recording : Recording
        Recording of the run of `friction_hil.tuning.motions.trial_run`.
    axis : AxisConfig
        Configuration of the axis in that run.
    cycle_s : float
        Period of the loop, s.
    start_s : float
        Time that the axes take to start, s.

    Raises
    ------
    RecordingError
        The run was too short, or too many of its cycles were missed.
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


def _on_grid(index: Array, error: Array, count: int) -> Array:
    """Return the last known error at each of ``count`` cycles of a period; NaN where there is none."""
    values = np.full(count, np.nan)
    values[np.minimum(np.floor(index + 1e-6).astype(np.intp), count - 1)] = error
    return values
