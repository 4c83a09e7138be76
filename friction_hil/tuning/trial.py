"""Trial of a model on the machine: following error of a recorded run without and with compensation. Pure."""

from dataclasses import asdict, dataclass

from friction_hil.analysis.baseline import Phase, without_and_with
from friction_hil.analysis.following import Figures
from friction_hil.config import AxisConfig
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
        return self.uncompensated.times(self.compensated)

    @property
    def figures(self) -> dict[str, dict[str, float]]:
        """RMS and peak, ``uncompensated`` and ``compensated``, as plain values."""
        return {"uncompensated": asdict(self.uncompensated), "compensated": asdict(self.compensated)}

    @property
    def has_helped(self) -> bool:
        """True if the RMS following error is clearly smaller with compensation, and its peak is not larger."""
        return self.reduction.rms >= LEAST_REDUCTION and self.reduction.peak >= 1.0


def judge(recording: Recording, axis: AxisConfig, cycle_s: float, start_s: float) -> Trial:
    """Compare the last whole periods without compensation with the last ones with it.

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
    motion_s = period_s(axis)
    before, after = without_and_with(
        recording, cycle_s=cycle_s, motion_s=motion_s, start_s=start_s, fade_s=axis.compensation.fade_s
    )
    phases = [each for each in (before, after) if each and _length_s(each) > motion_s - 0.5 * cycle_s]
    if before is None or after is None or len(phases) < 2:
        raise RecordingError(
            f"{recording.path}: {recording.axis}: no whole period of {motion_s:g} s without and with compensation"
        )
    return Trial(before.figures, after.figures, before.time_s, (before.error, after.error))


def _length_s(phase: Phase) -> float:
    return sum(end - begin for begin, end in phase.intervals_s)
