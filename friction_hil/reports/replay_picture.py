"""The picture of a replay: predicted and measured torque, the residual, and friction over velocity."""

from pathlib import Path

import numpy as np

from friction_hil.numerics.jit import Array
from friction_hil.replay.comparison import Replay
from friction_hil.reports.figures import new_figure_for, save

_MOST_POINTS = 100_000  # of a line: more than a picture can resolve


def draw(replay: Replay, path: Path) -> None:
    """Draw one recording with all its models into a file; the suffix gives the format.

    Raises
    ------
    UsageError
        matplotlib is not installed, or does not know the suffix.
    FrictionHilError
        The file cannot be written.
    """
    figure = new_figure_for(path, 11.0, 8.0)
    first = replay.predictions[0]
    what, speed = ("torque", "rad/s") if first.unit == "N m" else ("force", "m/s")

    def line(values: Array) -> Array:
        """Return the points of a line, with gaps between the parts of the recording."""
        pieces = [np.append(values[part][::every], np.nan) for part in replay.segments]
        return np.concatenate(pieces)

    every = 1 + len(replay.time_s) // _MOST_POINTS
    time, velocity, measured = map(line, (replay.time_s, replay.velocity, replay.measured))
    axes = figure.subplot_mosaic([["torque", "friction"], ["residual", "friction"]], width_ratios=[3, 2])
    axes["residual"].sharex(axes["torque"])
    axes["torque"].plot(time, measured, color="0.6", linewidth=1.2, label="measured")
    axes["friction"].plot(velocity, measured - line(first.mechanics), ".", color="0.6", markersize=2.0)
    for i, prediction in enumerate(replay.predictions):
        color = f"C{i}"
        label = f"{prediction.model}: relative error {100.0 * prediction.relative_error:.2f} %"
        torque = line(prediction.torque)
        axes["torque"].plot(time, torque, color=color, linewidth=0.8, label=label)
        axes["residual"].plot(time, measured - torque, color=color, linewidth=0.8)
        axes["friction"].plot(velocity, line(prediction.friction), ".", color=color, markersize=2.0)
    axes["torque"].set(ylabel=f"{what} [{first.unit}]")
    axes["residual"].set(ylabel=f"measured - predicted [{first.unit}]", xlabel="time [s]")
    axes["friction"].set(
        xlabel=f"velocity [{speed}]",
        ylabel=f"friction [{first.unit}]",
        title="friction; grey: measured, less the mechanics\nof the first model",
    )
    for each in axes.values():
        each.grid(alpha=0.3)
    figure.suptitle(f"{Path(replay.path).name}, axis {replay.axis}")
    figure.legend(*axes["torque"].get_legend_handles_labels(), loc="outside lower left")
    save(figure, path)
