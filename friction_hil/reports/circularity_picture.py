"""Pictures of the circularity test: the circle with its radius error magnified, following error, friction torque."""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from friction_hil.analysis.circularity import RING_SHARE, Circularity, RingScale, ring_scale
from friction_hil.daemon.safety import LoopState
from friction_hil.friction.steady_curve import steady_curve
from friction_hil.recordings.columns import CHANGE
from friction_hil.reports.figures import INK, LEARNED, WITH, WITHOUT, new_figure
from friction_hil.reports.numbers import digits, figure_rows, readable, unit_of_figures

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_FAINT = "#c8c8c8"
_TOP, _LINE = 0.24, 0.105  # of the table in the middle of the circle
_COLORS = (WITHOUT, WITH, LEARNED)  # of the laps
_WIDTHS = (1.3, 1.8, 1.8)


def draw_circle(circularity: Circularity) -> "Figure":
    """Draw the circles with their radius errors magnified about the nominal one.

    After learning there is a second picture beside it, of the laps with compensation alone, magnified more.
    """
    shown = circularity.laps
    count = 1 if circularity.learned is None else 2
    figure = new_figure(8.0 * count, 8.0, layout=None)
    axes = [figure.add_axes((k / count, 0.0, 1.0 / count, 0.92)) for k in range(count)]
    scale = _draw_laps(axes[0], circularity, range(2))
    _write_figures(axes[0], circularity)
    motion = circularity.configuration.axes[circularity.axes[0]].trajectory
    shape = f"radius {circularity.radius:g} {circularity.unit}, {getattr(motion, 'frequency', 0.0):g} Hz"
    title = f"Radius error of a circle, magnified {scale.magnification:g} times"
    _write_title(figure, 0.5 / count, title, f"{shape}; {_rings(circularity, scale)}")
    if count > 1:
        scale = _draw_laps(axes[1], circularity, range(1, len(shown)))
        _write_reduction(axes[1], circularity)
        title = f"With compensation, magnified {scale.magnification:g} times"
        _write_title(figure, 0.75, title, _rings(circularity, scale))
    return figure


def _write_title(figure: "Figure", x: float, title: str, below: str) -> None:
    figure.text(x, 0.955, title, ha="center", fontsize=17, color=INK, fontweight="bold")
    figure.text(x, 0.925, below, ha="center", fontsize=13, color=INK)


def _rings(circularity: Circularity, scale: RingScale) -> str:
    factor, unit = readable(circularity.unit, scale.ring)
    return f"from ring to ring {scale.ring * factor:g} {unit}"


def _draw_laps(axes: "Axes", circularity: Circularity, shown: range) -> RingScale:
    """Draw some of the laps, by their numbers, about the rings of a scale that fits them; return the scale."""
    laps = [circularity.laps[k] for k in shown]
    lowest = min(float(each.radius_error.min()) for each in laps)
    highest = max(float(each.radius_error.max()) for each in laps)
    scale = ring_scale(circularity.radius, lowest, highest)
    ring, magnification, inner, outer = scale.ring, scale.magnification, scale.inner, scale.outer
    factor, unit = readable(circularity.unit, ring)
    axes.set_aspect("equal")
    axes.axis("off")
    for k in range(-inner, outer + 1):
        _ring(axes, 1.0 + k * RING_SHARE, "" if k == 0 else f"{k * ring * factor:+g} {unit}".replace("-", "−"))
    reach = 1.0 + outer * RING_SHARE
    for x, y in ((1, 0), (0, 1), (-1, 0), (0, -1)):
        start = 1.0 - inner * RING_SHARE
        axes.plot([x * start, x * reach], [y * start, y * reach], color=_FAINT, linewidth=0.8, zorder=1)
    for k, each in zip(shown, laps, strict=True):
        drawn = 1.0 + each.radius_error * magnification / circularity.radius
        x, y = _broken(each.angle, drawn * np.cos(each.angle), drawn * np.sin(each.angle))
        axes.plot(x, y, color=_COLORS[k], linewidth=_WIDTHS[k], solid_joinstyle="round", zorder=3)
    _label_quadrants(axes, circularity.axes, reach + 0.06)
    limit = reach + 0.17
    axes.set(xlim=(-limit, limit), ylim=(-limit, limit))
    return scale


