"""Layouts of the study's pictures: a panel for each model, all models in one panel, and a matrix of numbers."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from friction_hil.numerics.jit import Array
from friction_hil.reports.figures import INK, SERIES, new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FAINT = "#bbbbbb"
_DASHES = ("-", "--", "-.", ":")
_LEFT, _RIGHT, _BOTTOM, _TITLE, _LEGEND = 0.8, 0.1, 0.55, 0.3, 0.35  # inches about the panels
_SAME = 0.01  # of the largest value: curves closer than this are drawn as one


def panels(
    names: Sequence[str],
    draw: Callable[["Axes", str], None],  # a panel, by its name
    labels: tuple[str, str],  # of the x and the y axis, with units
    *,
    height: float = 2.3,  # of a row of panels, inches
    legend: bool = False,  # show the legend of the first panel above all panels
    title: Callable[[str], str] = lambda name: name,  # heading of a panel, by its name
) -> "Figure":
    """Draw a panel for each model, all with the same scales."""
    columns = min(4, len(names))
    rows = math.ceil(len(names) / columns)
    wide, high = 10.0 if columns > 2 else 4.5 * columns, height * rows + (0.7 if legend else 0.4)
    # margins are given: to find them, matplotlib would draw all panels twice more
    figure = new_figure(wide, high, layout=None)
    figure.subplots_adjust(
        left=_LEFT / wide,
        right=1.0 - _RIGHT / wide,
        bottom=_BOTTOM / high,
        top=1.0 - (_TITLE + (_LEGEND if legend else 0.0)) / high,
        wspace=0.08,
        hspace=0.22,
    )
    grid = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    for axes, name in zip(grid.flat, names, strict=False):
        draw(axes, name)
        axes.set_title(title(name))
    for axes in grid.flat[len(names) :]:
        axes.set_axis_off()
    for column in range(columns):
        bottom = (len(names) - 1 - column) // columns
        grid[bottom, column].tick_params(labelbottom=True)
    figure.supxlabel(labels[0], fontsize=10, y=0.02 * height / high)
    figure.supylabel(labels[1], fontsize=10, x=0.01)
    if legend:
        handles = grid[0, 0].get_legend_handles_labels()
        figure.legend(*handles, loc="upper center", ncols=len(handles[0]))
    return figure


def together(
    lines: Mapping[str, tuple[Array, Array]], labels: tuple[str, str], *, log: bool = False, markers: bool = False
) -> "Figure":
    """Draw the lines of all models into one panel; those that coincide share one line."""
    figure = new_figure(10.0, 4.2)
    axes = figure.subplots()
    for k, (names, (x, y)) in enumerate(groups(lines)):
        style: dict[str, Any] = {
            "color": SERIES[k % len(SERIES)],
            "linestyle": _DASHES[k % len(_DASHES)],
            "linewidth": 1.8,
        }
        axes.plot(x, y, label=_wrapped(names), marker="o" if markers else None, markersize=4.0, **style)
    if log:
        axes.set_xscale("log")
    axes.set(xlabel=labels[0], ylabel=labels[1])
    figure.legend(loc="outside right upper")
    return figure


def groups(lines: Mapping[str, tuple[Array, Array]]) -> list[tuple[list[str], tuple[Array, Array]]]:
    """Group the names whose lines coincide."""
    found: list[tuple[list[str], tuple[Array, Array]]] = []
    largest = max(float(np.abs(y).max()) for _, y in lines.values())
    for name, (x, y) in lines.items():
        for names, (_, other) in found:
            if other.shape == y.shape and float(np.abs(other - y).max()) <= _SAME * largest:
                names.append(name)
                break
        else:
            found.append(([name], (x, y)))
    return found


def _wrapped(names: Sequence[str]) -> str:
    rows = [", ".join(names[k : k + 2]) for k in range(0, len(names), 2)]
    return ",\n".join(rows)


def matrix(
    names: Sequence[str],
    value: Callable[[str, str | None], float],
    write: Callable[[float], str],
    *,
    floor: float,
) -> "Figure":
    """Draw a table of numbers: a row for each true friction, a column for each compensating model.

    The colour compares a number with the one without compensation in its row. Numbers below ``floor`` count as equal.
    """
    columns: list[str | None] = [None, *names]
    values = np.array([[value(name, each) for each in columns] for name in names])
    ratio = np.log10(np.maximum(values, floor) / np.maximum(values[:, :1], floor))
    figure = new_figure(min(2.0 + 0.72 * len(columns), 10.0), 1.5 + 0.36 * len(names))
    axes = figure.subplots()
    axes.imshow(-ratio, cmap=_two_colours(), vmin=-1.0, vmax=1.0, aspect="auto")
    for (i, j), number in np.ndenumerate(values):
        weight = "bold" if names[i] == columns[j] else "normal"
        axes.text(j, i, write(number), ha="center", va="center", fontsize=9.5, color=INK, fontweight=weight)
    axes.set_xticks(range(len(columns)), ["none", *names], rotation=35, ha="left", rotation_mode="anchor")
    axes.set_yticks(range(len(names)), names)
    axes.tick_params(top=True, labeltop=True, bottom=False, labelbottom=False, length=0, labelsize=10)
    axes.set_xticks(np.arange(len(columns)) - 0.5, minor=True)
    axes.set_yticks(np.arange(len(names)) - 0.5, minor=True)
    axes.grid(which="minor", color="white", linewidth=1.5)
    axes.tick_params(which="minor", length=0, top=False)
    for spine in axes.spines.values():
        spine.set_visible(False)
    axes.set_ylabel("true friction", fontsize=10)
    axes.set_xlabel("model of the compensator", fontsize=10, labelpad=10)
    axes.xaxis.set_label_position("top")
    return figure


def _two_colours() -> Any:
    from matplotlib.colors import LinearSegmentedColormap  # imported here: matplotlib is optional, and takes 0.3 s

    return LinearSegmentedColormap.from_list("help", ["#e8965a", "#ffffff", "#7db7dd"])
