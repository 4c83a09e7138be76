"""The report of a training: errors, network against friction, comparison with models, course of the training."""

import html
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from friction_hil import __version__
from friction_hil.numerics.jit import Array
from friction_hil.reports.figures import BLUE, GREY, INK, ORANGE, SERIES, new_figure
from friction_hil.reports.page import page, picture, table, unordered_list, write_page
from friction_hil.training import Samples, TrainedModel

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MARK = f'<meta name="generator" content="friction-hil train {__version__}">'
_TRUE, _LEARNED, _ERROR = GREY, BLUE, ORANGE
_ROOM = 0.2  # of the height, above and below the lines: for the legend
_MOST_POINTS = 6000  # of a drawn signal


def write_report(path: Path, candidate: TrainedModel, seconds: float) -> None:
    """Write the report; an existing file is overwritten. Raises `FrictionHilError`: the file cannot be written."""
    task, trained = candidate.task, candidate.trained
    is_rotary = task.known.axis == "rotary"
    unit, speed = ("N m", "rad/s") if is_rotary else ("N", "m/s")
    signals = task.unseen or {"held-out data": task.validation}
    runs = {name: (samples, candidate.free_run(samples)) for name, samples in signals.items()}
    body = f"""
<h1>A network for friction: {html.escape(str(candidate.network))}</h1>
<p>{_result(candidate)} Trained in {seconds:.1f} s, {trained.iterations} iterations, seed {trained.seed}.</p>
<h2>Errors</h2>
{_errors(candidate)}
{unordered_list([*(f"not for motion {each}" for each in candidate.not_for), *task.notes, *trained.flags])}
<h2>Free run on signals that were not used for training</h2>
{
        "".join(
            picture(_draw_signal(*run, unit, speed), f"{name}: NRMSE {candidate.error(run[0]):.4f}.", "wide")
            for name, run in runs.items()
        )
    }
{_compared(candidate)}
<h2>Errors over velocity and its rate</h2>
{picture(_draw_errors(list(runs.values()), unit, speed), _ERRORS_CAPTION, "wide")}
<h2>Friction over velocity</h2>
{picture(_draw_curve(candidate, unit, speed), _CURVE_CAPTION)}
<h2>Course of the training</h2>
{picture(_draw_course(candidate), _COURSE_CAPTION, "wide")}
<p class="note">friction-hil {__version__}</p>
"""
    write_page(path, page("friction-hil: a network for friction", MARK, body))


_ERRORS_CAPTION = "Error of each sample in free run, over the velocity and over its rate of change."
_COMPARED = (
    "<p>Each model of the library is fitted to the samples on which the network was trained, and runs free along "
    "signals that neither was fitted to. If a model is as good, prefer it: its parameters have a physical meaning.</p>"
)
_CURVE_CAPTION = (
    "Steady torque of the network at constant velocity (line), and the friction on which it was trained (points). In "
    "the shaded range, beyond the speeds of the training, its torque is held; that of a residual fades out."
)
_COURSE_CAPTION = (
    "Error on the training set and, in free run, on the validation set, after each iteration of Levenberg-Marquardt; "
    "each start has its own colour."
)


def _result(candidate: TrainedModel) -> str:
    errors = candidate.trained.validation
    return (
        f"NRMSE in free run, as the network is used, on data that it was not trained on: <strong>{errors.free_run:.4f}"
        f"</strong>; one step ahead, with the measured torque as input: {errors.one_step:.4f}."
    )


def _errors(candidate: TrainedModel) -> str:
    rows = [
        (name, f"{errors.one_step:.4f}", f"{errors.free_run:.4f}")
        for name, errors in (("training", candidate.trained.train), ("validation", candidate.trained.validation))
    ]
    rows += [(html.escape(name), "", f"{candidate.error(each):.4f}") for name, each in candidate.task.unseen.items()]
    text = table(("NRMSE", "one step", "free run"), rows)
    if candidate.relative_errors:
        gains = candidate.gains
        held_out = [
            (html.escape(name), f"{100.0 * value:.3f} %", str(gains.get(name, "")))
            for name, value in candidate.relative_errors.items()
        ]
        text += table(
            ("held out", "relative error of the whole torque", "mean square error of the network lower by"), held_out
        )
    return text


