"""Pictures of the results that the Python interface returns, each in one pair of axes."""

from typing import TYPE_CHECKING, Any

import numpy as np

from friction_hil.friction import create
from friction_hil.identification import Identification
from friction_hil.identification.static_map import StaticMap
from friction_hil.numerics.readable import FORCE_UNITS, POSITION_UNITS, readable
from friction_hil.replay.comparison import Replay
from friction_hil.reports.figures import MEASURED, PREDICTED, WITH, WITHOUT, require_matplotlib
from friction_hil.reports.identification_pictures import velocity_points
from friction_hil.reports.replay_picture import torque_lines
from friction_hil.reports.selection_report import left_points
from friction_hil.reports.training_report import curve
from friction_hil.training import Selection, TrainedModel
from friction_hil.tuning import AxisTuning

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def _given(ax: "Axes | None") -> Any:
    """Return the axes to draw into: those given, or new ones, which a notebook shows."""
    require_matplotlib()
    if ax is not None:
        return ax
    from matplotlib import pyplot  # imported here: matplotlib is optional, and takes 0.3 s

    return pyplot.subplots(layout="constrained")[1]


def draw_identified(found: Identification | StaticMap, label: str, ax: "Axes | None") -> "Axes":
    """Draw friction over velocity: measured torque less the mechanics, and the model."""
    axes = _given(ax)
    if isinstance(found, StaticMap):
        best = found.fits[0]
        speeds = np.linspace(float(found.velocity.min()), float(found.velocity.max()), 400)
        axes.plot(found.velocity, found.torque, "o", color=MEASURED, markersize=3.0, label="measured")
        parameters: dict[str, Any] = best.parameters
        friction = create(best.family, **parameters).steady_state(speeds)
        axes.plot(speeds, best.offset + friction, color=PREDICTED, label=label)
        axes.set(xlabel="velocity", ylabel="friction")
    else:
        kind = found.settings.axis
        velocity_points(axes, found.best.curves, FORCE_UNITS[kind], f"{POSITION_UNITS[kind]}/s", ("measured", label))
    axes.legend()
    return axes  # type: ignore[no-any-return]


def draw_replay(replay: Replay, ax: "Axes | None") -> "Axes":
    """Draw measured and predicted torque over time."""
    axes = _given(ax)
    torque_lines(axes, replay)
    axes.set(xlabel="time [s]", title=f"{replay.path}, axis {replay.axis}")
    axes.legend()
    return axes  # type: ignore[no-any-return]


def draw_trained(found: Selection | TrainedModel, ax: "Axes | None") -> "Axes":
    """Draw the friction that a network was trained on, and its own, over velocity."""
    axes = _given(ax)
    kind = found.base.axis if isinstance(found, Selection) else found.task.known.axis
    unit, speed = FORCE_UNITS[kind], f"{POSITION_UNITS[kind]}/s"
    if isinstance(found, Selection):
        left_points(axes, found, found.samples.velocity)
        axes.set(xlabel=f"velocity [{speed}]", ylabel=f"torque that {found.physical.label} leaves [{unit}]")
    else:
        curve(axes, found, unit, speed)
    return axes  # type: ignore[no-any-return]


def draw_tuned(axis: AxisTuning, ax: "Axes | None") -> "Axes":
    """Draw the following error of the axis's own motion, without and with compensation."""
    axes, motion = _given(ax), axis.recommended.trial.own
    unit = POSITION_UNITS[axis.best.identification.settings.axis]
    factor, shown = readable(unit, [motion.uncompensated.rms, motion.compensated.rms])
    labels = ("without", f"with compensation by {axis.best.label}")
    for error, color, label in zip(motion.errors, (WITHOUT, WITH), labels, strict=True):
        axes.plot(motion.time_s, error * factor, color=color, linewidth=1.0, label=label)
    axes.set(xlabel="time [s]", ylabel=f"following error [{shown}]")
    axes.legend()
    return axes  # type: ignore[no-any-return]
