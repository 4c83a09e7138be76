"""The report of an identification: parameters with errors, pictures, candidates, and what to do next."""

import html
import itertools
import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from friction_hil import __version__
from friction_hil.identification import Identification
from friction_hil.identification.export import as_model_file, standard_errors
from friction_hil.identification.fits import MECHANICS, Fit
from friction_hil.identification.frequency_response import FrequencyResponse
from friction_hil.identification.mechanics import Mechanics
from friction_hil.identification.resonance import Resonance, two_mass_response
from friction_hil.identification.thresholds import LAST_BAND_RATIO, RESIDUAL_HZ, ROWS_HZ
from friction_hil.models.model_file import ModelFile
from friction_hil.reports.figures import MEASURED, PREDICTED, new_figure
from friction_hil.reports.identification_pictures import draw_loops, draw_residuals, draw_time, draw_velocity
from friction_hil.reports.page import page, picture, table, unordered_list, write_page

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MARK = f'<meta name="generator" content="friction-hil identify {__version__}">'
_SHOWN = 20  # candidates in the table
_UNITS = {  # of parameters that are not those of a friction model, on a rotary axis
    "inertia": "kg m^2",
    "offset": "N m",
    "gravity.constant": "N m",
    "gravity.sine": "N m",
    "gravity.cosine": "N m",
}
_VELOCITY_CAPTION = (
    "Grey: measured torque minus inertia, offset and gravity. Blue: the model. Right: the slowest quarter of the "
    "recording, which shows presliding and the Stribeck curve."
)
_RESIDUAL_CAPTION = (
    "Grey: measured minus predicted torque; orange: its mean. A mean that depends on the velocity is friction that the "
    "model cannot describe; on the position, cogging or gravity; on time, temperature."
)
_LOOP_CAPTION = (
    "Friction from one reversal to the next but one, over the position from the middle of the travel, from small to "
    "large travel. Grey: measured; blue: the model."
)
_RESPONSE_CAPTION = (
    "Frequency response of the motor where it slides, velocity over torque. Points: lines of the spectrum with enough "
    "coherence; grey: the others. Line: two masses on a spring, if the response shows them."
)
_POINTS = 1000  # of the fitted line
_UNUSED = "0.85"  # grey


def write_report(
    path: Path,  # the HTML file; overwritten
    result: Identification,
    free_run: dict[str, Any],  # `relative_error` of a free simulation, or None and the `reason` why there is none
    findings: Sequence[str] = (),  # what speaks against the model (`friction_hil.identification.plausibility`)
    mechanics: Mechanics | None = None,  # found behind the motor
) -> None:
    """Write the report. Raises `FrictionHilError`: the file cannot be written."""
    best, is_rotary = result.best, result.settings.axis == "rotary"
    unit, speed_unit, position_unit = ("N m", "rad/s", "rad") if is_rotary else ("N", "m/s", "m")
    curves = best.curves
    body = f"""
<h1>Friction of {html.escape(_names(result))}</h1>
<p><strong>{html.escape(best.label)}</strong>: {html.escape(result.reason)}.</p>
<p>{_errors(best)} {_free_run(free_run)}</p>
{_findings(findings)}
<h2>Parameters</h2>
{_parameters(result)}
{_correlations(best)}
{_mechanics(mechanics)}
<h2>What to do next</h2>
{unordered_list(best.flags or ("nothing: every parameter is determined by these data",))}
<h2>Torque over time</h2>
{picture(draw_time(curves, unit), "Measured and predicted torque, and the difference.", "wide")}
<h2>Friction over velocity</h2>
{picture(draw_velocity(curves, unit, speed_unit), _VELOCITY_CAPTION, "wide")}
<h2>Residual</h2>
{picture(draw_residuals(curves, unit, speed_unit, position_unit), _RESIDUAL_CAPTION, "wide")}
<h2>Hysteresis</h2>
{picture(draw_loops(curves, unit, position_unit), _LOOP_CAPTION, "wide")}
<h2>All candidates</h2>
<p class="note">Relative error: norm of measured minus predicted torque, divided by the norm of the measured torque.</p>
{_candidates(result)}
<h2>Data</h2>
{_data(result)}
<p class="note">friction-hil {__version__}</p>
"""
    text = page(f"friction-hil: friction of {_names(result)}", MARK, body)
    write_page(path, text)