def _compared(candidate: TrainedModel) -> str:
    """Compare the network with the models of the library, on signals that none of them has seen."""
    errors = candidate.physical_errors()
    if not errors:
        return ""
    labels = list(next(iter(errors.values())))
    rows = [(html.escape(label), *(f"{each[label]:.4f}" for each in errors.values())) for label in labels]
    return f"<h2>Against models fitted to the same samples</h2>{_COMPARED}" + table(
        ("NRMSE in free run", *map(html.escape, errors)), rows
    )


def _draw_signal(samples: Samples, torque: Array, unit: str, speed: str) -> "Figure":
    figure = new_figure(11.0, 5.5)
    above, middle, below = figure.subplots(3, 1, sharex=True, height_ratios=[1, 2, 1])
    counts = np.flatnonzero(samples.weight > 0.0)
    shown = slice(int(counts[0]), int(min(counts[0] + _MOST_POINTS, counts[-1] + 1)))
    time = samples.dt * np.arange(len(samples))[shown]
    above.plot(time, samples.velocity[shown], color=INK, linewidth=0.8)
    middle.plot(time, samples.torque[shown], color=_TRUE, linewidth=1.8, label="friction")
    middle.plot(time, torque[shown], color=_LEARNED, linewidth=0.8, label="network")
    below.plot(time, (samples.torque - torque)[shown], color=_ERROR, linewidth=0.8)
    above.set(ylabel=f"velocity\n[{speed}]")
    middle.set(ylabel=f"torque [{unit}]")
    below.set(ylabel=f"error [{unit}]", xlabel="time [s]")
    middle.legend(loc="upper right", ncols=2)
    middle.margins(y=_ROOM)
    return figure


def _draw_errors(runs: list[tuple[Samples, Array]], unit: str, speed: str) -> "Figure":
    figure = new_figure(11.0, 4.0)
    left, right = figure.subplots(1, 2, sharey=True)
    for samples, torque in runs:
        counts = samples.weight > 0.0
        error = (samples.torque - torque)[counts]
        rate = np.gradient(samples.velocity, samples.dt)[counts]
        for axes, values in ((left, samples.velocity[counts]), (right, rate)):
            axes.plot(values, error, ".", color=_ERROR, markersize=1.5, rasterized=True)
    left.set(xlabel=f"velocity [{speed}]", ylabel=f"error [{unit}]")
    right.set(xlabel=f"rate of the velocity [{speed}²]")
    right.set_xscale("symlog", linthresh=1.0)
    return figure


def _draw_curve(candidate: TrainedModel, unit: str, speed: str) -> "Figure":
    figure = new_figure(8.0, 4.5)
    curve(figure.subplots(), candidate, unit, speed)
    return figure


def curve(axes: "Axes", candidate: TrainedModel, unit: str, speed: str) -> None:
    """Draw the friction on which a network was trained, and its own at constant velocity."""
    limit, samples = candidate.network.speed_limit, candidate.task.samples
    every = slice(None, None, 1 + len(samples) // _MOST_POINTS)
    axes.plot(samples.velocity[every], samples.torque[every], ".", color=_TRUE, markersize=1.5, rasterized=True)
    speeds = np.concatenate([np.linspace(-1.4 * limit, 0.0, 200), np.linspace(0.0, 1.4 * limit, 200)[1:]])
    alone = candidate.model.steady_state(speeds, load_torque=0.0)
    if candidate.task.base is not None:
        alone = alone - candidate.task.base.steady_state(speeds, load_torque=0.0)
    axes.plot(speeds, alone, color=_LEARNED)
    for side in (-1.0, 1.0):
        axes.axvspan(side * limit, 1.4 * side * limit, color="#eeeeee", zorder=0)
    axes.set(xlabel=f"velocity [{speed}]", ylabel=f"torque [{unit}]")


def _draw_course(candidate: TrainedModel) -> "Figure":
    figure = new_figure(11.0, 4.0)
    left, right = figure.subplots(1, 2)
    history = candidate.trained.history
    for start in sorted({step.start for step in history}):
        own = [step for step in history if step.start == start]
        iterations, color = [step.iteration for step in own], SERIES[start % len(SERIES)]
        left.plot(iterations, [step.error for step in own], color=color, linewidth=0.8, linestyle=":")
        left.plot(iterations, [step.validation_error for step in own], color=color, linewidth=1.2)
        right.plot(iterations, [step.damping for step in own], color=color, linewidth=1.0)
    left.set(xlabel="iteration", ylabel="NRMSE (dotted: training)", yscale="log")
    right.set(xlabel="iteration", ylabel="damping", yscale="log")
    return figure
