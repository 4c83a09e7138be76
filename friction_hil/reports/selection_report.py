"""The report of a choice between a physical model alone and with a network beside it."""

import html
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from friction_hil import __version__
from friction_hil.numerics.jit import Array
from friction_hil.reports.figures import BLUE, GREY, new_figure
from friction_hil.reports.page import page, picture, table, unordered_list, write_page
from friction_hil.reports.training_report import MARK
from friction_hil.training import Selection

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_MOST_POINTS = 6000
_LEFT_CAPTION = "Measured torque minus that of the physical model (grey), and the torque of the network, if any (blue)."


def write_report(path: Path, found: Selection, seconds: float) -> None:
    """Write the report; an existing file is overwritten. Raises `FrictionHilError`: the file cannot be written."""
    learned = str(found.network) if found.network is not None else "no network"
    body = f"""
<h1>{html.escape(found.chosen.label)}</h1>
<p>Chosen because {html.escape(found.reason)}. {html.escape(learned)}, after {seconds:.1f} s, seed {found.seed}.</p>
<h2>Errors on held-out data</h2>
<p>Relative error of the torque, of models that were fitted to the other data, and the decrease of the mean square error
against {html.escape(found.physical.label)}, from the differences of each held-out part, with its standard error.</p>
{_errors(found)}
{unordered_list(list(found.notes))}
<h2>What the physical model leaves</h2>
{picture(_draw(found), _LEFT_CAPTION, "wide")}
<p class="note">friction-hil {__version__}</p>
"""
    write_page(path, page("friction-hil: a network for friction", MARK, body))


def _errors(found: Selection) -> str:
    kinds = list(found.physical.errors)
    rows = []
    for each in found.judged:
        gains = {} if each is found.physical else each.gains(found.physical)
        cells = [html.escape(each.label)]
        for kind in kinds:
            cells.append(f"{100.0 * each.errors[kind].relative_error:.3f} %" if kind in each.errors else "")
            cells.append(str(gains[kind]) if kind in gains else "")
        rows.append(tuple(cells))
    return table(("model", *(text for kind in kinds for text in (kind, "lower by"))), rows)


def _draw(found: Selection) -> "Figure":
    samples = found.samples
    is_rotary = found.base.axis == "rotary"
    unit = "N m" if is_rotary else "N"
    figure = new_figure(11.0, 4.0)
    axes = figure.subplots(1, 2, sharey=True)
    names = (f"velocity [{'rad/s' if is_rotary else 'm/s'}]", f"position [{'rad' if is_rotary else 'm'}]")
    for each, values, name in zip(axes, (samples.velocity, samples.position), names, strict=True):
        left_points(each, found, values)
        each.set(xlabel=name)
    axes[0].set(ylabel=f"torque [{unit}]")
    return figure


def left_points(axes: "Axes", found: Selection, over: Array) -> None:
    """Draw what the physical model leaves, and what the network has learned of it, over a quantity (n,)."""
    every, learned = slice(None, None, 1 + len(over) // _MOST_POINTS), found.learned(found.samples)
    points: dict[str, Any] = {"linestyle": "", "marker": ".", "markersize": 1.5, "rasterized": True}
    axes.plot(over[every], found.samples.torque[every], color=GREY, **points)
    if np.any(learned):
        axes.plot(over[every], learned[every], color=BLUE, **points)
