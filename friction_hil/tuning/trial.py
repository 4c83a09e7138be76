"""Trial of a model on the machine: following error of recorded motions without and with compensation. Pure."""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from friction_hil.analysis import following
from friction_hil.analysis.following import Figures
from friction_hil.config import AxisConfig, MotionSequence
from friction_hil.daemon.notices import is_limit_cycle
from friction_hil.daemon.safety import LoopState
from friction_hil.errors import RecordingError
from friction_hil.numerics.jit import Array
from friction_hil.recordings import Recording
from friction_hil.recordings.columns import CYCLE
from friction_hil.tuning import thresholds as th
from friction_hil.tuning.trial_motions import windows


@dataclass(frozen=True, slots=True, eq=False)
class MotionTrial:
    """Result of one motion of one axis."""

    name: str  # ``own``, ``slow``, ``small``, ``tiny``, ``rests`` or ``fast``; see `friction_hil.tuning.trial_motions`
    uncompensated: Figures  # following error without compensation, rad or m
    compensated: Figures  # the same with it, over the same demand
    is_swinging: bool  # the compensation made the axis oscillate in this motion, so that the daemon lowered the gain
    resolution: float  # one count of the encoder, rad or m
    time_s: Array  # (m,), from the begin of what counts
    # (m,), following error at these times without and with compensation, rad or m; NaN where the computer was late
    errors: tuple[Array, Array]

    @property
    def reduction(self) -> Figures:
        """Ratios of the following error without to with compensation."""
        return self.uncompensated.times(self.compensated)

    @property
    def is_worse(self) -> bool:
        """True if the following error is clearly larger with compensation than without: RMS or peak."""
        before, after = self.uncompensated, self.compensated
        return (
            after.rms > th.LEAST_REDUCTION * before.rms + th.RMS_COUNTS * self.resolution
            or after.peak > th.LEAST_REDUCTION * before.peak + self.resolution
        )

    @property
    def figures(self) -> dict[str, dict[str, float]]:
        """RMS and peak, ``uncompensated`` and ``compensated``, as plain values."""
        return {"uncompensated": asdict(self.uncompensated), "compensated": asdict(self.compensated)}


@dataclass(frozen=True, slots=True, eq=False)
class Trial:
    """Result of one axis in the runs that try a model."""

    motions: tuple[MotionTrial, ...]  # the axis's own motion, then the others

    @property
    def own(self) -> MotionTrial:
        """Result of the axis's own motion."""
        return self.motions[0]

    @property
    def reduction(self) -> Figures:
        """Ratios of the following error of the own motion without to with compensation."""
        return self.own.reduction

    @property
    def swinging(self) -> tuple[str, ...]:
        """Names of the motions in which the compensation made the axis oscillate."""
        return tuple(each.name for each in self.motions if each.is_swinging)

    @property
    def worse(self) -> tuple[str, ...]:
        """Names of the motions whose following error is clearly larger with compensation than without."""
        return tuple(each.name for each in self.motions if each.is_worse)

    @property
    def problems(self) -> tuple[str, ...]:
        """Sentences about the motions in which the compensation did harm."""
        found = []
        if self.swinging:
            which = _listed(self.swinging)
            found.append(f"the axis oscillates by its compensation in {which}: the gain had to be lowered")
        if self.worse:
            found.append(f"the following error of {_listed(self.worse)} is larger with compensation than without")
        return tuple(found)

    @property
    def has_helped(self) -> bool:
        """True if the own motion has clearly less error with compensation, and the axis did not oscillate in it.

        Its RMS is at least `th.LEAST_REDUCTION` times lower, and its peak is not higher.
        """
        return self.reduction.rms >= th.LEAST_REDUCTION and self.reduction.peak >= 1.0 and not self.own.is_swinging

    @property
    def rank(self) -> tuple[bool, bool, bool, float]:
        """Order of trials, best first: helped, oscillated nowhere, made no motion worse, smallest `error`."""
        return not self.has_helped, bool(self.swinging), bool(self.worse), self.error

    @property
    def error(self) -> float:
        """Figure of merit, smaller is better: RMS times peak, the own motion weighing as much as all others together.

        A geometric mean, so that motions with small errors count as much as those with large ones.
        """
        logs = [math.log(max(each.compensated.rms * each.compensated.peak, 1e-300)) for each in self.motions]
        return math.exp(0.5 * (logs[0] + math.fsum(logs[1:]) / (len(logs) - 1)) if len(logs) > 1 else logs[0])

    @property
    def figures(self) -> dict[str, Any]:
        """Figures of the own motion, and under ``motions`` those of each, as plain values."""
        return {
            **self.own.figures,
            "motions": {
                each.name: {
                    **each.figures,
                    "reduction": asdict(each.reduction),
                    "is_swinging": each.is_swinging,
                    "is_worse": each.is_worse,
                }
                for each in self.motions
            },
        }


