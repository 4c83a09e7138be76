"""Pictures of the circularity test: the circle with its radius error magnified, following error, friction torque."""

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from friction_hil.analysis.circularity import RING_SHARE, Circularity, Laps, ring_scale
from friction_hil.friction.steady_curve import steady_curve
from friction_hil.reports.figures import INK, WITH, WITHOUT, new_figure
from friction_hil.reports.numbers import digits, readable, unit_of_figures

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_FAINT = "#c8c8c8"


def draw_circle(circularity: Circularity) -> "Figure":
    """Draw both circles with their radius errors magnified about the nominal one."""
    laps = circularity.uncompensated, circularity.compensated
    lowest = min(float(each.radius_error.min()) for each in laps)
    highest = max(float(each.radius_error.max()) for each in laps)
    scale = ring_scale(circularity.radius, lowest, highest)
    ring, magnification, inner, outer = scale.ring, scale.magnification, scale.inner, scale.outer
    factor, unit = readable(circularity.unit, ring)

    figure = new_figure(8.0, 8.0, layout=None)
    axes = figure.add_axes((0.0, 0.0, 1.0, 0.92))
    axes.set_aspect("equal")
    axes.axis("off")
    for k in range(-inner, outer + 1):
        _ring(axes, 1.0 + k * RING_SHARE, "" if k == 0 else f"{k * ring * factor:+g} {unit}".replace("-", "−"))
    reach = 1.0 + outer * RING_SHARE
    for x, y in ((1, 0), (0, 1), (-1, 0), (0, -1)):
        start = 1.0 - inner * RING_SHARE
        axes.plot([x * start, x * reach], [y * start, y * reach], color=_FAINT, linewidth=0.8, zorder=1)
    for each, color, width in zip(laps, (WITHOUT, WITH), (1.3, 1.8), strict=True):
        drawn = 1.0 + each.radius_error * magnification / circularity.radius
        x, y = _broken(each.angle, drawn * np.cos(each.angle), drawn * np.sin(each.angle))
        axes.plot(x, y, color=color, linewidth=width, solid_joinstyle="round", zorder=3)
    _label_quadrants(axes, circularity.axes, reach + 0.06)
    _write_figures(axes, circularity)
    limit = reach + 0.17
    axes.set(xlim=(-limit, limit), ylim=(-limit, limit))
    motion = circularity.configuration.axes[circularity.axes[0]].trajectory
    shape = f"radius {circularity.radius:g} {circularity.unit}, {getattr(motion, 'frequency', 0.0):g} Hz"
    title = f"Radius error of a circle, magnified {magnification:g} times"
    figure.text(0.5, 0.955, title, ha="center", fontsize=17, color=INK, fontweight="bold")
    figure.text(0.5, 0.925, f"{shape}; from ring to ring {ring * factor:g} {unit}", ha="center", fontsize=13, color=INK)
    return figure


def draw_error(circularity: Circularity) -> "Figure":
    """Draw the following error of both axes over the whole motion."""
    factor, unit = unit_of_figures(circularity)
    figure = new_figure(10.0, 5.2)
    panels = figure.subplots(2, 1, sharex=True, sharey=True)
    for axes, axis in zip(panels, circularity.axes, strict=True):
        columns = circularity.columns[axis]
        error = columns["error"] * factor
        is_on, is_usable = columns["is_enabled"] == 1.0, columns["is_usable"] == 1.0
        for rows, color in ((~is_usable, _FAINT), (is_usable & ~is_on, WITHOUT), (is_usable & is_on, WITH)):
            axes.plot(columns["time_s"], np.where(rows, error, np.nan), color=color, linewidth=1.0)
        for laps, color, name in (
            (circularity.uncompensated, WITHOUT, "without compensation"),
            (circularity.compensated, WITH, "with compensation"),
        ):
            axes.axvspan(*laps.interval_s, color=color, alpha=0.09, linewidth=0.0)
            figures = laps.figures[axis]
            rms, peak = digits(figures.rms * factor), digits(figures.peak * factor)
            axes.annotate(
                f"{_laps(laps)} {name}\n{rms} {unit} rms, {peak} {unit} peak",
                (sum(laps.interval_s) / 2.0, 0.97),
                xycoords=("data", "axes fraction"),
                ha="center",
                va="top",
                fontsize=10,
                color=color,
            )
        axes.set_ylabel(f"{axis} [{unit}]")
        axes.margins(x=0.01, y=0.35)
    panels[-1].set_xlabel("time [s]")
    figure.suptitle("Following error: demanded minus measured position")
    return figure


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
        assumed = config.model.friction_model
        curves = [
            (plant.friction_model, "true friction of the simulated axis", "-", INK),
            (assumed, "model of the compensator", "--", "#777777"),
        ]
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
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=3)
    figure.suptitle("Friction over velocity, steady state")
    return figure


def _laps(laps: Laps) -> str:
    return f"{laps.count} lap{'s' if laps.count > 1 else ''}"


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
    """Write legend and figures into the middle of the circle."""
    laps = circularity.uncompensated, circularity.compensated
    factor, unit = unit_of_figures(circularity)
    rows: list[tuple[str, ...]] = [("", "without", "with", "times"), ("", "", "", "lower")]
    for axis in circularity.axes:
        for name in ("rms", "peak"):
            values = [digits(getattr(each.figures[axis], name) * factor) for each in laps]
            rows.append((f"{axis} {name}", *values, digits(circularity.factor(axis, name), 2)))
    top, line = 0.24, 0.105
    axes.text(0.0, top + 1.5 * line, f"following error in {unit}", ha="center", va="center", fontsize=14, color=INK)
    axes.text(0.015, top - line, "compensation", ha="center", va="center", fontsize=14, color=INK)
    for k, row in enumerate(rows):
        for text, x, color in zip(row, (-0.37, 0.06, 0.37, 0.70), (INK, WITHOUT, WITH, INK), strict=True):
            weight = "bold" if color in (WITHOUT, WITH) else "normal"
            axes.text(x, top - k * line, text, ha="right", va="center", fontsize=14, color=color, fontweight=weight)


def _broken(angle: Any, *lines: Any) -> tuple[Any, ...]:
    """Insert NaN where rows are left out, so that no line is drawn across the gap."""
    steps = np.abs(np.diff(np.unwrap(angle)))
    gaps = np.flatnonzero(steps > 5.0 * np.median(steps)) + 1
    return tuple(np.insert(line, gaps, np.nan) for line in lines)
