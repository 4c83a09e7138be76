"""The report of a study as one HTML file: pictures, numbers and explanations."""

import html
import os
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING

from friction_hil import __version__
from friction_hil.reports.page import claim_folder, generator, page, picture, table
from friction_hil.reports.study import pictures
from friction_hil.reports.study.text import HOW_MATCHED, SECTIONS, ExperimentText, look, number, summary_columns
from friction_hil.study import Study
from friction_hil.study.subjects import DEFAULT, Levels, matched

if TYPE_CHECKING:
    from matplotlib.figure import Figure

REPORT = "report.html"
MARK = generator("study")

ShowProgress = Callable[[str, float], None]


@dataclass(frozen=True, slots=True)
class _Drawing:
    draw: Callable[[Study], "Figure"]
    caption: str


def claim(folder: Path) -> None:
    """Create the folder of a study; see `claim_folder`."""
    claim_folder(folder, (REPORT,), MARK, "study")


def write_report(folder: Path, study: Study, show: ShowProgress = lambda text, done: None) -> Path:
    """Write the report into a folder prepared by `claim`, and return its path.

    ``show`` takes a text and the completed fraction.
    """
    parts = []
    for k, section in enumerate(SECTIONS):
        show(f"drawing {section.key}", k / len(SECTIONS))
        parts.append(_section(study, section))
    body = f"""
<h1>What friction does to a servo</h1>
<p>Nine experiments, each with {len(study.models)} friction model{"s" if len(study.models) > 1 else ""}:
{", ".join(f"<code>{name}</code>" for name in study.models)}. All numbers are computed without random
inputs: the same version gives the same numbers. <code>friction-hil models NAME</code> prints the formula
of a model.</p>
<nav>{"".join(f'<a href="#{each.key}">{html.escape(each.title)}</a>' for each in SECTIONS)}</nav>
{_changed(study)}
<h2>The main facts</h2>
{_summary(study)}
{"".join(parts)}
<h2 id="matched">How the models are made comparable</h2>
{HOW_MATCHED}
<h3>The mass of experiments 1 to 8, in N and m</h3>
{_parameters(study, study.settings.friction)}
<h3>The servo of experiment 9, in N m and rad</h3>
{_parameters(study, study.settings.servo_levels)}
<p class="note">friction-hil {__version__}.</p>
"""
    text = page("friction-hil: what friction does to a servo", f'{MARK} {__version__}">', body)
    path = folder / REPORT
    with tempfile.TemporaryDirectory(prefix=".study-", dir=folder) as work:
        made = Path(work) / REPORT
        made.write_text(text, encoding="utf-8")
        os.replace(made, path)
    return path


def _changed(study: Study) -> str:
    """Return what differs from the defaults, to which the explanations refer; empty if nothing does."""
    given = study.settings
    changes = [
        f"{name} {getattr(given.friction, name):g}"
        for name in (each.name for each in fields(Levels))
        if getattr(given.friction, name) != getattr(DEFAULT.friction, name)
    ]
    changes += [f"{name} of the servo {value:g}" for name, value in given.servo.items()]
    changes += [
        f"{name} {getattr(given, name):g}"
        for name in ("mass", "spring", "pull", "radius", "frequency")
        if getattr(given, name) != getattr(DEFAULT, name)
    ]
    if not changes:
        return ""
    text = html.escape(", ".join(changes))
    return f'<p class="note">Given for this study: {text}. Numbers in the explanations are those of the defaults.</p>'


def _summary(study: Study) -> str:
    columns = summary_columns()
    rows = []
    for name in study.models:
        facts = study.facts[name]
        rows.append((f"<code>{name}</code>", *(html.escape(c.write(facts, name)) for c in columns), look(name)))
    header = ("model", *(html.escape(c.title) for c in columns), "what to look at")
    note = (
        '<p class="note">Second number of a cell with an arrow: with compensation by the model itself; for break-away, '
        "at the fast rise of the force. Section 8 explains why static maps hunt more with compensation.</p>"
    )
    return table(header, rows, (*[""] * len(columns), "text")) + note


