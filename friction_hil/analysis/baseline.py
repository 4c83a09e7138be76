"""Following error of one axis without and with compensation, over whole periods of its motion. Pure."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from friction_hil.analysis import following
from friction_hil.analysis.following import SETTLE_S, Figures
from friction_hil.daemon.safety import LoopState
from friction_hil.recordings.recording import Array, Recording

_LEAST_S = 0.1  # of a phase of a motion without period


@dataclass(frozen=True, slots=True, eq=False)
class Phase:
    """Settled part of a run, either without or with compensation.

    Attributes
    ----------
    interval_s : (float, float)
        Begin and end of the rows that count, in the recording's time.
    figures : Figures
        Following error in these rows, rad or m.
    time_s : (m,) array
        Time within a period of the motion.
    error : (m,) array
        Last following error at each of these times, rad or m; NaN if the computer was always late there.
    """

    interval_s: tuple[float, float]
    figures: Figures
    time_s: Array
    error: Array


def without_and_with(
    recording: Recording, *, cycle_s: float, motion_s: float | None, start_s: float, fade_s: float
) -> tuple[Phase | None, Phase | None]:
    """Return the last whole periods without and with compensation, as many without as with.

    After a missed period or late feedback, rows are left out until the drive has recovered.

    Parameters
    ----------
    recording : Recording
        With ``cycle`` and the columns of `friction_hil.analysis.following`.
    cycle_s : float
        Period of the loop, s.
    motion_s : float or None
        Period of the motion, s. None if it has none: both phases are then equally long.
    start_s, fade_s : float
        Time that the axis takes to start, and that the compensation takes to fade in, s.

    Returns
    -------
    without, compensated : Phase or None
        None where there is no whole period.

    Raises
    ------
    RecordingError
        A column is missing, or fewer than half of the rows of a phase can be used.
    """
    recording.require("cycle", *following.COLUMNS)
    cycle, columns = recording["cycle"], {name: recording[name] for name in following.COLUMNS}
    error = following.error(columns)
    has_demand = np.isfinite(columns["position_demand"])
    is_running, is_enabled = columns["state"] == LoopState.RUNNING, columns["is_enabled"] == 1.0
    is_usable = ~following.is_recovering(cycle, [columns], cycle_s)
    masks = is_running & ~is_enabled & has_demand, is_running & is_enabled & has_demand
    settling = (start_s + SETTLE_S) / cycle_s, (fade_s + SETTLE_S) / cycle_s
    spans = [following.settled(cycle, _longest(mask), rest) for mask, rest in zip(masks, settling, strict=True)]
    if motion_s is None:
        longest = min((stop - start for start, stop in spans if (stop - start) * cycle_s >= _LEAST_S), default=math.inf)
        motion = longest
    else:
        motion = motion_s / cycle_s
    counts = [int((stop - start) / motion + 1e-6) for start, stop in spans]
    count = min((each for each in counts if each), default=0)
    found: list[Phase | None] = []
    for (_, stop), known in zip(spans, counts, strict=True):
        if not known:
            found.append(None)
            continue
        start = stop - count * motion
        rows = (cycle >= start - 1e-6) & (cycle < stop - 1e-6) & is_usable & np.isfinite(error)
        following.refuse_too_few(recording.path, int(np.count_nonzero(rows)), round(count * motion))
        figures = Figures(float(np.sqrt(np.mean(error[rows] ** 2))), float(np.max(np.abs(error[rows]))))
        at = cycle[rows] - start if motion_s is None else cycle[rows] % motion
        grid = np.arange(int(motion + 1e-6))
        interval = start * cycle_s, stop * cycle_s
        time_s = np.asarray(grid * cycle_s, dtype=np.float64)
        found.append(Phase(interval, figures, time_s, _on_grid(at, error[rows], len(grid))))
    return found[0], found[1]


def _longest(mask: Any) -> Any:
    """Return the mask of the longest contiguous range of a mask."""
    edges = np.flatnonzero(np.diff(mask.astype(np.int8), prepend=0, append=0))
    longest = np.zeros_like(mask)
    if edges.size:
        starts, stops = edges[::2], edges[1::2]
        k = int(np.argmax(stops - starts))
        longest[starts[k] : stops[k]] = True
    return longest


def _on_grid(index: Array, error: Array, count: int) -> Array:
    """Return the last known error at each of ``count`` cycles of a period; NaN where there is none."""
    values = np.full(count, np.nan)
    values[np.minimum(np.floor(index + 1e-6).astype(np.intp), count - 1)] = error
    return values
