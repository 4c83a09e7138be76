"""The picture of one axis of a run: signals over time, and beside them the comparison and friction over velocity."""

import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from friction_hil.numerics.jit import Array
from friction_hil.reports.decimation import bucket_size, decimated, decimated_time
from friction_hil.reports.figures import FAULT, GREY, INK, MEASURED, WITH, WITHOUT, new_figure_for, save
from friction_hil.reports.run.panels import Panel
from friction_hil.reports.run.view import RunView, broken_at_gaps

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_MOST_POINTS = 4000  # of a line: twice what a picture of this width can resolve
_LISTED = 6  # events below the picture
_LINE = 190  # characters of a line below the picture
_HEADER = ("following error", "without", "with", "times lower")
_STATES = ("state", "drive_state")  # drawn, but not listed


def draw_run(view: RunView, path: Path) -> None:
    """Draw a run into a file; the suffix gives the format.

    Raises `UsageError`: matplotlib is not installed, or does not know the suffix; `FrictionHilError`: the file cannot
    be written.
    """
    beside = [_draw_comparison] * any(view.phases) + [_draw_friction] * (view.friction is not None)
    rows = max(len(view.panels), 1)
    figure = new_figure_for(path, 15.0 if beside and view.panels else 10.0, max(1.0 + 2.1 * rows, 6.0))
    columns = [each for each in (view.panels, beside) if each]
    grid = figure.add_gridspec(1, len(columns), width_ratios=[3, 2][: len(columns)])
    if view.panels:
        cells = grid[0].subgridspec(rows, 1)
        first = figure.add_subplot(cells[0])
        panels = [first, *(figure.add_subplot(cells[k], sharex=first) for k in range(1, rows))]
        time, values = broken_at_gaps(view)
        for k, axes in enumerate(panels):
            _draw_panel(axes, view, view.panels[k], time, values[k])
            _draw_marks(axes, view, "missed periods" if k == rows - 1 else None)
            axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.0, ncols=6)
            axes.tick_params(labelbottom=k == rows - 1)
        panels[-1].set_xlabel("time [s]")
        _name_events(first, view)
    if beside:
        cells = grid[-1].subgridspec(len(beside), 1)
        for k, draw in enumerate(beside):
            draw(figure.add_subplot(cells[k]), view)
    figure.suptitle(f"{view.title}: {view.facts}")
    if lines := _listed(view):
        figure.supxlabel("\n".join(lines), x=0.01, ha="left", fontsize=8.5, color=INK, parse_math=False)
    save(figure, path)


def comparison_text(view: RunView) -> str:
    """Return the figures of the following error as a table of text; its lines are equally long."""
    table = [_HEADER, *view.rows]
    widths = [max(len(row[k]) for row in table) for k in range(len(_HEADER))]
    return "\n".join(
        "  ".join(
            cell.ljust(width) if k == 0 else cell.rjust(width)
            for k, (cell, width) in enumerate(zip(row, widths, strict=True))
        )
        for row in table
    )


def _draw_panel(axes: "Axes", view: RunView, panel: Panel, time: Array, lines: Sequence[Array]) -> None:
    size = bucket_size(len(time), _MOST_POINTS)
    shown = decimated_time(time, size)
    for line, values in zip(panel.lines, lines, strict=True):
        style = "--" if line.is_dashed else "-"
        axes.plot(
            shown, decimated(values, size), style, color=line.color, linewidth=line.width, label=line.name, zorder=2
        )
    if panel.name == "error":
        for phase, color in zip(view.phases, (WITHOUT, WITH), strict=True):
            for interval in phase.intervals_s if phase else ():
                axes.axvspan(*interval, color=color, alpha=0.09, linewidth=0.0, zorder=0)
    axes.set_ylabel(panel.label)
    if view.time_s[-1] > view.time_s[0]:
        axes.set_xlim(view.time_s[0], view.time_s[-1])