def _section(study: Study, section: ExperimentText) -> str:
    drawings = "".join(picture(each.draw(study), each.caption) for each in _DRAWINGS[section.key])
    return (
        f'<h2 id="{section.key}">{html.escape(section.title)}</h2>\n<p>{section.text}</p>\n{drawings}\n'
        f"{_figures(study, section)}\n"
    )


def _figures(study: Study, section: ExperimentText) -> str:
    """Return a table of the section's numbers, one row for each model."""
    rows = []
    for name in study.models:
        facts = study.facts[name]
        rows.append((f"<code>{name}</code>", *(number(facts.get(fact)) for fact in section.facts)))
    header = ("model", *(html.escape(title) for title in section.facts.values()))
    return table(header, rows)


def _parameters(study: Study, levels: Levels) -> str:
    rows = []
    for name in study.models:
        parameters = matched(name, levels).parameters
        rows.append((f"<code>{name}</code>", html.escape(", ".join(_assignments(parameters)))))
    return table(("model", "parameters"), rows, ("text",))


def _assignments(parameters: dict[str, object]) -> Iterator[str]:
    for name, value in parameters.items():
        if isinstance(value, list):
            items = [f"[{', '.join(f'{x:.4g}' for x in v)}]" if isinstance(v, list) else f"{v:.4g}" for v in value]
            yield f"{name} = [{', '.join(items)}]"
        else:
            yield f"{name} = {value:.4g}" if isinstance(value, float) else f"{name} = {value}"


def _circle(study: Study) -> "Figure":
    return pictures.draw_circle(study, "lugre" if "lugre" in study.models else study.models[0])


_MATRIX_CAPTION = (
    "{what} Rows: true friction. Columns: model of the compensator, bold if it is the same. Blue: better than without "
    "compensation; orange: worse."
)

_DRAWINGS: dict[str, tuple[_Drawing, ...]] = {
    "static_curve": (
        _Drawing(pictures.draw_static_curves, "Friction at constant velocity, over the velocity (logarithmic)."),
    ),
    "velocity_pulse": (
        _Drawing(pictures.draw_pulse, "Friction over time. Grey: the velocity, up to 2 mm/s, not to scale."),
    ),
    "presliding": (
        _Drawing(pictures.draw_presliding, "Force over displacement while the force is cycled below break-away."),
        _Drawing(
            pictures.draw_drift, "Displacement while the force oscillates between 15 and 55 % of the break-away force."
        ),
    ),
    "stress_strain": (
        _Drawing(
            pictures.draw_strain,
            "Friction over displacement: from 0 to 30 µm, to -30 µm, to 0, 6 µm back, 6 µm forth, on to 30 µm.",
        ),
    ),
    "frictional_lag": (
        _Drawing(pictures.draw_lag, "Friction over velocity, which oscillates between 0 and 2 mm/s at three rates."),
    ),
    "break_away": (
        _Drawing(pictures.draw_break_away, "Largest friction before the mass slides, over the rate of the force."),
    ),
    "stick_slip": (
        _Drawing(pictures.draw_stick_slip, "Velocity of the mass; the spring is pulled at 0.1 m/s."),
        _Drawing(
            lambda study: pictures.draw_matrix(study, "stick_slip", "stuck_percent", 1.0),
            _MATRIX_CAPTION.format(what="Fraction of the last 20 s during which the mass is stuck, in %."),
        ),
    ),
    "hunting": (
        _Drawing(pictures.draw_hunting, "Position of the mass; the target is 1 m."),
        _Drawing(
            lambda study: pictures.draw_matrix(study, "hunting", "swing_mm", 1.0),
            _MATRIX_CAPTION.format(what="Largest minus smallest position in the last 40 s, in mm."),
        ),
    ),
    "reversal": (
        _Drawing(_circle, "The circle, with magnified radius error."),
        _Drawing(pictures.draw_reversal, "Radius error after a reversal of one axis."),
        _Drawing(
            lambda study: pictures.draw_matrix(study, "reversal", "peak_urad", 1.0),
            _MATRIX_CAPTION.format(what="Largest radius error of a lap, in µrad."),
        ),
    ),
}
