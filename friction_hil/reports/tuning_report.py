"""The report of a tuning: the effect of each model on the machine, with a page on each identification."""

import html
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from friction_hil import __version__
from friction_hil.numerics.readable import POSITION_UNITS, digits
from friction_hil.reports.figures import WITH, WITHOUT, new_figure
from friction_hil.reports.identification_report import write_report
from friction_hil.reports.numbers import comparison_rows, readable
from friction_hil.reports.page import page, picture, table, unordered_list, write_page

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from friction_hil.tuning import AxisTuning, TriedModel, Tuning
    from friction_hil.tuning.rehearsed import RehearsedFit

NAME = "report.html"
_MARK = f'<meta name="generator" content="friction-hil tune {__version__}">'
_COLUMNS = 3  # of panels
_NO_FREE_RUN = {"relative_error": None, "reason": "the model was tested on the machine itself"}


def write_reports(folder: Path, tuning: "Tuning", *, is_simulated: bool = False) -> Path:
    """Write ``report.html`` and a page on each identification; return the path of ``report.html``.

    Its title says where it was a simulation. Raises `FrictionHilError`: a file cannot be written.
    """
    for name, axis in tuning.axes.items():
        for file, candidate in _identifications(name, axis):
            write_report(folder / file, candidate.identification, _NO_FREE_RUN)
    title = f"Friction identified {'in a simulation' if is_simulated else 'on the machine'}"
    body = f"<h1>{title}</h1>{_overview(tuning)}" + "".join(
        _section(name, axis, tuning) for name, axis in tuning.axes.items()
    )
    if tuning.warnings:
        body += f"<h2>Warnings of the daemon</h2>{unordered_list(tuning.warnings)}"
    path = folder / NAME
    write_page(path, page("friction-hil: tuning", _MARK, body))
    return path


def _overview(tuning: "Tuning") -> str:
    """Return a row for each axis: what was kept, and what it is worth on the axis's own motion."""
    rows: list[tuple[str, ...]] = []
    for name, axis in tuning.axes.items():
        own = axis.best.trial.own
        kept = axis.best.label if axis.best.trial.has_helped else "none: no model helped"
        for k, row in enumerate(comparison_rows(_unit(axis), own.uncompensated, own.compensated)):
            rows.append((html.escape("" if k else name), html.escape("" if k else kept), *row))
    header = ("axis", "model kept", "following error, own motion", "without", "with compensation", "times lower")
    return table(header, rows, ("text", "text"))


def _parameters(model: Mapping[str, Any]) -> str:
    """Return the parameters in the model file of the kept model, with standard errors where they are known."""
    errors = model.get("fit", {}).get("standard_errors", {})
    values = {**model["friction"]["parameters"], "inertia": model["mechanics"]["inertia"]}
    rows = [
        (html.escape(name), f"{value:.6g}", f"{errors[name]:.2g}" if name in errors else "")
        for name, value in values.items()
        if isinstance(value, int | float)
    ]
    return table(("parameter", "value", "standard error"), rows)


def _rows(axis: "AxisTuning", candidate: "TriedModel") -> Iterator[tuple[str, ...]]:
    """Yield RMS and peak of each motion: its name, error with unit, without, with compensation, reduction factor."""
    unit = _unit(axis)
    for motion in candidate.trial.motions:
        for k, row in enumerate(comparison_rows(unit, motion.uncompensated, motion.compensated)):
            yield ("" if k else motion.name, *row)


def _unit(axis: "AxisTuning") -> str:
    return POSITION_UNITS[axis.best.identification.settings.axis]


def _identifications(name: str, axis: "AxisTuning") -> Iterator[tuple[str, "TriedModel"]]:
    """Yield the file name of each identification's page, and the first candidate that it produced."""
    first: dict[int, TriedModel] = {}
    for each in axis.candidates:
        first.setdefault(id(each.identification), each)
    for number, each in enumerate(first.values(), start=1):
        yield f"{name}_identification{f'_{number}' if number > 1 else ''}.html", each