def _draw_marks(axes: "Axes", view: RunView, label: str | None) -> None:
    """Draw missed periods, with a label in the legend if there is to be one, and events."""
    if view.missed_s.size:
        base = axes.get_xaxis_transform()
        axes.plot(view.missed_s, 0.0 * view.missed_s, "|", color=FAULT, markersize=14.0, transform=base, label=label)
    for mark in view.marks:
        color, style = (FAULT, "-") if mark.is_fault else (GREY, ":" if mark.kind in _STATES else "--")
        axes.axvline(mark.time_s, color=color, linestyle=style, linewidth=1.0, zorder=1)


def _name_events(axes: "Axes", view: RunView) -> None:
    """Write the number of each event of the list, and the names of states with enough room, above the panels."""
    top = axes.get_xaxis_transform()
    span = view.time_s[-1] - view.time_s[0]
    states = [mark for mark in view.marks if mark.kind == _STATES[0]]
    ends = [*(mark.time_s for mark in states), view.time_s[-1]][1:]
    for mark, end in zip(states, ends, strict=True):
        if end - mark.time_s > 0.012 * len(mark.text) * span:
            axes.text(
                mark.time_s, 1.02, f" {mark.text}", transform=top, fontsize=8.0, color="#666666", parse_math=False
            )
    for number, mark in enumerate(_events(view)[:_LISTED], start=1):
        color = FAULT if mark.is_fault else INK
        axes.text(mark.time_s, 1.16, str(number), transform=top, fontsize=9.0, color=color, ha="center")


def _events(view: RunView) -> list[Any]:
    """Return the events to list: faults first, then the others but states, each in order of time."""
    others = [mark for mark in view.marks if mark.kind not in _STATES]
    return sorted(others, key=lambda mark: not mark.is_fault)


def _listed(view: RunView) -> list[str]:
    events = _events(view)
    lines: list[str] = []
    for number, mark in enumerate(events[:_LISTED], start=1):
        text = f"{number}   {mark.time_s:.3f} s   {mark.kind}: {mark.text}"
        lines += textwrap.wrap(text, _LINE, subsequent_indent="      ", max_lines=2, placeholder=" ...")
    if len(events) > _LISTED:
        lines.append(f"and {len(events) - _LISTED} more events: friction-hil convert {view.title.split(',')[0]} --info")
    return lines


def _draw_comparison(axes: "Axes", view: RunView) -> None:
    factor, unit = view.error_unit
    for phase, color, label in zip(view.phases, (WITHOUT, WITH), ("without", "with compensation"), strict=True):
        if phase is not None:
            size = bucket_size(len(phase.time_s), _MOST_POINTS)
            time, error = decimated_time(phase.time_s, size), decimated(phase.error * factor, size)
            axes.plot(time, error, color=color, linewidth=1.2, label=label)
    axes.set(xlabel=view.comparison_label, ylabel=f"following error [{unit}]")
    axes.set_title(comparison_text(view), loc="left", family="monospace")
    axes.legend(loc="best")


def _draw_friction(axes: "Axes", view: RunView) -> None:
    found = view.friction
    assert found is not None
    points: dict[str, Any] = {"linestyle": "", "marker": ".", "markersize": 2.0, "rasterized": True}
    if found.measured is not None:
        label = "measured, less mechanics" if found.is_friction else "measured torque"
        axes.plot(*found.measured, color=MEASURED, label=label, **points)
    if found.compensation is not None:
        axes.plot(*found.compensation, color=WITH, label="compensation as applied", **points)
    if found.curve is not None:
        axes.plot(*found.curve, color=INK, linewidth=1.6, label="model at constant velocity")
    what = "friction" if found.is_friction or found.measured is None else "torque"
    axes.set(xlabel=f"velocity [{view.speed_unit}]", ylabel=f"{what} [{view.units[1]}]", title="Friction over velocity")
    axes.legend(loc="upper left", markerscale=4.0, handlelength=1.0)
    axes.margins(y=0.15)