def _mechanics(found: Mechanics | None) -> str:
    if found is None:
        return ""
    rows = [
        (
            html.escape(each.label),
            "" if each.value is None else f"{each.value:.4g}",
            "" if each.error is None else f"± {1.96 * each.error:.2g}",
            html.escape(each.unit),
            f"<span class='note'>{html.escape(each.source)}</span>",
        )
        for each in found.quantities
        if each.value is not None or not each.missing
    ]
    for line in found.missing:  # one row for each reason
        labels, _, why = line.partition(": not determined: ")
        rows.append((html.escape(labels), "", "", "", f"<span class='note'>not determined: {html.escape(why)}</span>"))
    shown = table(("", "value", "95 %", "unit", ""), rows, ("", "", "text", "text"))
    remarks = [*found.flags, *found.notes]
    drawn = ""
    if found.response is not None:
        drawn = picture(draw_response(found.response, found.resonance), _RESPONSE_CAPTION, "wide")
    return f"<h2>Mechanics</h2>\n{shown}\n{unordered_list(remarks) if remarks else ''}\n{drawn}"


def _names(result: Identification) -> str:
    paths = list(dict.fromkeys(Path(record.path).name for record in result.records))
    return paths[0] if len(paths) == 1 else f"{paths[0]} and {len(paths) - 1} more"


def _percent(error: Any) -> str:
    return "" if error is None or not math.isfinite(error.relative_error) else f"{100.0 * error.relative_error:.2f} %"


def _errors(best: Fit) -> str:
    parts = [f"Relative error of the torque: {_percent(best.train)} on the fitted data"]
    parts.append(f"{_percent(best.cross_validation)} on held-out blocks")
    if best.across_speeds is not None:
        parts.append(f"{_percent(best.across_speeds)} on strokes of held-out speeds")
    if best.validation is not None:
        parts.append(f"{_percent(best.validation)} on the validation recordings")
    return ", ".join(parts) + "."


def _findings(findings: Sequence[str]) -> str:
    return f"<h2>What speaks against this model</h2>\n{unordered_list(findings)}" if findings else ""


def _free_run(free_run: dict[str, Any]) -> str:
    if free_run["relative_error"] is None:
        return html.escape(f"No closed-loop simulation: {free_run['reason']}.")
    return f"In closed-loop simulation it is {100.0 * free_run['relative_error']:.2f} %."


def _parameters(result: Identification) -> str:
    best = result.best
    known = {parameter.name: parameter for parameter in _family(result).parameters}
    errors = standard_errors(best)
    rows = []
    for name, value in best.values.items():
        parameter = known.get(name.split(".")[-1].partition("[")[0]) if name not in MECHANICS else None
        unit = parameter.unit if parameter else _UNITS.get(name, "")
        if result.settings.axis == "linear":
            unit = unit.replace("kg m^2", "kg").replace("N m", "N").replace("rad", "m")
        error = errors.get(name)
        relative = "" if error is None or value == 0.0 else f"{100.0 * error / abs(value):.1f} %"
        rows.append(
            (
                html.escape(name),
                f"{value:.6g}",
                "" if error is None else f"± {1.96 * error:.2g}",
                relative,
                html.escape(unit),
                f"<span class='note'>{html.escape(parameter.meaning if parameter else '')}</span>",
            )
        )
    for name, value in result.settings.held.items():
        rows.append((html.escape(name), f"{value:.6g}", "held", "", "", ""))
    header = ("", "value", "95 %", "standard error", "unit", "")
    return table(header, rows, ("", "", "", "text", "text"))


def _family(result: Identification) -> Any:
    return ModelFile.model_validate(as_model_file(result)).friction_model.family