def _section(name: str, axis: "AxisTuning", tuning: "Tuning") -> str:
    best, gain = axis.best, axis.recommended
    with_gain = "" if gain.gain is None else f" with compensation: {{gain: {gain.gain:g}}}"
    has_helped = gain.trial.has_helped
    verdict = f"recommended: {html.escape(str(axis.file))}{with_gain}" if has_helped else "not used: no model helped"
    rows: list[tuple[str, ...]] = []
    problems: list[str] = []
    for each in axis.candidates:
        label = f"<strong>{html.escape(each.label)}</strong>" if each is best else html.escape(each.label)
        rows += [("" if k else label, *row) for k, row in enumerate(_rows(axis, each))]
        problems += [f"{each.label}: {problem}" for problem in each.trial.problems]
    header = ("", "motion", "following error", "without", "with compensation", "times lower")
    links = ", ".join(f'<a href="{file}">{html.escape(each.label)}</a>' for file, each in _identifications(name, axis))
    lag = tuning.torque_lags.get(name)
    said = f"<p>{html.escape(_sentence(lag.text))}</p>" if lag is not None else ""
    if experiment := tuning.experiments.get(name):
        said = f"<p>{html.escape(_sentence(experiment.text))}</p>{said}"
    problems += [f"gain {each.gain:g}: {each.text}" for each in axis.gains]
    return f"""
<h2>{html.escape(name)}: {html.escape(best.label)}</h2>
<p>{verdict}. Identification of the models, with standard errors: {links}.</p>
{said}
{unordered_list(problems)}
{table(header, rows, ("text", "text"))}
{_parameters(best.model)}
{picture(_draw(axis), _CAPTION, "wide")}
{_rehearsal(axis, tuning.rehearsed.get(name, ()))}
"""


def _rehearsal(axis: "AxisTuning", rehearsed: "Sequence[RehearsedFit]") -> str:
    """Return what each model did in simulation before the trial, as a table."""
    if not rehearsed:
        return '<p class="note">The models were not rehearsed in simulation.</p>'
    motions = list(rehearsed[0].reductions)
    tried = [candidate.fit for candidate in axis.candidates]
    rows = []
    for each in rehearsed:
        rms = {motion: digits(each.reductions[motion][0], 2) for motion in motions}
        rms[each.worst] = f"<strong>{rms[each.worst]}</strong>"
        if any(each.fit is fit for fit in tried):
            result = "tried on the machine"
        elif each.swings:
            result = f"oscillates, or follows worse: {html.escape(', '.join(each.swings))}"
        else:
            result = ""
        rows.append((html.escape(each.label), digits(each.score, 2), *rms.values(), result))
    header = ("in simulation", "times lower", *map(html.escape, motions), "")
    classes = ("", *("" for _ in motions), "text")
    return f"<p>{_REHEARSAL}</p>{table(header, rows, classes)}"


_REHEARSAL = (
    "Before the trial, each model compensated the identified axis in simulation, with each plausible friction. The "
    "table has the factors by which the following error falls: the geometric mean of RMS and peak over all motions, "
    "and the RMS of each motion, the smallest one in bold."
)


def _sentence(text: str) -> str:
    return f"{text[:1].upper()}{text[1:]}."


_CAPTION = (
    "Each motion of the trial: first the axis's own. At a reversal friction changes its sign, which causes a spike of "
    "the error."
)


def _draw(axis: "AxisTuning") -> "Figure":
    """Draw the following error of each motion without and with the best model, one panel a motion."""
    motions, unit = axis.best.trial.motions, _unit(axis)
    rows = math.ceil(len(motions) / _COLUMNS)
    figure = new_figure(10.0, 0.6 + 2.4 * rows)
    panels = figure.subplots(rows, _COLUMNS, squeeze=False).ravel()
    for panel, motion in zip(panels, motions, strict=False):
        factor, shown = readable(unit, [motion.uncompensated.rms, motion.compensated.rms])
        for error, color, label in zip(
            motion.errors, (WITHOUT, WITH), ("without", f"with compensation by {axis.best.label}"), strict=True
        ):
            panel.plot(motion.time_s, error * factor, color=color, linewidth=1.0, label=label)
        panel.set_title(motion.name, loc="left")
        panel.set(xlabel="time [s]", ylabel=f"following error [{shown}]")
    for panel in panels[len(motions) :]:
        panel.set_axis_off()
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper right", ncols=2)
    return figure
