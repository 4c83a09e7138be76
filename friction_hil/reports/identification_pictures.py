"""Pictures of an identification: torque over time, friction over velocity, residuals, hysteresis loops."""

from typing import TYPE_CHECKING, Any

import numpy as np

from friction_hil.identification.fits import Curves
from friction_hil.numerics.jit import Array
from friction_hil.reports.figures import MEASURED, PREDICTED, RESIDUAL, add_grid, new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_MOST_POINTS = 20_000  # of a picture: more than it can resolve
_BINS = 24
_LEAST_IN_BIN = 5
_LOOPS = 6  # hysteresis loops, each from one reversal to the next but one


def draw_time(curves: Curves, unit: str) -> "Figure":
    """Draw measured and predicted torque over time, with the residual below."""
    figure = new_figure(11.0, 5.5)
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=[2, 1])
    time, measured, predicted = (_broken(curves, each) for each in (curves.time_s, curves.measured, curves.predicted))
    upper.plot(time, measured, color=MEASURED, linewidth=1.6, label="measured")
    upper.plot(time, predicted, color=PREDICTED, linewidth=0.9, label="predicted")
    lower.plot(time, measured - predicted, color=RESIDUAL, linewidth=0.8)
    upper.set(ylabel=f"torque [{unit}]")
    lower.set(ylabel=f"residual [{unit}]", xlabel="time [s]")
    upper.legend(loc="upper right", ncols=2)
    return add_grid(figure)


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
    return add_grid(figure)


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
    return add_grid(figure)


def draw_loops(curves: Curves, unit: str, position_unit: str) -> "Figure":
    """Draw friction over position, from one reversal to the next but one."""
    figure = new_figure(11.0, 4.6)
    measured = curves.friction + curves.residual
    loops = _loops(curves)
    all_axes: Any = figure.subplots(1, max(len(loops), 1), sharey=True, squeeze=False)[0]
    for axes, part in zip(all_axes, loops, strict=False):
        axes.plot(curves.position[part], measured[part], color=MEASURED, linewidth=1.4)
        axes.plot(curves.position[part], curves.friction[part], color=PREDICTED, linewidth=1.0)
        axes.set(xlabel=f"position [{position_unit}]")
        axes.tick_params(axis="x", labelrotation=45)
    all_axes[0].set(ylabel=f"friction [{unit}]")
    return add_grid(figure)


def _points(axes: "Axes", x: Array, y: Array, color: str) -> None:
    axes.plot(
        x, y, ".", color=color, markersize=2.0, rasterized=True
    )  # thousands of points as SVG shapes take megabytes


def _every(curves: Curves) -> slice:
    return slice(None, None, 1 + len(curves.time_s) // _MOST_POINTS)


def _broken(curves: Curves, values: Array) -> Array:
    """Return the points of a line, with gaps between recordings."""
    every = 1 + len(values) // _MOST_POINTS
    ends = np.flatnonzero(np.diff(curves.recording)) + 1
    pieces = [np.append(piece[::every], np.nan) for piece in np.split(values, ends)]
    return np.concatenate(pieces)


def _means(values: Array, residual: Array) -> tuple[Array, Array]:
    """Return centres of equal intervals of ``values``, and the mean residual in each that has enough samples."""
    low, high = float(values.min()), float(values.max())
    index = np.clip(((values - low) / ((high - low) or 1.0) * _BINS).astype(int), 0, _BINS - 1)
    count = np.bincount(index, minlength=_BINS)
    is_known = count >= _LEAST_IN_BIN
    sums = np.bincount(index, residual, _BINS)
    centres = low + (np.arange(_BINS) + 0.5) * (high - low) / _BINS
    return centres[is_known], sums[is_known] / count[is_known]


def _loops(curves: Curves) -> list[slice]:
    """Return parts of the recording that move back and forth, from small to large travel."""
    moving = np.abs(curves.velocity) > 1e-3 * np.max(np.abs(curves.velocity))
    rows = np.flatnonzero(moving)
    reversals = rows[np.flatnonzero(np.diff(np.sign(curves.velocity[rows])) != 0) + 1]
    parts = [slice(int(a), int(b) + 1) for a, b in zip(reversals, reversals[2:], strict=False)]
    parts = [part for part in parts if curves.recording[part.start] == curves.recording[part.stop - 1]]
    parts.sort(key=lambda part: float(np.ptp(curves.position[part])))
    chosen = sorted({round(k) for k in np.linspace(0, len(parts) - 1, _LOOPS)}) if parts else []
    return [parts[k] for k in chosen]