def _correlations(best: Fit) -> str:
    pairs = best.inference.pairs()
    if not pairs:
        return '<p class="note">No two parameters are correlated by more than 0.9.</p>'
    words = ", ".join(f"{a} and {b} ({value:+.3f})" for a, b, value in pairs)
    return f'<p class="note">Correlated by more than 0.9: {html.escape(words)}.</p>'


def _candidates(result: Identification) -> str:
    parts = []
    for heading, fits in result.groups:
        parts.append((f"<h3>{html.escape(heading)}</h3>" if heading else "") + _table_of(fits))
    return "".join(parts)


def _table_of(fits: Sequence[Fit]) -> str:
    rows: list[tuple[str, ...]] = [
        (
            html.escape(each.label),
            str(each.count),
            f"{each.train.rmse:.3g}",
            _percent(each.train),
            _percent(each.cross_validation),
            _percent(each.across_speeds),
            _percent(each.validation),
        )
        for each in fits[:_SHOWN]
    ]
    header: tuple[str, ...] = (
        "",
        "parameters",
        "rmse",
        "fitted data",
        "held-out blocks",
        "held-out speeds",
        "validation",
    )
    is_shown = [not rows or any(row[k] for row in rows) for k in range(len(header))]
    is_shown[0] = True
    more = len(fits) - _SHOWN
    note = f'<p class="note">{more} more in the output of <code>--json</code>.</p>' if more > 0 else ""
    shown = [tuple(itertools.compress(row, is_shown)) for row in rows]
    return table(tuple(itertools.compress(header, is_shown)), shown) + note


def _data(result: Identification) -> str:
    rows = []
    for kind, records in (("fitted to", result.records), ("validation", result.validation)):
        for record in records:
            lowpass = "" if record.lowpass_hz is None else f"{record.lowpass_hz:.4g} Hz"
            rows.append(
                (
                    html.escape(Path(record.path).name),
                    kind,
                    str(len(record.time_s)),
                    f"{record.rate_hz:.4g} Hz",
                    lowpass,
                    str(record.decimation),
                )
            )
    problems = list(dict.fromkeys(problem for record in result.records for problem in record.problems))
    header = ("", "used for", "rows", "rate", "low-pass", "every n-th row compared")
    notes = [*problems, *result.notes]
    if result.best.is_refined:
        notes.append(
            f"{result.best.label} was fitted again without this low-pass: velocity up to "
            f"{LAST_BAND_RATIO:g} of the sampling rate, as far as it exceeds the encoder noise; torques are "
            f"compared below {RESIDUAL_HZ:g} Hz, at {ROWS_HZ:g} Hz"
        )
    return table(header, rows, ("text",)) + unordered_list(notes)


def draw_response(response: FrequencyResponse, resonance: Resonance | None) -> "Figure":
    """Draw gain, phase and coherence over the frequency, and the two masses that were fitted, if any."""
    figure = new_figure(11.0, 7.0)
    gain, phase, coherence = figure.subplots(3, 1, sharex=True, height_ratios=[2, 1, 1])
    frequency, used = response.frequency_hz, response.is_used
    degrees = np.degrees(np.angle(response.response))
    panels: tuple[tuple[Any, Any], ...] = (
        (gain, np.abs(response.response)),
        (phase, degrees),
        (coherence, response.coherence),
    )
    for axes, values in panels:
        axes.plot(frequency[~used], values[~used], ".", color=_UNUSED, markersize=3.0)
        axes.plot(frequency[used], values[used], ".", color=MEASURED, markersize=5.0)
    if resonance is not None:
        low, high = response.band_hz
        line = np.geomspace(low, high, _POINTS)
        fitted = two_mass_response(resonance.values, line)
        gain.plot(line, np.abs(fitted), color=PREDICTED)
        phase.plot(line, np.degrees(np.angle(fitted)), color=PREDICTED)
    gain.set(ylabel="velocity / torque", xscale="log", yscale="log")
    phase.set(ylabel="phase [°]")
    coherence.set(ylabel="coherence", xlabel="frequency [Hz]", ylim=(0.0, 1.05))
    return figure