def draw_error(circularity: Circularity) -> "Figure":
    """Draw the following error of both axes over the whole motion."""
    factor, unit = unit_of_figures(circularity)
    figure = new_figure(10.0, 5.2)
    panels = figure.subplots(2, 1, sharex=True, sharey=True)
    for axes, axis in zip(panels, circularity.axes, strict=True):
        columns = circularity.columns[axis]
        error = columns["error"] * factor
        is_on, is_usable = columns["is_enabled"] == 1.0, columns["is_usable"] == 1.0
        is_changed = columns[CHANGE] > 0.0
        parts = (~is_on, is_on & ~is_changed, is_on & is_changed)
        axes.plot(columns["time_s"], np.where(is_usable, np.nan, error), color=_FAINT, linewidth=1.0)
        for rows, color in zip(parts, _COLORS, strict=True):
            axes.plot(columns["time_s"], np.where(is_usable & rows, error, np.nan), color=color, linewidth=1.0)
        _mark_changes(axes, circularity)
        named = zip(circularity.laps, _COLORS, ("without", "model as given", "after learning"), strict=False)
        for laps, color, name in named:
            axes.axvspan(*laps.interval_s, color=color, alpha=0.09, linewidth=0.0)
            figures = laps.figures[axis]
            rms, peak = digits(figures.rms * factor), digits(figures.peak * factor)
            axes.annotate(
                f"{name}\n{rms} {unit} rms\n{peak} {unit} peak",
                (sum(laps.interval_s) / 2.0, 0.97),
                xycoords=("data", "axes fraction"),
                ha="center",
                va="top",
                fontsize=10,
                color=color,
            )
        axes.set_ylabel(f"{axis} [{unit}]")
        axes.margins(x=0.01, y=0.55)
    panels[-1].set_xlabel("time [s]")
    figure.suptitle("Following error: demanded minus measured position")
    return figure


def draw_lap_errors(circularity: Circularity) -> "Figure":
    """Draw the RMS following error of each lap of the run, and when learning changed the settings."""
    from matplotlib.ticker import LogLocator  # imported here: matplotlib is optional, and takes 0.3 s

    factor, unit = unit_of_figures(circularity)
    motion = circularity.configuration.axes[circularity.axes[0]].trajectory
    lap_s = 1.0 / getattr(motion, "frequency", 1.0)
    figure = new_figure(10.0, 3.6)
    axes = figure.subplots()
    for axis, style in zip(circularity.axes, ("-", "--"), strict=True):
        columns = circularity.columns[axis]
        rows = (columns["is_usable"] == 1.0) & (columns["state"] == LoopState.RUNNING)
        time_s, square = columns["time_s"][rows], (factor * columns["error"][rows]) ** 2
        lap = ((time_s - time_s[0]) / lap_s + 1e-6).astype(np.intp)
        rows_of_lap = np.bincount(lap)
        is_whole = rows_of_lap * circularity.configuration.period_s > 0.5 * lap_s  # not the rest at the end
        rms = np.sqrt(np.bincount(lap, square) / np.where(is_whole, rows_of_lap, np.nan))
        edges = time_s[0] + lap_s * np.arange(len(rms) + 1)
        axes.stairs(rms, edges, baseline=None, color=INK, linewidth=1.4, linestyle=style, label=axis)
    _mark_changes(axes, circularity)
    for laps, color in zip(circularity.laps, _COLORS, strict=False):
        axes.axvspan(*laps.interval_s, color=color, alpha=0.15, linewidth=0.0)
    axes.set(yscale="log", xlabel="time [s]", ylabel=f"following error, RMS of a lap [{unit}]")
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.yaxis.set_major_formatter("{x:g}")
    axes.yaxis.set_minor_formatter("")
    axes.legend(loc="upper center", ncols=2)
    figure.suptitle("What learning changes, lap by lap")
    return figure


def _mark_changes(axes: "Axes", circularity: Circularity) -> None:
    """Draw a dotted line where the settings changed."""
    columns = circularity.columns[circularity.axes[0]]
    for time_s in columns["time_s"][np.flatnonzero(np.diff(columns[CHANGE], prepend=0.0))]:
        axes.axvline(time_s, color=LEARNED, linestyle=":", linewidth=0.8)


