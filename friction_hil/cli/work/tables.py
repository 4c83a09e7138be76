"""Tables and lines of text for the user."""

from collections.abc import Mapping
from pathlib import PurePath

import click
from rich.console import Console
from rich.table import Table

_WIDE = 1000  # columns


def console(*, stderr: bool = False) -> Console:
    """Return a rich console: stdout for results, stderr for progress and warnings."""
    return Console(stderr=stderr, highlight=False)


def new_table(*headings: str) -> Table:
    """Return an empty table without lines."""
    return Table(*headings, box=None, header_style="bold", pad_edge=False)


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
