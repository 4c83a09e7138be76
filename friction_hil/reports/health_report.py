"""The report of friction health: each quantity over time, and friction over the travel."""

import html
import math
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from friction_hil import __version__
from friction_hil.health import Health, Verdict
from friction_hil.health.observation import COULOMB, DIRECTIONS, RIPPLE, ZONE, family
from friction_hil.numerics.readable import brief
from friction_hil.reports.figures import BLUE, FAULT, GREY, ORANGE, new_figure
from friction_hil.reports.page import page, picture, table, unordered_list, write_page

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MARK = f'<meta name="generator" content="friction-hil health {__version__}">'
_LAST = 10  # observations, that are compared with the baseline in the picture over the travel


def write_report(path: Path, found: Sequence[Health], false_alarms: float) -> None:
    """Write the report; an existing file is overwritten. Raises `FrictionHilError`: the file cannot be written."""
    parts = [f"<h1>Friction health</h1><p>Expected false alarms: at most {false_alarms:g} per year and axis.</p>"]
    for health in found:
        parts.append(f"<h2>Axis {html.escape(health.axis)}: {health.count} observations</h2>")
        parts.append(_summary(health))
        parts.append(unordered_list(health.notes))
        shown = [each for each in health.verdicts if each.values.size and family(each.name) not in (ZONE, RIPPLE)]
        over_travel = [each for each in health.verdicts if each.values.size and family(each.name) == ZONE]
        ripple = [each for each in health.verdicts if each.values.size and family(each.name) == RIPPLE]
        if shown:
            parts.append(picture(_draw_series(shown), _CAPTION, "wide"))
        if over_travel:
            parts.append(picture(_draw_travel(over_travel, health), _TRAVEL_CAPTION))
        if ripple:
            parts.append(picture(_draw_series(ripple), _CAPTION, "wide"))
    parts.append(f'<p class="note">friction-hil {__version__}</p>')
    write_page(path, page("friction-hil: friction health", MARK, "\n".join(parts)))


_CAPTION = (
    "Each point is an observation with its standard error, at the temperature of the baseline. The line is the "
    "baseline; red points belong to a change, from where it is first seen."
)
_TRAVEL_CAPTION = (
    f"Friction over the travel, less viscous friction: grey the baseline, coloured the mean of the last {_LAST} "
    "observations."
)


def _summary(health: Health) -> str:
    rows = []
    for each in health.verdicts:
        base = "" if each.baseline is None else f"{brief(each.baseline, 4)} ± {brief(each.baseline_error or 0.0, 2)}"
        slope = "" if each.slope is None else f"{brief(each.slope, 2)} ± {brief(each.slope_error or 0.0, 2)}"
        change = ""
        if each.state == "changed":
            share = "" if each.share is None else f" ({100.0 * each.share:+.0f} %)"
            change = (
                f"{brief(each.change, 3)} ± {brief(each.change_error, 2)}{share} since {_date(each.since_s or 0.0)}"
            )
        state = f"{each.state}: {each.reason}" if each.reason else each.state
        rows.append((html.escape(each.label), base, slope, html.escape(each.unit), change, html.escape(state)))
    return table(("quantity", "baseline", "per K", "unit", "change", "state"), rows, ("", "", "", "", "text"))


def _date(time_s: float) -> str:
    return f"{datetime.fromtimestamp(time_s):%Y-%m-%d}"


def _draw_series(verdicts: Sequence[Verdict]) -> "Figure":
    rows = (len(verdicts) + 1) // 2
    figure = new_figure(11.0, 0.6 + 2.1 * rows)
    panels = figure.subplots(rows, 2, squeeze=False, sharex=True).ravel()
    for axes, each in zip(panels, verdicts, strict=False):
        times = np.array([datetime.fromtimestamp(t, UTC) for t in each.times_s])
        is_changed = each.times_s >= (np.inf if each.since_s is None else each.since_s)
        for rows_of, colour in ((~is_changed, BLUE), (is_changed, FAULT)):
            if rows_of.any():
                style = {"color": colour, "markersize": 3.0, "linewidth": 0.6, "linestyle": "none"}
                axes.errorbar(times[rows_of], each.values[rows_of], each.errors[rows_of], fmt="o", **style)
        if each.baseline is not None:
            axes.axhline(each.baseline, color=GREY, linewidth=1.2)
        axes.set_title(each.label, loc="left")
        axes.set_ylabel(each.unit)
        axes.tick_params(axis="x", rotation=30)
    for axes in panels[len(verdicts) :]:
        axes.set_axis_off()
    return figure


def _draw_travel(verdicts: Sequence[Verdict], health: Health) -> "Figure":
    figure = new_figure(8.0, 4.0)
    axes = figure.subplots()
    edges = np.array(health.layout.edges)
    centres = 0.5 * (edges[1:] + edges[:-1])
    for direction, colour in zip(DIRECTIONS, (BLUE, ORANGE), strict=True):
        own = [each for each in verdicts if each.name.endswith(direction)]
        level = next((each for each in health.verdicts if each.name == f"{COULOMB}.{direction}"), None)
        if level is None or not own:
            continue
        places = centres[[int(each.name.split(".")[1]) for each in own]]
        if level.baseline is not None:
            known = [math.nan if each.baseline is None else level.baseline + each.baseline for each in own]
            axes.plot(places, known, "o--", color=GREY, linewidth=1.0)
        last = [float(np.mean(level.values[-_LAST:]) + np.mean(each.values[-_LAST:])) for each in own]
        axes.plot(places, last, "o-", color=colour, label=f"{direction} direction")
    units = ("rad", "N m") if health.layout.kind == "rotary" else ("m", "N")
    axes.set(xlabel=f"position [{units[0]}]", ylabel=f"friction [{units[1]}]")
    axes.legend()
    return figure
