"""Pictures of an identification: torque over time, friction over velocity, residuals, hysteresis loops."""

import itertools
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from friction_hil.identification.fits import Curves
from friction_hil.numerics.jit import Array
from friction_hil.reports.decimation import bucket_size, decimated, decimated_time
from friction_hil.reports.figures import MEASURED, PREDICTED, RESIDUAL, new_figure
from friction_hil.reports.numbers import digits, readable

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_ROOM = 0.2  # of the height, above and below the lines: for the legend
_MOST_POINTS = 20_000  # of a picture: more than it can resolve
_BINS = 24
_LEAST_IN_BIN = 5
_LOOPS = 6  # hysteresis loops, each from one reversal to the next but one
_LOOPS_IN_A_ROW = 3
_SCALES = 16  # of travel at which a loop is looked for
_SMALLEST = 1e-5  # of the whole travel
_LEAST_ROWS = 12  # fewer are a polygon
_UNEQUAL = 1.5  # ratio of the two strokes from which on they are no loop
_WIDEST = 3.0  # stroke in units of the scale
_DETOUR = 1.2  # path over the two strokes: more has smaller loops within
_ALIKE = 1.2  # ratio of the travel of two loops below which only one of them is kept


def draw_time(curves: Curves, unit: str) -> "Figure":
    """Draw measured and predicted torque over time, with the residual below."""
    figure = new_figure(11.0, 5.5)
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=[2, 1])
    time = _broken(curves, curves.time_s, decimated_time)
    measured, predicted, residual = (
        _broken(curves, each) for each in (curves.measured, curves.predicted, curves.residual)
    )
    upper.plot(time, measured, color=MEASURED, linewidth=1.6, label="measured")
    upper.plot(time, predicted, color=PREDICTED, linewidth=0.9, label="predicted")
    lower.plot(time, residual, color=RESIDUAL, linewidth=0.8)
    upper.set(ylabel=f"torque [{unit}]")
    lower.set(ylabel=f"residual [{unit}]", xlabel="time [s]")
    upper.legend(loc="upper right", ncols=2)
    upper.margins(y=_ROOM)
    return figure


def draw_velocity(curves: Curves, unit: str, speed_unit: str) -> "Figure":
    """Draw friction over velocity: measured torque less the mechanics, and the model."""
    figure = new_figure(11.0, 4.6)
    left, right = figure.subplots(1, 2)
    low = float(np.quantile(np.abs(curves.velocity), 0.25))
    for axes, limit in ((left, None), (right, low)):
        velocity_points(axes, curves, unit, speed_unit)
        if limit:
            axes.set_xlim(-limit, limit)
            axes.set_title("the slowest quarter")
    return figure


def velocity_points(
    axes: "Axes", curves: Curves, unit: str, speed_unit: str, labels: tuple[str, str] = ("", "")
) -> None:
    """Draw measured friction and that of the model over velocity; ``labels`` of the two for a legend."""
    every = _every(curves)
    velocity, measured = curves.velocity[every], (curves.friction + curves.residual)[every]
    _points(axes, velocity, measured, MEASURED, labels[0])
    _points(axes, velocity, curves.friction[every], PREDICTED, labels[1])
    axes.set(xlabel=f"velocity [{speed_unit}]", ylabel=f"friction [{unit}]")


def draw_residuals(curves: Curves, unit: str, speed_unit: str, position_unit: str) -> "Figure":
    """Draw the residual over velocity, position and time, with its mean in intervals of each."""
    figure = new_figure(11.0, 4.0)
    every = _every(curves)
    quantities = (
        (curves.velocity, f"velocity [{speed_unit}]"),
        (curves.position, f"position [{position_unit}]"),
        (curves.time_s, "time [s]"),
    )
    all_axes = figure.subplots(1, 3, sharey=True)
    for axes, (values, label) in zip(all_axes, quantities, strict=True):
        _points(axes, values[every], curves.residual[every], MEASURED)
        axes.plot(*_means(values, curves.residual), color=RESIDUAL, marker="o", markersize=3.0)
        axes.set(xlabel=label)
    all_axes[0].set(ylabel=f"residual [{unit}]")
    return figure


