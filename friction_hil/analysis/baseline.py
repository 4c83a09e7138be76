"""Following error of a recorded run without and with compensation: the figures that the run printed. Pure."""

from dataclasses import dataclass

import numpy as np

from friction_hil.analysis import following
from friction_hil.analysis.following import Figures
from friction_hil.daemon.figures import Condition, FollowingErrors
from friction_hil.daemon.safety import LoopState
from friction_hil.recordings.recording import Array, Recording


@dataclass(frozen=True, slots=True, eq=False)
class Phase:
    """Settled part of a run, either without or with compensation."""

    # of the rows that count, in the recording's time; several if the drive was off in between
    intervals_s: list[tuple[float, float]]
    figures: Figures  # following error in these rows, rad or m
    time_s: Array  # (m,), within a period of the motion, or of a motion that has none within the phase
    # (m,), last following error at each of these times, rad or m; NaN if the computer was always late there
    error: Array


def without_and_with(
    recording: Recording, *, cycle_s: float, motion_s: float, start_s: float, fade_s: float
) -> tuple[Phase | None, Phase | None]:
    """Return what counts of a run without and with compensation, by `friction_hil.daemon.figures.FollowingErrors`.

    Either is None where there is no steady motion. ``recording`` has ``cycle`` and the columns of
    `friction_hil.analysis.following`. ``cycle_s``: period of the loop. ``motion_s``: period of the motion, infinity if
    it has none. ``start_s``: that the axis takes to start; ``fade_s``: that the compensation takes to fade in. Raises
    `RecordingError`: a column is missing, or fewer than half of the rows of a phase can be used.
    """
    recording.require("cycle", *following.COLUMNS)
    running = recording["state"] == LoopState.RUNNING
    columns = following.columns_of(recording, running)
    cycle, error = recording["cycle"][running], following.error(columns)
    condition, _ = following.conditions(cycle, columns, fade_s / cycle_s)
    errors = FollowingErrors(cycle_s, start_s, motion_s)
    missed = np.maximum(np.diff(cycle, prepend=cycle[:1] - 1.0) - 1.0, 0.0).astype(np.int64)
    usable = np.isfinite(error)
    members = tuple(Condition)
    rows = zip(condition.tolist(), error.tolist(), missed.tolist(), usable.tolist(), strict=True)
    for k, value, gap, is_known in rows:
        errors.take(members[k], value, gap, is_known)
    is_usable = usable & ~following.is_recovering(cycle, [columns], cycle_s)
    found: list[Phase | None] = []
    for each in (Condition.WITHOUT, Condition.WITH):
        figures = errors.figures(each)
        if figures is None:
            found.append(None)
            continue
        following.refuse_too_few(recording.path, figures.counted, figures.counted + figures.left_out)
        intervals = [(cycle[0] + begin, cycle[0] + end) for begin, end in errors.intervals(each)]
        used = is_usable & (condition == each)
        used &= np.any([(cycle >= begin) & (cycle < end) for begin, end in intervals], axis=0)
        is_periodic = np.isfinite(motion_s)
        at = cycle[used] % (motion_s / cycle_s) if is_periodic else cycle[used] - intervals[0][0]
        length = motion_s / cycle_s if is_periodic else intervals[-1][1] - intervals[0][0]
        grid = np.arange(max(int(length + 1e-6), 1))
        found.append(
            Phase(
                [(begin * cycle_s, end * cycle_s) for begin, end in intervals],
                Figures(figures.rms, figures.peak),
                np.asarray(grid * cycle_s, dtype=np.float64),
                _on_grid(at, error[used], len(grid)),
            )
        )
    return found[0], found[1]


def _on_grid(index: Array, error: Array, count: int) -> Array:
    """Return the last known error at each of ``count`` cycles of a period; NaN where there is none."""
    values = np.full(count, np.nan)
    values[np.clip(np.floor(index + 1e-6).astype(np.intp), 0, count - 1)] = error
    return values
