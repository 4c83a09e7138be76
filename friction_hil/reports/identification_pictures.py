"""Pictures of an identification: torque over time, friction over velocity, residuals, hysteresis loops."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from friction_hil.identification.fits import Curves
from friction_hil.numerics.jit import Array
from friction_hil.reports.decimation import bucket_size, decimated, decimated_time
from friction_hil.reports.figures import MEASURED, PREDICTED, RESIDUAL, new_figure
from friction_hil.reports.hysteresis_loops import find_loops
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
    every = _every(curves)
    velocity, measured = curves.velocity[every], (curves.friction + curves.residual)[every]
    low = float(np.quantile(np.abs(curves.velocity), 0.25))
    for axes, limit in ((left, None), (right, low)):
        _points(axes, velocity, measured, MEASURED)
        _points(axes, velocity, curves.friction[every], PREDICTED)
        axes.set(xlabel=f"velocity [{speed_unit}]", ylabel=f"friction [{unit}]")
        if limit:
            axes.set_xlim(-limit, limit)
            axes.set_title("the slowest quarter")
    return figure


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


def _points(axes: "Axes", x: Array, y: Array, color: str) -> None:
    axes.plot(
        x, y, ".", color=color, markersize=2.0, rasterized=True
    )  # thousands of points as SVG shapes take megabytes


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
