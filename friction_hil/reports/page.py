"""Pieces of an HTML report that needs no other file: style, pictures, tables."""

import base64
import html
import io
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.figure import Figure

STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; color: #222; background: #fff }
body { max-width: 66rem; margin: 2rem auto; padding: 0 1rem }
h1 { font-size: 1.6rem; margin-bottom: .3rem } h2 { font-size: 1.25rem; margin-top: 2.6rem }
figure { margin: 1rem 0 } img { max-width: 100%; height: auto }
figure.wide img { display: block; width: 100% }
figcaption, .note { color: #555; font-size: .92rem }
.scroll { overflow-x: auto }
table { border-collapse: collapse; margin: .6rem 0; font-variant-numeric: tabular-nums; font-size: .92rem }
th, td { padding: .25rem .7rem; text-align: right; border-bottom: 1px solid #ddd; font-weight: normal }
thead th { border-bottom: 2px solid #888; vertical-align: bottom }
th:first-child, .text { text-align: left } td { white-space: nowrap } td.text { white-space: normal }
code { font-size: .92em }
nav { display: flex; flex-wrap: wrap; gap: .2em 1.2em }
pre { white-space: pre-wrap; font-size: .85rem; background: #f5f5f5; padding: .6rem }
""".strip()


def picture(figure: "Figure", caption: str, kind: str = "") -> str:
    """Put a figure into the page, as SVG, with its caption; ``kind`` is its class, ``wide`` fills the page."""
    from matplotlib import rc_context

    text = io.StringIO()
    with rc_context({"svg.hashsalt": "friction-hil"}):  # the same picture is the same text
        figure.savefig(text, format="svg", metadata={"Date": None})
    data = base64.b64encode(text.getvalue().encode()).decode()
    escaped = html.escape(caption)
    return (
        f'<figure class="{kind}"><img alt="{escaped}" src="data:image/svg+xml;base64,{data}">'
        f"<figcaption>{escaped}</figcaption></figure>"
    )


def table(header: Sequence[str], rows: Iterable[Sequence[str]], classes: Sequence[str] = ()) -> str:
    """Lay out a table; its cells are HTML. ``classes`` are those of the columns after the first."""
    marks = ["", *classes, *[""] * len(header)]
    heads = "".join(f'<th scope="col" class="{mark}">{cell}</th>' for cell, mark in zip(header, marks, strict=False))
    lines = []
    for first, *others in rows:
        cells = "".join(f'<td class="{mark}">{cell}</td>' for cell, mark in zip(others, marks[1:], strict=False))
        lines.append(f'<tr><th scope="row">{first}</th>{cells}</tr>')
    body = f"<thead><tr>{heads}</tr></thead><tbody>{''.join(lines)}</tbody>"
    return f'<div class="scroll"><table>{body}</table></div>'


def page(title: str, mark: str, body: str, style: str = "") -> str:
    """Put the whole document together; ``mark`` is the meta element that says who made it, ``style`` goes on top."""
    head = f'<meta charset="utf-8">\n{mark}\n<meta name="viewport" content="width=device-width">'
    start = f"<title>{html.escape(title)}</title>\n<style>\n{STYLE}\n{style}</style>"
    return f'<!doctype html>\n<html lang="en">\n<head>\n{head}\n{start}\n</head>\n<body>{body}</body>\n</html>\n'
