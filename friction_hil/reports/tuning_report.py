"""The report of a tuning: the effect of each model on the machine, with a page on each identification."""

import html
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from friction_hil import __version__
from friction_hil.reports.figures import WITH, WITHOUT, new_figure
from friction_hil.reports.identification_report import write_report
from friction_hil.reports.numbers import comparison_rows, readable
from friction_hil.reports.page import page, picture, table, unordered_list, write_page

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from friction_hil.tuning import AxisTuning, TriedModel, Tuning

NAME = "report.html"
_MARK = f'<meta name="generator" content="friction-hil tune {__version__}">'
_NO_FREE_RUN = {"relative_error": None, "reason": "the model was tested on the machine itself"}


def write_reports(folder: Path, tuning: "Tuning") -> Path:
    """Write ``report.html`` and a page on each identification; return the path of ``report.html``.

    Raises
    ------
    FrictionHilError
        A file cannot be written.
    """
    for name, axis in tuning.axes.items():
        for file, candidate in _identifications(name, axis):
            write_report(folder / file, candidate.identification, _NO_FREE_RUN)
    body = "<h1>Friction identified on the machine</h1>" + "".join(
        _section(name, axis) for name, axis in tuning.axes.items()
    )
    if tuning.warnings:
        body += f"<h2>Warnings of the daemon</h2>{unordered_list(tuning.warnings)}"
    path = folder / NAME
    write_page(path, page("friction-hil: tuning", _MARK, body))
    return path


def figures(axis: "AxisTuning", candidate: "TriedModel") -> Iterator[tuple[str, ...]]:
    """Yield RMS and peak of the following error: name with unit, without, with compensation, reduction factor."""
    unit = "rad" if axis.best.identification.settings.axis == "rotary" else "m"
    yield from comparison_rows(unit, candidate.trial.uncompensated, candidate.trial.compensated)


def _identifications(name: str, axis: "AxisTuning") -> Iterator[tuple[str, "TriedModel"]]:
    """Yield the file name of each identification's page, and the first candidate that it produced."""
    first: dict[int, TriedModel] = {}
    for each in axis.candidates:
        first.setdefault(id(each.identification), each)
    for number, each in enumerate(first.values(), start=1):
        yield f"{name}_identification{f'_{number}' if number > 1 else ''}.html", each


def _section(name: str, axis: "AxisTuning") -> str:
    best = axis.best
    verdict = f"kept: {html.escape(str(axis.file))}" if best.trial.has_helped else "not used: no model helped"
    rows = []
    for each in axis.candidates:
        label = f"<strong>{html.escape(each.fit.label)}</strong>" if each is best else html.escape(each.fit.label)
        rows += [("" if k else label, *row) for k, row in enumerate(figures(axis, each))]
    header = ("", "following error", "without", "with compensation", "times lower")
    links = ", ".join(
        f'<a href="{file}">{html.escape(each.fit.label)}</a>' for file, each in _identifications(name, axis)
    )
    return f"""
<h2>{html.escape(name)}: {html.escape(best.fit.label)}</h2>
<p>{verdict}. Identification of the models, with standard errors: {links}.</p>
{table(header, rows, ("text",))}
{picture(_draw(axis), _CAPTION, "wide")}
"""


_CAPTION = "One period of the motion. At a reversal friction changes its sign, which causes a spike of the error."


def _draw(axis: "AxisTuning") -> "Figure":
    best = axis.best.trial
    unit = "rad" if axis.best.identification.settings.axis == "rotary" else "m"
    factor, shown = readable(unit, [best.uncompensated.rms, best.compensated.rms])
    figure = new_figure(10.0, 3.4)
    axes = figure.subplots()
    for error, color, label in zip(
        best.errors, (WITHOUT, WITH), ("without", f"with compensation by {axis.best.fit.label}"), strict=True
    ):
        axes.plot(best.time_s, error * factor, color=color, linewidth=1.2, label=label)
    axes.set(xlabel="time [s]", ylabel=f"following error [{shown}]")
    axes.legend(loc="upper right", ncols=2)
    axes.margins(y=0.2)  # room for the legend
    return figure
