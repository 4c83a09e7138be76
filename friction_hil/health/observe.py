"""Observations of the friction of an axis from one of its recordings. Pure."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from friction_hil.errors import RecordingError
from friction_hil.health.observation import LOST_MOTION, AxisKind, Layout, Motion, Observation, layout_of
from friction_hil.health.reversals import add_reversals, lost_motion_of_load
from friction_hil.health.sliding import fit_sliding
from friction_hil.identification.data import prepare
from friction_hil.identification.sliding import sliding_rows, top_speed
from friction_hil.numerics.jit import Array
from friction_hil.recordings import Recording
from friction_hil.recordings.columns import TIME
from friction_hil.recordings.quality import without_overflow

COLUMNS = (TIME, "position", "velocity", "torque", "temperature", "load_position")  # of a recording, that are used
WINDOW_S = 600.0


def observe(
    recording: Recording,
    *,
    started_s: float,
    kind: AxisKind = "rotary",
    layout: Layout | None = None,
    orders: tuple[float, ...] = (),
    window_s: float = WINDOW_S,
) -> tuple[list[Observation], Layout, list[str]]:
    """Measure the friction of an axis in a recording.

    Parameters
    ----------
    recording : Recording
        With ``position`` and ``torque``; ``velocity``, ``temperature`` and ``load_position`` are used if they are
        there.
    started_s : float
        Time of ``time_s`` 0, s since 1970.
    kind : str
        ``rotary`` or ``linear``.
    layout : Layout, optional
        That of former observations of the axis, with which these will be compared; without one it is made from this
        recording.
    orders : tuple of float
        Orders of ripple to watch, for a new layout.
    window_s : float
        Length of the stretch of one observation, s; a recording is divided into equal stretches of about this length.

    Returns
    -------
    observations : list of Observation
    layout : Layout
    problems : list of str
        Why a stretch has no observation.

    Raises
    ------
    RecordingError
        The recording has no position or no torque.
    """
    recording.require("position", "torque")
    if layout is None:
        position = without_overflow(recording["position"])
        layout = layout_of(position[np.isfinite(position)], kind, orders)
    found, problems = [], []
    for part in _windows(recording, window_s):
        try:
            found.append(_observed(part, started_s, layout))
        except RecordingError as error:
            problems.append(str(error))
    return found, layout, problems


def _windows(recording: Recording, window_s: float) -> Iterator[Recording]:
    time = recording[TIME]
    count = max(1, round(recording.duration_s / window_s))
    index = np.clip(((time - time[0]) / max(recording.duration_s, 1e-9) * count).astype(int), 0, count - 1)
    for k in range(count):
        yield replace(recording.at(index == k), problems=[], restarts=[], events=[])


def _observed(part: Recording, started_s: float, layout: Layout) -> Observation:
    records = prepare(part)
    sliding = sliding_rows(records) if top_speed(records) > 0.0 else []
    if not sliding:
        raise RecordingError(
            f"{part.path}: axis {part.axis} slides for too short a time between "
            f"{part[TIME][0]:.6g} and {part[TIME][-1]:.6g} s: no observation"
        )
    fit = fit_sliding(sliding, layout)
    add_reversals(records, fit.inertia, fit.levels, fit.quantities, fit.not_shown)
    if (lost := lost_motion_of_load(part)) is not None:
        fit.quantities[LOST_MOTION] = lost
        fit.not_shown.pop(LOST_MOTION, None)
    speeds = np.concatenate([np.abs(each.record.velocity[each.rows]) for each in sliding])
    position = without_overflow(part["position"])
    return Observation(
        source=Path(part.path).name,
        time_s=started_s + float(np.mean(part[TIME])),
        duration_s=part.duration_s,
        temperature=_mean(part.columns.get("temperature")),
        motion=Motion(float(np.median(speeds)), float(np.nanmax(position) - np.nanmin(position))),
        quantities=fit.quantities,
        not_shown=fit.not_shown,
    )


def _mean(values: Array | None) -> float | None:
    """Return the mean of what is known; None if nothing is."""
    if values is None:
        return None
    values = without_overflow(values)
    known = values[np.isfinite(values)]
    return float(np.mean(known)) if known.size else None
