"""The interactive page of a run: one HTML file with all axes, which needs no network."""

import base64
import html
import json
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from friction_hil import __version__
from friction_hil.numerics.jit import Array
from friction_hil.reports.decimation import bucket_size, decimated, decimated_time
from friction_hil.reports.figures import FAULT, GREY, INK, MEASURED, WITH, WITHOUT
from friction_hil.reports.page import generator, page, table, unordered_list, write_page
from friction_hil.reports.run.panels import Panel
from friction_hil.reports.run.view import RunView, broken_at_gaps

MOST_POINTS = 120_000  # of a signal in the page; a longer recording is thinned by minimum and maximum
_PAIR_POINTS = 4000
_STYLE = """
:root { --faint: #555; --grid: #e6e6e6 }
body { max-width: 100rem }
.pair { display: flex; flex-wrap: wrap; gap: 1rem }
.pair > div { flex: 1 1 30rem; min-width: 0 }
@media (prefers-color-scheme: dark) {
  .uplot { filter: invert(.92) hue-rotate(180deg); color: #222 } .note, figcaption { color: inherit }
}
@media (max-width: 40rem) { .pair > div { flex-basis: 100% } }
""".strip()
# The browser itself refuses whatever this page might load.
_POLICY = (
    "<meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; script-src 'unsafe-inline'; "
    "style-src 'unsafe-inline'; img-src data: blob:; form-action 'none'; base-uri 'none'\">"
)
_HELP = (
    "Drag to zoom, double-click to see everything again; all times move together. The values at the cursor stand below "
    "each chart; a click on a name hides its line."
)


def write_run_page(path: Path, views: Sequence[RunView]) -> int:
    """Write the page, with one view for each axis; an existing file is overwritten.

    Returns the number of rows of which the page holds only minimum and maximum; 1 if it holds every row. Raises
    `FrictionHilError`: the file cannot be written.
    """
    drawing = files("friction_hil.live.web") / "static"
    library, licence, charts, style = (
        (drawing / name).read_text(encoding="utf-8")
        for name in ("uPlot.iife.min.js", "uPlot.LICENSE", "charts.js", "uPlot.min.css")
    )
    size = max(bucket_size(len(view.time_s), MOST_POINTS) for view in views)
    parts = [_section(view, number) for number, view in enumerate(views)]
    script = files(__package__).joinpath("page.js").read_text(encoding="utf-8")
    thinned = (
        ""
        if size == 1
        else (
            f" The page holds minimum and maximum of each {size} rows; with <code>--from</code> and <code>--to</code> "
            "a page of a part holds every row."
        )
    )
    title = f"friction-hil: {views[0].title}"
    body = (
        f'<p class="note">{_HELP}{thinned}</p>\n{"".join(parts)}\n<p class="note">friction-hil {__version__}</p>\n'
        f'<script>/*\n{licence}*/\n{library}</script>\n<script type="module">{charts}\n{script}</script>\n'
    )
    write_page(path, page(title, f'{_POLICY}\n{generator("plot")} {__version__}">', body, f"{style}\n{_STYLE}"))
    return size


def _section(view: RunView, number: int) -> str:
    header = ("following error", "without", "with compensation", "times lower")
    figures = table(header, [tuple(map(html.escape, row)) for row in view.rows]) if view.rows else ""
    data = json.dumps(_data(view, number), allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
    events = _events(view)
    listed = f"<details><summary>{len(events)} events</summary>{unordered_list(events)}</details>" if events else ""
    return f"""
<h2>{html.escape(view.title)}</h2>
<p>{html.escape(view.facts)}</p>
{figures}{unordered_list(view.notes)}
<p><button id="picture-{number}">Save as PNG</button> <span class="note" id="marks-{number}"></span></p>
<div id="time-{number}"></div>
<div class="pair"><div id="comparison-{number}"></div><div id="friction-{number}"></div></div>
{listed}
<script type="application/json">{data}</script>
"""


def _events(view: RunView) -> list[str]:
    return [f"{mark.time_s:.3f} s: {mark.kind}: {mark.text}" for mark in view.marks]


def _data(view: RunView, number: int) -> dict[str, Any]:
    time, values = broken_at_gaps(view)
    size = bucket_size(len(time), MOST_POINTS)
    return {
        "number": number,
        "name": f"{view.title}.png",
        "time": _packed(decimated_time(time, size), np.float64),
        "panels": [_panel(panel, lines, size) for panel, lines in zip(view.panels, values, strict=True)],
        "marks": [
            {"time_s": float(at), "text": f"{at:.3f} s: {count:.0f} missed", "color": FAULT}
            for at, count in zip(view.missed_s, view.missed, strict=True)
        ]
        + [
            {"time_s": mark.time_s, "text": text, "color": FAULT if mark.is_fault else GREY}
            for mark, text in zip(view.marks, _events(view), strict=True)
        ],
        "spans": [
            {"from": begin, "to": end, "color": color}
            for phase, color in zip(view.phases, (WITHOUT, WITH), strict=True)
            for begin, end in (phase.intervals_s if phase else ())
        ],
        "comparison": _comparison(view),
        "friction": _friction(view),
    }


def _panel(panel: Panel, values: Sequence[Array], size: int) -> dict[str, Any]:
    words, _, unit = panel.label.partition("\n")
    return {
        "name": panel.name,
        "label": f"{words} {unit}",
        "unit": unit.strip("[]"),
        "lines": [
            {
                "name": line.name,
                "color": line.color,
                "width": line.width,
                "is_dashed": line.is_dashed,
                "data": _packed(decimated(each, size), np.float32),
            }
            for line, each in zip(panel.lines, values, strict=True)
        ],
    }


def _packed(values: Array, kind: type) -> str:
    little_endian = np.dtype(kind).newbyteorder("<")
    with np.errstate(over="ignore"):
        return base64.b64encode(values.astype(little_endian).tobytes()).decode()


def _comparison(view: RunView) -> dict[str, Any] | None:
    factor, unit = view.error_unit if any(view.phases) else (1.0, "")
    lines = []
    for phase, name, color in zip(view.phases, ("without", "with compensation"), (WITHOUT, WITH), strict=True):
        if phase is not None:
            size = bucket_size(len(phase.time_s), _PAIR_POINTS)
            error = decimated(phase.error * factor, size)
            lines.append(_line(name, color, decimated_time(phase.time_s, size), error, is_line=True))
    labels = {"x": view.comparison_label, "y": f"following error [{unit}]"}
    return {"lines": lines, "labels": labels} if lines else None


def _friction(view: RunView) -> dict[str, Any] | None:
    found = view.friction
    if found is None:
        return None
    measured = "measured, less the mechanics of the model" if found.is_friction else "measured torque"
    known = (
        (measured, MEASURED, found.measured, False),
        ("compensation as applied", WITH, found.compensation, False),
        ("model at constant velocity", INK, found.curve, True),
    )
    lines = [_line(name, color, *pair, is_line=is_line) for name, color, pair, is_line in known if pair is not None]
    return {"lines": lines, "labels": {"x": f"velocity [{view.speed_unit}]", "y": f"torque [{view.units[1]}]"}}


def _line(name: str, color: str, x: Array, y: Array, *, is_line: bool) -> dict[str, Any]:
    values = [None if not np.isfinite(each) else float(f"{each:.7g}") for each in y]
    return {"name": name, "color": color, "is_line": is_line, "x": [float(f"{each:.7g}") for each in x], "y": values}
