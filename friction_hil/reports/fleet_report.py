"""HTML report on a fleet: how much was done, and the axes to look at first."""

import html
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from friction_hil.numerics.readable import brief
from friction_hil.reports.page import generator, page, table, write_page

_SHOWN = 50
_HIDDEN = ("error", "rows", "flags", "problems", "differences")


def write_report(path: Path, work: str, rows: Sequence[Mapping[str, Any]], worst: Sequence[Mapping[str, Any]]) -> None:
    """Write the report; ``worst``: the rows to look at first, in their order."""
    failures = [row for row in worst if row.get("error")]
    others = [row for row in worst if not row.get("error")]
    sources = {row["source"] for row in rows}
    done = len(sources) - len({row["source"] for row in failures})
    body = [f"<p>{done} of {len(sources)} done; {len(rows)} rows in table.parquet.</p>"]
    if others:
        names = list(dict.fromkeys(name for row in others[:_SHOWN] for name in row if name not in _HIDDEN))
        cells = [[_cell(row.get(name)) for name in names] for row in others[:_SHOWN]]
        body.append("<h2>Worst first</h2>" + table(names, cells) + _more(len(others)))
    if failures:
        cells = [[html.escape(str(row["source"])), html.escape(str(row["error"]))] for row in failures[:_SHOWN]]
        body.append("<h2>Not done</h2>" + table(("source", "why"), cells, ("text",)) + _more(len(failures)))
    if not worst:
        body.append("<p>Nothing stands out.</p>")
    mark = f'{generator("fleet")} {html.escape(work)}">'
    write_page(path, page(f"Fleet: {work}", mark, f"<h1>Fleet: {html.escape(work)}</h1>{''.join(body)}"))


def _cell(value: Any) -> str:
    if isinstance(value, bool) or value is None:
        return "" if value is None else str(value).lower()
    return brief(value, 4) if isinstance(value, int | float) else html.escape(str(value))


def _more(count: int) -> str:
    return f'<p class="note">and {count - _SHOWN} more</p>' if count > _SHOWN else ""
