"""An identification as one HTML file that needs nothing else: what was found, how sure it is, and what to do next."""

import html
import itertools
import math
from pathlib import Path
from typing import Any

from friction_hil import __version__
from friction_hil.errors import FrictionHilError
from friction_hil.identification import Identification
from friction_hil.identification.export import as_model_file, standard_errors
from friction_hil.identification.fine import LAST_BAND_RATIO, RESIDUAL_HZ, ROWS_HZ
from friction_hil.identification.fits import MECHANICS, Fit
from friction_hil.models.model_file import ModelFile
from friction_hil.reports.identification_pictures import draw_loops, draw_residuals, draw_time, draw_velocity
from friction_hil.reports.page import page, picture, table

MARK = f'<meta name="generator" content="friction-hil identify {__version__}">'
_SHOWN = 20  # candidates
_UNITS = {  # of what is no parameter of a friction model, on a rotary axis
    "inertia": "kg m^2",
    "offset": "N m",
    "gravity.constant": "N m",
    "gravity.sine": "N m",
    "gravity.cosine": "N m",
}


def write_report(path: Path, result: Identification, free_run: dict[str, Any]) -> None:
    """Write the report.

    Parameters
    ----------
    path : Path
        The HTML file; overwritten.
    result : Identification
    free_run : dict
        ``relative_error`` of a free simulation, or None and the ``reason`` why there is none.

    Raises
    ------
    FrictionHilError
        The file cannot be written.
    """
    best, is_rotary = result.best, result.settings.axis == "rotary"
    unit, speed_unit, place_unit = ("N m", "rad/s", "rad") if is_rotary else ("N", "m/s", "m")
    curves = best.curves
    body = f"""
<h1>Friction of {html.escape(_names(result))}</h1>
<p><strong>{html.escape(best.label)}</strong>: {html.escape(result.reason)}.</p>
<p>{_errors(best)} {_free_run(free_run)}</p>
<h2>Parameters</h2>
{_parameters(result)}
{_correlations(best)}
<h2>What to do next</h2>
{_list(best.flags or ("nothing: every parameter is determined by these data",))}
<h2>Torque over time</h2>
{picture(draw_time(curves, unit), "Measured and predicted torque, and the difference.", "wide")}
<h2>Friction over velocity</h2>
{picture(draw_velocity(curves, unit, speed_unit), _VELOCITY_CAPTION, "wide")}
<h2>What is left</h2>
{picture(draw_residuals(curves, unit, speed_unit, place_unit), _RESIDUAL_CAPTION, "wide")}
<h2>Hysteresis</h2>
{picture(draw_loops(curves, unit, place_unit), _LOOP_CAPTION, "wide")}
<h2>All candidates</h2>
<p class="note">Relative errors: norm of measured less predicted torque over the norm of the measured one.</p>
{_candidates(result)}
<h2>Data</h2>
{_data(result)}
<p class="note">friction-hil {__version__}</p>
"""
    text = page(f"friction-hil: friction of {_names(result)}", MARK, body)
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise FrictionHilError(f"{path} cannot be written: {error.strerror}") from None


_VELOCITY_CAPTION = (
    "Grey: measured torque less inertia, offset and gravity. Blue: the model. On the right the slowest quarter of "
    "the record, where presliding and the Stribeck curve show."
)
_RESIDUAL_CAPTION = (
    "Grey: measured less predicted torque; orange: its means. A mean that depends on the velocity is friction that the "
    "model has no form for; on the position, cogging or gravity; on time, temperature."
)
_LOOP_CAPTION = (
    "Friction from one reversal to the next but one, of travels from small to large. Grey: measured; blue: the model."
)


def _names(result: Identification) -> str:
    paths = list(dict.fromkeys(Path(record.path).name for record in result.records))
    return paths[0] if len(paths) == 1 else f"{paths[0]} and {len(paths) - 1} more"


def _percent(error: Any) -> str:
    return "" if error is None or not math.isfinite(error.relative_error) else f"{100.0 * error.relative_error:.2f} %"


def _errors(best: Fit) -> str:
    parts = [f"It predicts the torque to {_percent(best.train)} of its norm on these data"]
    parts.append(f"to {_percent(best.cross_validation)} on blocks of them that it was not fitted to")
    if best.across_speeds is not None:
        parts.append(f"to {_percent(best.across_speeds)} on strokes of speeds that it was not fitted to")
    if best.validation is not None:
        parts.append(f"to {_percent(best.validation)} on the recordings kept apart")
    return ", ".join(parts) + "."


def _free_run(free_run: dict[str, Any]) -> str:
    if free_run["relative_error"] is None:
        return html.escape(f"No free simulation: {free_run['reason']}.")
    return f"In free simulation the torque's error is {100.0 * free_run['relative_error']:.2f} %."


def _list(lines: Any) -> str:
    return "<ul>" + "".join(f"<li>{html.escape(line)}</li>" for line in lines) + "</ul>"


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
        share = "" if error is None or value == 0.0 else f"{100.0 * error / abs(value):.1f} %"
        rows.append(
            (
                html.escape(name),
                f"{value:.6g}",
                "" if error is None else f"± {1.96 * error:.2g}",
                share,
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
        for each in result.fits[:_SHOWN]
    ]
    header: tuple[str, ...] = (
        "",
        "parameters",
        "rmse",
        "these data",
        "blocks held out",
        "speeds held out",
        "kept apart",
    )
    is_shown = [not rows or any(row[k] for row in rows) for k in range(len(header))]
    header = tuple(itertools.compress(header, is_shown))
    rows = [tuple(itertools.compress(row, is_shown)) for row in rows]
    more = len(result.fits) - _SHOWN
    note = f'<p class="note">{more} more are left out; <code>--json</code> has them.</p>' if more > 0 else ""
    shown = [tuple(itertools.compress(row, is_shown)) for row in rows]
    return table(tuple(itertools.compress(header, is_shown)), shown) + note


def _data(result: Identification) -> str:
    rows = []
    for kind, records in (("fitted to", result.records), ("kept apart", result.validation)):
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
    header = ("", "used", "rows", "rate", "low-pass", "each n-th row compared")
    notes = [*problems, *result.notes]
    if result.best.is_refined:
        notes.append(
            f"{result.best.label} was fitted once more without that low-pass: velocity up to "
            f"{LAST_BAND_RATIO:g} of the sampling rate, as far as it is above the encoder's noise; torques are "
            f"compared below {RESIDUAL_HZ:g} Hz, at {ROWS_HZ:g} Hz"
        )
    return table(header, rows, ("text",)) + _list(notes)
