"""Records that are not those of the axis as it was: nothing is to be learned from them."""

from collections.abc import Mapping, Sequence

import numpy as np

from friction_hil.compensator.load import gravity_torque
from friction_hil.learning import thresholds as th
from friction_hil.learning.estimate import MECHANICS, Belief
from friction_hil.learning.motions import Used
from friction_hil.learning.window import COLUMNS, joined, velocity_of, window_of
from friction_hil.numerics.jit import Array


def broken(rows: Mapping[str, Array], level: float) -> str | None:
    """Return why the last rows are not to be used at all; None if they are.

    ``rows``: `COLUMNS` of `th.FROZEN_TICKS` ticks, (n,) each. ``level``: of the friction, N m.
    """
    finite = [name for name in COLUMNS if name not in ("load_estimate", "temperature_estimate")]
    if not all(np.isfinite(rows[name]).all() for name in finite):
        return "the record has gaps"
    if np.ptp(rows["torque"]) == 0.0 and np.ptp(rows["compensation"]) > th.FROZEN_LEVEL * level:
        return "the torque feedback is frozen"
    return None


def jump(past: Mapping[str, Array], tick: Mapping[str, Array], resolution: float, *, is_known: bool) -> float:
    """Return by how much the position jumps within a tick; 0 if it does no more than in the past of the same motion.

    ``past``, ``tick``: rows, (n,) each. ``resolution``: step of the position, SI. ``is_known``: the past contains all
    of the motion, not only its beginning.
    """
    errors = [_error(rows) for rows in (past, tick)]
    usual, found = (
        float(np.nanmax(np.abs(changes), initial=0.0))
        for changes in (np.diff(errors[0]), np.diff(errors[1], prepend=errors[0][-1]))
    )
    factor = th.GLITCH if is_known else th.FIRST_GLITCH
    return found if found > factor * usual + th.GLITCH_COUNTS * resolution else 0.0


def follows_otherwise(ticks: Sequence[Mapping[str, Array]], resolution: float, period_s: float) -> float:
    """Return how many times as large the following error is as that of the same demand before; 0 if it is about that.

    ``ticks``: `COLUMNS`, all with the same compensation. ``resolution``: step of the position, SI.
    """
    if len(ticks) < th.SPAN_TICKS + th.LEAST_ALIKE:
        return 0.0
    velocity = np.array([tick["velocity_demand"] for tick in ticks])
    squares = np.array([np.nanmean(_error(tick) ** 2) for tick in ticks]), np.mean(velocity**2, axis=1)
    changes = np.mean((np.diff(velocity, axis=1) / period_s) ** 2, axis=1)
    windows = [np.lib.stride_tricks.sliding_window_view(each, th.SPAN_TICKS) for each in (*squares, changes)]
    error, speed, acceleration = (np.sqrt(each.mean(axis=1)) for each in windows)
    if speed[-1] == 0.0:
        return 0.0
    is_alike = np.ones(
        error[: -th.SPAN_TICKS].size, dtype=bool
    )  # spans that share a tick with the last one are left out
    for each in (speed, acceleration):
        is_alike &= np.abs(each[: -th.SPAN_TICKS] - each[-1]) <= th.ALIKE * np.maximum(each[: -th.SPAN_TICKS], each[-1])
    if np.count_nonzero(is_alike) < th.LEAST_ALIKE:
        return 0.0
    floor = th.OTHERWISE_COUNTS * resolution
    before, now = np.maximum(error[: -th.SPAN_TICKS][is_alike], floor), max(float(error[-1]), floor)
    low, high = float(np.min(before)), float(np.max(before))
    if now > th.OTHERWISE * high:
        return now / high
    return now / low if low > th.OTHERWISE * now else 0.0


def is_other_axis(left: Array, usual: float, level: float) -> bool:
    """Return True if the torque is not that of the model any more.

    ``left``: (n,) result of `unexplained`, N m; ``usual``: its root mean square in the window of the estimate, N m.
    ``level``: of the friction, N m.
    """
    return bool(np.min(left[-th.ODD_TICKS :]) > th.ODD * usual + th.ODD_LEVEL * level)


def unexplained(
    used: Used, ticks: Sequence[Mapping[str, Array]], belief: Belief, period_s: float, resolution: float
) -> Array:
    """Return the root mean square of each tick's torque (n,) that a model leaves unexplained, N m.

    Rows without demanded motion are left out: at rest friction has any value to break-away; and those of missed
    periods. 0 for a tick of rest.

    ``used``: of its coordinates those of the friction count; the mechanics are those of the belief. ``ticks``:
    `COLUMNS`, the same number of rows in each. ``resolution``: step of the position, rad or m.
    """
    rows = joined(ticks)
    window = window_of(rows, period_s)
    velocity = velocity_of(window, resolution)
    friction = used.model.simulate(velocity, period_s, **window.inputs())
    acceleration = np.append(np.diff(velocity), 0.0) / period_s
    inertia, static, _ = belief.x[-MECHANICS:]
    left = window.torque - friction - (1.0 + inertia) * belief.mechanics.inertia * acceleration
    left -= static * belief.coordinates.model.level + gravity_torque(*belief.mechanics.static, window.position)
    counted = slice(0, -th.UNFILTERED)  # in each tick, so that an old one compares with the latest
    is_moving = (rows["velocity_demand"] != 0.0) & (rows["is_disturbed"] == 0.0)
    is_moving = is_moving.reshape(len(ticks), -1)[:, counted]
    counts = is_moving.sum(axis=1)
    squares = np.where(is_moving, left.reshape(len(ticks), -1)[:, counted] ** 2, 0.0).sum(axis=1)
    is_shown = counts >= th.LEAST_MOVING * len(window) / len(ticks)
    return np.asarray(np.where(is_shown, np.sqrt(squares / np.maximum(counts, 1)), 0.0))


def _error(rows: Mapping[str, Array]) -> Array:
    """Return the following error (n,); NaN in rows of missed periods."""
    return np.where(rows["is_disturbed"] == 0.0, rows["position_demand"] - rows["position"], np.nan)