def draw_loops(curves: Curves, unit: str, position_unit: str) -> "Figure":
    """Draw friction over position, from one reversal to the next but one, each loop with its own scale of position."""
    measured = curves.friction + curves.residual
    loops = find_loops(curves.position, curves.recording, _LOOPS)
    columns = min(max(len(loops), 1), _LOOPS_IN_A_ROW)
    rows = max(-(-len(loops) // columns), 1)
    figure = new_figure(11.0, 3.5 * rows)
    all_axes: Any = figure.subplots(rows, columns, sharey=True, squeeze=False)
    for axes, part in zip(all_axes.flat, loops, strict=False):
        position = curves.position[part]
        travel = float(np.ptp(position))
        factor, shown = readable(position_unit, travel)
        from_middle = (position - 0.5 * (position.min() + position.max())) * factor
        axes.plot(from_middle, measured[part], color=MEASURED, linewidth=1.8)
        axes.plot(from_middle, curves.friction[part], color=PREDICTED, linewidth=1.2)
        axes.set(xlabel=f"position [{shown}]", title=f"travel {digits(travel * factor)} {shown}")
        axes.locator_params(axis="x", nbins=5)
    for axes in all_axes.flat[len(loops) :]:
        axes.set_axis_off()
    for axes in all_axes[:, 0]:
        axes.set_ylabel(f"friction [{unit}]")
    if not loops:
        figure.text(0.5, 0.5, "no motion back and forth", ha="center")
    return figure


def _points(axes: "Axes", x: Array, y: Array, color: str, label: str = "") -> None:
    # rasterized: thousands of points as SVG shapes take megabytes
    axes.plot(x, y, ".", color=color, markersize=2.0, rasterized=True, label=label)


def _every(curves: Curves) -> slice:
    return slice(None, None, 1 + len(curves.time_s) // _MOST_POINTS)


def _broken(curves: Curves, values: Array, decimate: Callable[[Array, int], Array] = decimated) -> Array:
    """Return the points of a line, with gaps between recordings."""
    size = bucket_size(len(values), _MOST_POINTS)
    ends = np.flatnonzero(np.diff(curves.recording)) + 1
    return np.concatenate([np.append(decimate(piece, size), np.nan) for piece in np.split(values, ends)])


def _means(values: Array, residual: Array) -> tuple[Array, Array]:
    """Return centres of equal intervals of ``values``, and the mean residual in each that has enough samples."""
    low, high = float(values.min()), float(values.max())
    index = np.clip(((values - low) / ((high - low) or 1.0) * _BINS).astype(int), 0, _BINS - 1)
    count = np.bincount(index, minlength=_BINS)
    is_known = count >= _LEAST_IN_BIN
    sums = np.bincount(index, residual, _BINS)
    centres = low + (np.arange(_BINS) + 0.5) * (high - low) / _BINS
    return centres[is_known], sums[is_known] / count[is_known]


def find_loops(position: Array, recording: Any, most: int) -> list[slice]:
    """Return up to ``most`` loops of different travel, from small to large.

    A loop is the rows from one turning point to the next but one. ``recording``, (n,): number of the recording of each
    row; no loop extends over two of them.
    """
    ends = np.flatnonzero(np.diff(recording)) + 1
    parts = [slice(a, b) for a, b in itertools.pairwise([0, *ends.tolist(), len(position)])]
    span = max(float(np.ptp(position[part])) for part in parts)
    if span == 0.0:
        return []
    different: list[slice] = []
    longest = 0.0
    for scale in np.geomspace(_SMALLEST * span, 0.9 * span, _SCALES):
        best = max(_loops(position, parts, float(scale)), key=lambda loop: loop.stop - loop.start, default=None)
        if best is not None and (travel := float(np.ptp(position[best]))) > _ALIKE * longest:
            different.append(best)
            longest = travel
    chosen = sorted({round(k) for k in np.linspace(0, len(different) - 1, most)}) if different else []
    return [different[k] for k in chosen]


def _loops(position: Array, parts: list[slice], scale: float) -> Iterator[slice]:
    """Yield well resolved loops whose two strokes are both about as long as the scale, without smaller ones inside."""
    for part in parts:
        turns = [part.start + turn for turn in turning_points(position[part], scale)]
        for first, middle, last in zip(turns, turns[1:], turns[2:], strict=False):
            there, back = (abs(float(position[middle] - position[each])) for each in (first, last))
            if last - first < _LEAST_ROWS or max(there, back) > min(_UNEQUAL * min(there, back), _WIDEST * scale):
                continue
            if np.sum(np.abs(np.diff(position[first : last + 1]))) < _DETOUR * (there + back):
                yield slice(first, last + 1)


def turning_points(position: Array, least: float) -> list[int]:
    """Return the rows at which a position (n,) turns round, where it then comes back by ``least`` or more."""
    turns: list[int] = []
    direction, extreme, at = 0, float(position[0]), 0
    low = high = extreme
    for row, here in enumerate(position.tolist()):
        low, high = min(low, here), max(high, here)
        if direction == 0:
            if high - low >= least:
                direction, extreme, at = (1 if here == high else -1), here, row
        elif direction * (here - extreme) > 0.0:
            extreme, at = here, row
        elif direction * (extreme - here) >= least:
            turns.append(at)
            direction, extreme, at = -direction, here, row
    return turns
