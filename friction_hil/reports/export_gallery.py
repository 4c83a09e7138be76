"""A gallery of models: each one exported to every format, with a page that shows and links all."""

import html
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from friction_hil import __version__, export
from friction_hil.errors import FrictionHilError
from friction_hil.export.lossy import Converted
from friction_hil.export.subject import Subject, provenance
from friction_hil.models.model_file import ModelFile
from friction_hil.reports.figures import INK, SERIES, new_figure, require_matplotlib
from friction_hil.reports.model_picture import draw
from friction_hil.reports.page import claim_folder, generator, page, picture, table, write_page

if TYPE_CHECKING:
    from matplotlib.figure import Figure

INDEX = "index.html"
_MARK = generator("models")
_CAPTION = (
    "Left: steady torque of the model (black) and of each export that loses torque. Right: what these lose. With a "
    "temperature, at the middle of its range. Equal curves lie upon each other: some formats hold the same."
)


def write_gallery(
    folder: Path, models: Mapping[str, ModelFile], note: Callable[[str], None] = lambda text: None
) -> dict[str, dict[str, str]]:
    """Export models to every format, and write the page.

    Returns, by model and format, why the format cannot hold the model, empty if it can. The folder is created; the
    files of a former gallery in it are replaced. The names of the models are names of exports, too. ``note`` is called
    with the name of each model before it is exported. Raises `UsageError`: matplotlib is not installed, or another
    program's files are in the way; `FrictionHilError`: a file cannot be written.
    """
    require_matplotlib()
    claim_folder(folder, (INDEX, *models), _MARK, "gallery")
    outcome: dict[str, dict[str, str]] = {}
    sections = []
    for name, file in models.items():
        note(name)
        outcome[name] = {}
        own = folder / name
        converted: dict[str, Converted] = {}
        rows = []
        for to, about in export.FORMATS.items():
            try:
                content, lost = _make(name, file, to, converted)
                outcome[name][to] = ""
            except FrictionHilError as error:  # a form for rotary axes only, no compiler on this machine, ...
                content, lost = {}, f"not possible: {html.escape(str(error))}"
                outcome[name][to] = str(error)
            rows.append((_code(to), _write(own / to, f"{name}/{to}", content), lost, html.escape(about)))
        draw(file.friction_model, own / "model.svg", name)
        sections.append(_section(name, file, converted, rows))
    body = f"""
<h1>Friction models and their exports</h1>
<p>Each format that loses torque is fitted to the model over the range that its comment states; all speeds count
alike.</p>
<nav>{"".join(f'<a href="#{name}">{name}</a>' for name in models)}</nav>
{"".join(sections)}
<p class="note">friction-hil {__version__}</p>
"""
    write_page(folder / INDEX, page("friction-hil: models and their exports", f'{_MARK} {__version__}">', body))
    return outcome


def _make(
    name: str, file: ModelFile, to: str, converted: dict[str, Converted]
) -> tuple[Mapping[str, str | bytes], str]:
    """Return the files of one export, and what it loses, as HTML."""
    if to not in export.LOSSY:
        return export.files(file, to, name=name), "nothing"
    made = converted[to] = export.convert(file, to, name=name)
    return made.files, "<br>".join(map(html.escape, made.loss.lines()))


def _write(folder: Path, address: str, content: Mapping[str, str | bytes]) -> str:
    """Write the files of one export; return links to them, as HTML."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        paths = export.save(content, folder, overwrite=True)
    except OSError as error:
        raise FrictionHilError(f"{folder} cannot be written: {error.strerror}") from None
    links = (f'<a href="{address}/{html.escape(path.name)}">{html.escape(path.name)}</a>' for path in paths)
    return "<br>".join(links)


def _section(name: str, file: ModelFile, converted: Mapping[str, Converted], rows: Iterable[Sequence[str]]) -> str:
    about = "\n".join(provenance(Subject(name, file, file.source_path.name if file.source_path else "")))
    curves = picture(_draw(file, converted), _CAPTION, "wide") if converted else ""
    return f"""
<h2 id="{name}">{name}</h2>
<pre>{html.escape(about)}</pre>
<figure class="wide"><img alt="friction of {name}" src="{name}/model.svg"></figure>
{curves}
{table(("format", "files", "loses", "for"), rows, ("text", "text", "text"))}
"""


def _draw(file: ModelFile, converted: Mapping[str, Converted]) -> "Figure":
    is_rotary = file.axis == "rotary"
    figure = new_figure(11.0, 4.2)
    left, right = figure.subplots(1, 2)
    for (to, each), color in zip(converted.items(), SERIES, strict=False):
        points = each.loss.points
        celsius = points.temperature
        known = np.isfinite(celsius)
        rows = ~known if not known.any() else celsius == np.sort(np.unique(celsius))[np.unique(celsius).size // 2]
        order = np.argsort(points.velocity[rows])
        velocity = points.velocity[rows][order]
        torque = points.torque(file.friction_model)[rows][order]
        lost = each.loss.difference[rows][order]
        if not left.lines:
            left.plot(velocity, torque, color=INK, linewidth=2.4, label="model")
        left.plot(velocity, torque - lost, color=color, linewidth=1.2, label=to)
        right.plot(velocity, lost, color=color, linewidth=1.2, label=to)
    speed, unit = ("rad/s", "N m") if is_rotary else ("m/s", "N")
    left.set(xlabel=f"velocity [{speed}]", ylabel=f"friction torque [{unit}]", title="steady torque")
    right.set(xlabel=f"velocity [{speed}]", ylabel=f"model - export [{unit}]", title="lost")
    left.legend()
    return figure


def _code(text: str) -> str:
    return f"<code>{html.escape(text)}</code>"
