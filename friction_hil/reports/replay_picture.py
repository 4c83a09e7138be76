"""The picture of a replay: predicted and measured torque over time, what is left, and torque over velocity."""

from pathlib import Path

from friction_hil.errors import RecordingError, UsageError, choices
from friction_hil.replay import Replay

_MEASURED = {"color": "0.6", "linewidth": 1.2, "label": "measured"}


def draw(replay: Replay, path: Path) -> None:
    """Draw one recording with all its models into a file; the suffix says which format.

    Raises
    ------
    UsageError
        matplotlib is not installed, or does not know the suffix.
    RecordingError
        The file cannot be written.
    """
    try:
        from matplotlib.figure import Figure
    except ImportError:
        raise UsageError("pictures need matplotlib: pip install 'friction-hil[report]'") from None

    figure = Figure(figsize=(11.0, 8.0), layout="constrained")
    known = figure.canvas.get_supported_filetypes()
    if path.suffix.removeprefix(".").lower() not in known:
        raise UsageError(f"{path}: no picture format has the suffix {path.suffix!r}; {choices(path.suffix, known)}")
    unit = replay.predictions[0].unit
    speed = "rad/s" if unit == "N m" else "m/s"
    axes = figure.subplot_mosaic([["torque", "curve"], ["residual", "curve"]], width_ratios=[3, 2])
    axes["residual"].sharex(axes["torque"])
    axes["torque"].plot(replay.time_s, replay.measured, **_MEASURED)
    axes["curve"].plot(replay.velocity, replay.measured, ".", color="0.6", markersize=1.5, label="measured")
    for i, prediction in enumerate(replay.predictions):
        color = f"C{i}"
        label = f"{prediction.model}: {100.0 * prediction.relative_error:.2f} %"
        axes["torque"].plot(replay.time_s, prediction.torque, color=color, linewidth=0.8, label=label)
        axes["residual"].plot(replay.time_s, replay.measured - prediction.torque, color=color, linewidth=0.8)
        axes["curve"].plot(replay.velocity, prediction.torque, ".", color=color, markersize=1.5)
    axes["torque"].set(ylabel=f"torque [{unit}]", title="predicted and measured")
    axes["torque"].legend(loc="upper right")
    axes["residual"].set(ylabel=f"measured - predicted [{unit}]", xlabel="time [s]")
    axes["curve"].set(xlabel=f"velocity [{speed}]", ylabel=f"torque [{unit}]", title="over velocity")
    for each in axes.values():
        each.grid(alpha=0.3)
    figure.suptitle(f"{Path(replay.path).name}, axis {replay.axis}")
    try:
        figure.savefig(path, dpi=120)
    except OSError as error:
        raise RecordingError(f"{path} cannot be written: {error.strerror}") from None
