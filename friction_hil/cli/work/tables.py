"""Tables and lines for the terminal."""

from collections.abc import Iterable, Mapping
from pathlib import PurePath

import click
from rich.console import Console, ConsoleOptions, RenderableType
from rich.segment import Segment
from rich.style import StyleType
from rich.table import Table
from rich.text import Text

from friction_hil.printable import printable

_WIDE = 1000  # columns


class _PrintableConsole(Console):
    """A console whose text is printable; its own control sequences are not text."""

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        """Render an object, as rich does."""
        for segment in super().render(renderable, options):
            yield segment if segment.control else segment._replace(text=printable(segment.text))


def console(*, stderr: bool = False) -> Console:
    """Return a rich console: stdout for results, stderr for progress and warnings.

    Brackets and colons in a text are not interpreted, because a name may contain any character.
    """
    return _PrintableConsole(stderr=stderr, highlight=False, markup=False, emoji=False)


class _PrintableTable(Table):
    """A table whose cells are printable before their widths are determined."""

    def add_row(self, *cells: RenderableType | None, style: StyleType | None = None, end_section: bool = False) -> None:
        """Add a row, as rich does."""
        shown: list[RenderableType | None] = []
        for cell in cells:
            if isinstance(cell, Text):
                cell.plain = printable(cell.plain)
            shown.append(printable(cell) if isinstance(cell, str) else cell)
        super().add_row(*shown, style=style, end_section=end_section)


def new_table(*headings: str) -> Table:
    """Return an empty table without lines."""
    return _PrintableTable(*headings, box=None, header_style="bold", pad_edge=False)


def print_table(table: Table) -> None:
    """Print a table on stdout; in a file or a pipe no cell is cut or wrapped."""
    out = console()
    if not out.is_terminal:
        out.width = _WIDE
    out.print(table)


def print_files(files: Mapping[str, PurePath | None]) -> None:
    """Print the path of each file that was written, after its name."""
    for name, path in files.items():
        if path is not None:
            click.echo(f"{name}: {path}")
