"""The picture of a replay: predicted and measured torque, the residual, and friction over velocity."""

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
    what, speed = ("torque", "rad/s") if first.unit == "N m" else ("force", "m/s")

    size = bucket_size(len(replay.time_s), _MOST_POINTS)

    def line(values: Array) -> Array:
        """Return the points of a line over time, with gaps between the parts of the recording."""
        return np.concatenate([np.append(decimated(values[part], size), np.nan) for part in replay.segments])

    time = np.concatenate([np.append(decimated_time(replay.time_s[part], size), np.nan) for part in replay.segments])
    every = slice(None, None, 1 + len(replay.time_s) // _MOST_POINTS)
    measured = first.measured
    axes = figure.subplot_mosaic([["torque", "friction"], ["residual", "friction"]], width_ratios=[3, 2])
    axes["residual"].sharex(axes["torque"])
    axes["torque"].plot(time, line(measured), color=MEASURED, linewidth=1.2, label="measured")
    points: dict[str, Any] = {"marker": ".", "linestyle": "", "markersize": 2.0, "rasterized": True}
    axes["friction"].plot(replay.velocity[every], (measured - first.mechanics)[every], color=MEASURED, **points)
    for i, prediction in enumerate(replay.predictions):
        color = SERIES[i % len(SERIES)]
        label = f"{prediction.model}: relative error {100.0 * prediction.relative_error:.2f} %"
        axes["torque"].plot(time, line(prediction.torque), color=color, linewidth=0.8, label=label)
        axes["residual"].plot(time, line(prediction.measured - prediction.torque), color=color, linewidth=0.8)
        axes["friction"].plot(replay.velocity[every], prediction.friction[every], color=color, **points)
    axes["torque"].set(ylabel=f"{what} [{first.unit}]")
    axes["residual"].set(ylabel=f"measured - predicted [{first.unit}]", xlabel="time [s]")
    axes["friction"].set(
        xlabel=f"velocity [{speed}]",
        ylabel=f"friction [{first.unit}]",
        title="friction; grey: measured, less the mechanics\nof the first model",
    )
    figure.suptitle(f"{Path(replay.path).name}, axis {replay.axis}")
    figure.legend(*axes["torque"].get_legend_handles_labels(), loc="outside lower left")
    save(figure, path)