def judge(without: Recording, compensated: Recording, axis: AxisConfig, cycle_s: float, fade_s: float) -> Trial:
    """Compare the following error of each motion of a run without compensation with that of the same run with it.

    The recordings are of the run of `friction_hil.tuning.motions.trial_run`, uncompensated and as it is, and ``axis``
    is as in that run. ``cycle_s``: period of the loop. ``fade_s``: in which the compensation of all axes has faded in.
    Raises `RecordingError`: a run was too short, or too many of its cycles were missed.
    """
    sequence = axis.trajectory
    if not isinstance(sequence, MotionSequence):
        raise TypeError(f"a trial is a sequence of motions, not {sequence.kind}")
    resolution = _facts(compensated)["position_resolution"]
    swinging = _swinging(compensated, sequence, cycle_s)
    runs = [_Run(each, sequence, cycle_s) for each in (without, compensated)]
    motions = []
    for name, window in windows(sequence, fade_s).items():
        before, after = (each.figures(window) for each in runs)
        errors = runs[0].on_grid(window), runs[1].on_grid(window)
        time_s = np.arange(len(errors[0]), dtype=np.float64) * cycle_s
        motions.append(MotionTrial(name, before, after, name in swinging, resolution, time_s, errors))
    return Trial(tuple(motions))


def _listed(names: Sequence[str]) -> str:
    return f"the motion{'s' if len(names) > 1 else ''} {', '.join(map(repr, names))}"


class _Run:
    """Following error of a run over the time of its path."""

    def __init__(self, recording: Recording, sequence: MotionSequence, cycle_s: float) -> None:
        recording.require(CYCLE, *following.COLUMNS)
        running = recording["state"] == LoopState.RUNNING
        columns = following.columns_of(recording, running)
        self._path, self._cycle_s = recording.path, cycle_s
        self._axis = recording.axis
        self._error = following.error(columns)
        cycle = recording[CYCLE][running]
        self._is_usable = np.isfinite(self._error) & ~following.is_recovering(cycle, [columns], cycle_s)
        self._path_s = path_time_s(recording, sequence.ramp_s, cycle_s)

    def figures(self, window: tuple[float, float]) -> Figures:
        """Return RMS and peak within a part of the path."""
        inside = self._inside(window)
        wanted = max(round((window[1] - window[0]) / self._cycle_s), 1)
        used = self._error[inside & self._is_usable]
        if self._path_s.size == 0 or self._path_s[-1] < window[1] - 1.5 * self._cycle_s:
            raise RecordingError(f"{self._path}: {self._axis}: the run ended before all of its motions")
        following.refuse_too_few(self._path, used.size, wanted)
        return following.figures_of(used)

    def on_grid(self, window: tuple[float, float]) -> Array:
        """Return the error at each cycle of a part of the path; NaN where it is not known."""
        used = self._inside(window) & self._is_usable
        values = np.full(max(round((window[1] - window[0]) / self._cycle_s), 1), np.nan)
        index = np.floor((self._path_s[used] - window[0]) / self._cycle_s + 1e-6).astype(np.intp)
        values[np.clip(index, 0, len(values) - 1)] = self._error[used]
        return values

    def _inside(self, window: tuple[float, float]) -> Any:
        rounding = 1e-6 * self._cycle_s
        return (self._path_s >= window[0] - rounding) & (self._path_s < window[1] - rounding)


def path_time_s(recording: Recording, ramp_s: float, cycle_s: float) -> Array:
    """Return the time of the path (m,) in the rows of a recording in which it is followed, s.

    That is the time since its start, less half of the ramp in which path time starts and less what missed periods have
    put it behind; not exact within that ramp.
    """
    running = recording["state"] == LoopState.RUNNING
    cycle = recording[CYCLE][running]
    begin = cycle[0] if cycle.size else 0.0
    delay_s = max(each["setpoint_delay_s"] for each in recording.metadata["facts"])  # they are sent ahead of time
    lag_s = np.nan_to_num(recording["path_lag_s"][running]) if "path_lag_s" in recording.columns else 0.0
    found: Array = (cycle - begin) * cycle_s - delay_s - 0.5 * ramp_s - lag_s
    return found


def _swinging(recording: Recording, sequence: MotionSequence, cycle_s: float) -> set[str]:
    """Return the names of the motions in which the daemon lowered the gain."""
    cycle = recording[CYCLE][recording["state"] == LoopState.RUNNING]
    path_s = path_time_s(recording, sequence.ramp_s, cycle_s)
    starts = np.cumsum([0.0, *(part.duration_s for part in sequence.motions[:-1])])
    found = set()
    for event in recording.events:
        if event.name == "warning" and is_limit_cycle(event.text, recording.axis) and cycle.size:
            row = min(int(np.searchsorted(cycle, event.cycle)), cycle.size - 1)
            number = max(int(np.searchsorted(starts, path_s[row], side="right")) - 1, 0)
            found.add(sequence.motions[number].name)
    return found


def _facts(recording: Recording) -> Any:
    [facts] = (each for each in recording.metadata["facts"] if each["name"] == recording.axis)
    return facts
