"""The picture of a replay: predicted and measured torque, the residual, and friction over velocity."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from friction_hil.numerics.jit import Array
from friction_hil.replay.comparison import Replay
from friction_hil.reports.decimation import bucket_size, decimated, decimated_time
from friction_hil.reports.figures import MEASURED, SERIES, new_figure_for, save

_MOST_POINTS = 20_000  # of a line: more than a picture can resolve


def draw(replay: Replay, path: Path) -> None:
    """Draw one recording with all its models into a file; the suffix gives the format.

    Raises `UsageError`: matplotlib is not installed, or does not know the suffix; `FrictionHilError`: the file cannot
    be written.
    """
    figure = new_figure_for(path, 11.0, 8.0)
    first = replay.predictions[0]
    speed = "rad/s" if first.unit == "N m" else "m/s"

    time = _line(replay, replay.time_s, decimated_time)
    every = slice(None, None, 1 + len(replay.time_s) // _MOST_POINTS)
    measured = first.measured
    axes = figure.subplot_mosaic([["torque", "friction"], ["residual", "friction"]], width_ratios=[3, 2])
    axes["residual"].sharex(axes["torque"])
    torque_lines(axes["torque"], replay)
    points: dict[str, Any] = {"marker": ".", "linestyle": "", "markersize": 2.0, "rasterized": True}
    axes["friction"].plot(replay.velocity[every], (measured - first.mechanics)[every], color=MEASURED, **points)
    for i, prediction in enumerate(replay.predictions):
        color = SERIES[i % len(SERIES)]
        residual = _line(replay, prediction.measured - prediction.torque)
        axes["residual"].plot(time, residual, color=color, linewidth=0.8)
        axes["friction"].plot(replay.velocity[every], prediction.friction[every], color=color, **points)
    axes["residual"].set(ylabel=f"measured - predicted [{first.unit}]", xlabel="time [s]")
    axes["friction"].set(
        xlabel=f"velocity [{speed}]",
        ylabel=f"friction [{first.unit}]",
        title="friction; grey: measured, less the mechanics\nof the first model",
    )
    figure.suptitle(f"{Path(replay.path).name}, axis {replay.axis}")
    figure.legend(*axes["torque"].get_legend_handles_labels(), loc="outside lower left")
    save(figure, path)


def torque_lines(axes: Any, replay: Replay) -> None:
    """Draw measured and predicted torque over time."""
    time, first = _line(replay, replay.time_s, decimated_time), replay.predictions[0]
    axes.plot(time, _line(replay, first.measured), color=MEASURED, linewidth=1.2, label="measured")
    for i, each in enumerate(replay.predictions):
        label = f"{each.model}: relative error {100.0 * each.relative_error:.2f} %"
        axes.plot(time, _line(replay, each.torque), color=SERIES[i % len(SERIES)], linewidth=0.8, label=label)
    axes.set(ylabel=f"{'torque' if first.unit == 'N m' else 'force'} [{first.unit}]")


def _line(replay: Replay, values: Array, decimate: Callable[[Array, int], Array] = decimated) -> Array:
    """Return the points of a line over time, with gaps between the parts of the recording."""
    size = bucket_size(len(replay.time_s), _MOST_POINTS)
    return np.concatenate([np.append(decimate(values[part], size), np.nan) for part in replay.segments])
