"""HTML reports in one file: style, pictures, tables, and writing them."""

import base64
import html
import io
import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from friction_hil.errors import FrictionHilError, UsageError
from friction_hil.reports.figures import REPRODUCIBLE, apply_style

if TYPE_CHECKING:
    from matplotlib.figure import Figure

STYLE = """
:root { color-scheme: light dark; --ink: #222; --paper: #fff; --faint: #555; --line: #ddd; --panel: #f5f5f5 }
body { font: 16px/1.5 system-ui, sans-serif; color: var(--ink); background: var(--paper); overflow-wrap: break-word }
body { max-width: 66rem; margin: 2rem auto; padding: 0 1rem }
h1 { font-size: 1.6rem; margin-bottom: .3rem } h2 { font-size: 1.25rem; margin-top: 2.6rem }
figure { margin: 1rem 0 } img { max-width: 100%; height: auto }
figure.wide img { display: block; width: 100% }
figcaption, .note { color: var(--faint); font-size: .92rem }
.scroll { overflow-x: auto }
table { border-collapse: collapse; margin: .6rem 0; font-variant-numeric: tabular-nums; font-size: .92rem }
th, td { padding: .25rem .7rem; text-align: right; border-bottom: 1px solid var(--line); font-weight: normal }
thead th { border-bottom: 2px solid #888; vertical-align: bottom }
th:first-child, .text { text-align: left } td { white-space: nowrap } td.text { white-space: normal }
code { font-size: .92em }
nav { display: flex; flex-wrap: wrap; gap: .2em 1.2em }
pre { white-space: pre-wrap; font-size: .85rem; background: var(--panel); padding: .6rem }
@media (prefers-color-scheme: dark) {
  :root { --ink: #e8ebee; --paper: #14171a; --faint: #a4afbb; --line: #444d57; --panel: #1d2126 }
  figure img { filter: invert(.92) hue-rotate(180deg) }
}
@media (max-width: 40rem) {
  body { margin: .6rem auto; padding: 0 .6rem } figure { overflow-x: auto }
  figure img, figure.wide img { width: 42rem; max-width: none }
}
""".strip()


def picture(figure: "Figure", caption: str, kind: str = "") -> str:
    """Return a figure as HTML: SVG with a caption. ``kind`` is its CSS class; ``wide`` fills the width of the page."""
    from matplotlib import rc_context  # imported here: matplotlib is optional, and takes 0.3 s

    apply_style(figure)
    if (layout := figure.get_layout_engine()) is not None:
        layout.execute(figure)
        figure.set_layout_engine("none")  # done: otherwise everything is drawn once more to do it again
    text = io.StringIO()
    with rc_context(REPRODUCIBLE):
        figure.savefig(text, format="svg", metadata={"Date": None})
    data = base64.b64encode(text.getvalue().encode()).decode()
    escaped = html.escape(caption)
    return (
        f'<figure class="{kind}"><img alt="{escaped}" src="data:image/svg+xml;base64,{data}">'
        f"<figcaption>{escaped}</figcaption></figure>"
    )


def table(header: Sequence[str], rows: Iterable[Sequence[str]], classes: Sequence[str] = ()) -> str:
    """Return a table as HTML. Its cells are HTML; ``classes`` are the CSS classes of the columns after the first."""
    marks = ["", *classes, *[""] * len(header)]
    heads = "".join(f'<th scope="col" class="{mark}">{cell}</th>' for cell, mark in zip(header, marks, strict=False))
    lines = []
    for first, *others in rows:
        cells = "".join(f'<td class="{mark}">{cell}</td>' for cell, mark in zip(others, marks[1:], strict=False))
        lines.append(f'<tr><th scope="row">{first}</th>{cells}</tr>')
    body = f"<thead><tr>{heads}</tr></thead><tbody>{''.join(lines)}</tbody>"
    return f'<div class="scroll"><table>{body}</table></div>'


def generator(command: str) -> str:
    """Return the beginning of the meta element by which the reports of a command are recognised."""
    return f'<meta name="generator" content="friction-hil {command}'


def page(title: str, mark: str, body: str, style: str = "") -> str:
    """Return the document; ``mark`` is the meta element that names its generator, ``style`` is added to the style."""
    head = f'<meta charset="utf-8">\n{mark}\n<meta name="viewport" content="width=device-width, initial-scale=1">'
    start = f"<title>{html.escape(title)}</title>\n<style>\n{STYLE}\n{style}</style>"
    return f'<!doctype html>\n<html lang="en">\n<head>\n{head}\n{start}\n</head>\n<body>{body}</body>\n</html>\n'


def unordered_list(lines: Iterable[str]) -> str:
    """Return lines of text as an HTML list; nothing if there is none."""
    items = "".join(f"<li>{html.escape(line)}</li>" for line in lines)
    return f"<ul>{items}</ul>" if items else ""


def write_page(path: Path, text: str) -> None:
    """Write a report; an existing file is overwritten. Raises `FrictionHilError`: the file cannot be written."""
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise FrictionHilError(f"{path} cannot be written: {error.strerror}") from None


def claim_folder(folder: Path, names: Sequence[str], mark: str, maker: str) -> None:
    """Create a folder for a report and the files beside it.

    The first of ``names``, the files that will be written, is the report. ``mark``: beginning of the meta element by
    which an earlier report is recognised. ``maker``: name of the command that makes such reports. Raises `UsageError`:
    a file of one of these names exists, and the report in the folder was not made by the same command; or the folder
    cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    if not os.access(folder, os.W_OK):
        raise UsageError(f"{folder} cannot be written: permission denied; choose another folder")
    present = [name for name in names if (folder / name).exists()]
    if not present:
        return
    report = folder / names[0]
    if not (report.is_file() and mark in report.read_text(encoding="utf-8", errors="replace")[:1000]):
        raise UsageError(
            f"{folder / present[0]} exists and no former {maker} made it: it is not overwritten; choose another folder"
        )