def draw_friction(circularity: Circularity) -> "Figure":
    """Draw true friction, the compensator's model and the applied compensation over velocity."""
    configuration = circularity.configuration
    angle = circularity.unit
    torque = "N m" if angle == "rad" else "N"
    figure = new_figure(10.0, 4.6)
    panels = figure.subplots(1, 2)
    start, stop = circularity.compensated.interval_s
    for axes, axis in zip(panels, circularity.axes, strict=True):
        columns, config = circularity.columns[axis], configuration.axes[axis]
        rows = (columns["time_s"] >= start) & (columns["time_s"] < stop)
        applied = columns["compensation"][rows]
        fastest = float(np.nanmax(np.abs(columns["velocity_estimate"][rows])))
        plant: Any = config.simulation
        curves = [
            (plant.friction_model, "true friction of the simulated axis", "-", INK),
            (config.model.friction_model, "model of the compensator", "--", "#777777"),
        ]
        if axis in circularity.learned_axes:
            curves.append((circularity.learned_axes[axis].model.friction_model, "learned model", "--", LEARNED))
        for model, label, style, color in curves:
            axes.plot(*steady_curve(model, fastest), style, color=color, linewidth=1.6, label=label)
        axes.plot(
            columns["velocity_estimate"][rows],
            applied,
            color=WITH,
            linewidth=1.0,
            label=f"compensation as applied, gain {config.compensation.gain:g}",
        )
        axes.set(xlabel=f"velocity of {axis} [{angle}/s]", ylabel=f"torque [{torque}]")
        axes.axhline(0.0, color=_FAINT, linewidth=0.8, zorder=0)
        axes.axvline(0.0, color=_FAINT, linewidth=0.8, zorder=0)
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
    figure.suptitle("Friction over velocity, steady state")
    return figure


def _ring(axes: "Axes", radius: float, text: str) -> None:
    """Draw a ring of the scale with its label; the nominal circle has none."""
    from matplotlib.patches import Circle  # imported here: matplotlib is optional, and takes 0.3 s

    color, width = (_FAINT, 0.8) if text else (INK, 1.0)
    axes.add_patch(Circle((0.0, 0.0), radius, fill=False, color=color, linewidth=width, zorder=1))
    at = radius * math.sqrt(0.5)
    box = {"facecolor": "white", "edgecolor": "none", "pad": 1.0}
    if text:
        axes.text(at, at, text, fontsize=11, color="#666666", ha="center", va="center", rotation=-45.0, bbox=box)


def _label_quadrants(axes: "Axes", names: tuple[str, str], at: float) -> None:
    for x, y, name, turn in (
        (at, 0, names[0], -90),
        (-at, 0, names[0], 90),
        (0, at, names[1], 0),
        (0, -at, names[1], 0),
    ):
        axes.text(x, y, f"{name} reverses", rotation=turn, ha="center", va="center", fontsize=12, color=INK)


def _write_figures(axes: "Axes", circularity: Circularity) -> None:
    """Write legend and figures into the middle of the circle: all errors, and without learning how much lower."""
    _, unit = unit_of_figures(circularity)
    found = list(figure_rows(circularity))
    if circularity.learned is None:
        heads = ("without", "with", "times"), ("", "", "lower")
        rows = [(f"{axis} {name}", *errors, *ratios) for axis, name, errors, ratios in found]
        places, colors = (-0.37, 0.06, 0.37, 0.70), (INK, WITHOUT, WITH, INK)
    else:
        heads = ("without", "given", "learned"), ("", "model", "model")
        rows = [(f"{axis} {name}", *errors) for axis, name, errors, _ in found]
        places, colors = (-0.44, 0.0, 0.33, 0.76), (INK, *_COLORS)
    _write_table(axes, f"following error in {unit}", [("", *each) for each in heads], rows, places, colors)
    if circularity.learned is None:
        axes.text(0.015, _TOP - _LINE, "compensation", ha="center", va="center", fontsize=14, color=INK)


def _write_reduction(axes: "Axes", circularity: Circularity) -> None:
    """Write into the middle how many times lower each error is than without compensation."""
    rows = [(f"{axis} {name}", *ratios) for axis, name, _, ratios in figure_rows(circularity)]
    heads = [("", "given", "learned"), ("", "model", "model")]
    _write_table(axes, "times lower than without", heads, rows, (-0.22, 0.12, 0.52), (INK, WITH, LEARNED))


def _write_table(
    axes: "Axes",
    title: str,
    heads: Sequence[Sequence[str]],
    rows: Sequence[Sequence[str]],
    places: Sequence[float],
    colors: Sequence[str],
) -> None:
    """Write a table into the middle of a circle; ``places`` are the right edges of its columns."""
    axes.text(0.0, _TOP + 1.5 * _LINE, title, ha="center", va="center", fontsize=14, color=INK)
    for k, row in enumerate((*heads, *rows)):
        for text, x, color in zip(row, places, colors, strict=True):
            weight = "normal" if color == INK else "bold"
            axes.text(x, _TOP - k * _LINE, text, ha="right", va="center", fontsize=14, color=color, fontweight=weight)


def _broken(angle: Any, *lines: Any) -> tuple[Any, ...]:
    """Insert NaN where rows are left out, so that no line is drawn across the gap."""
    steps = np.abs(np.diff(np.unwrap(angle)))
    gaps = np.flatnonzero(steps > 5.0 * np.median(steps)) + 1
    return tuple(np.insert(line, gaps, np.nan) for line in lines)
