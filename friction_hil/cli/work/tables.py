"""Tables for the terminal: one style for every command.

A table has no lines; its headings are bold, numbers stand to the right. Nothing is cut: columns that do not fit side by
side go below the others, with the first columns repeated; only prose, and names that are wider than the terminal, are
wrapped.
"""

import textwrap
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import PurePath
from typing import IO

import click
from rich import cells
from rich.console import Console, ConsoleOptions, RenderableType
from rich.segment import Segment
from rich.table import Table as RichTable
from rich.text import Text

from friction_hil.printable import own_style, printable, without_own_style

_WIDE = 1000  # columns, in a file or a pipe
_GAP = 2  # between columns
_LEAST_PROSE = 24  # columns
_LEAST_KEY = 8


class _PrintableConsole(Console):
    """A console whose text is printable; its own control sequences are not text."""

    @property
    def file(self) -> IO[str]:
        """Stream itself: while a bar is shown, rich stands before the `PrintableStream`, which stands before it."""
        file = super().file
        return getattr(file, "rich_proxied_file", file)

    @file.setter
    def file(self, new_file: IO[str]) -> None:
        self._file = new_file

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        """Render an object, as rich does."""
        for segment in super().render(renderable, options):
            yield segment if segment.control else segment._replace(text=printable(without_own_style(segment.text)))


def console(*, stderr: bool = False) -> Console:
    """Return a rich console: stdout for results, stderr for progress and warnings.

    Brackets and colons in a text are not interpreted, because a name may contain any character.
    """
    return _PrintableConsole(stderr=stderr, highlight=False, markup=False, emoji=False)


@dataclass(frozen=True, slots=True)
class Column:
    """A column of a table; ``\\n`` breaks a heading."""

    heading: str
    is_number: bool = False
    is_prose: bool = False


def number(heading: str) -> Column:
    """Return a column of numbers: to the right, never wrapped."""
    return Column(heading, is_number=True)


def prose(heading: str) -> Column:
    """Return a column of sentences, which are wrapped at words where there is no room."""
    return Column(heading, is_prose=True)


@dataclass(slots=True)
class Table:
    """Rows of text under headings; ``\\n`` breaks a cell."""

    columns: tuple[Column, ...]
    keys: int = 1  # leading columns that are repeated where the others do not fit side by side
    rows: list[tuple[str, ...]] = field(default_factory=list)

    def add_row(self, *cells: str) -> None:
        """Append a row, with a cell for each column."""
        if len(cells) != len(self.columns):
            raise ValueError(f"{len(cells)} cells for {len(self.columns)} columns")
        self.rows.append(tuple(map(printable, cells)))


def new_table(*headings: str | Column, keys: int = 1) -> Table:
    """Return an empty table, whose first ``keys`` columns say what a row is about."""
    return Table(tuple(each if isinstance(each, Column) else Column(each) for each in headings), keys)


def print_table(table: Table) -> None:
    """Print a table on stdout; in a file or a pipe it is as wide as it needs to be."""
    out = console()
    if not out.is_terminal:
        out.width = _WIDE
    for line in lines(table, out):
        click.echo(own_style(line))


def lines(table: Table, out: Console) -> Iterator[str]:
    """Yield the lines of a table as wide as ``out`` permits, without blanks at their ends; bold only on a terminal."""
    for k, part in enumerate(_parts(table, out.width)):
        with out.capture() as text:
            out.print(part)
        yield from ([""] if k else []) + [line.rstrip() for line in text.get().splitlines()]


def _parts(table: Table, width: int) -> Iterator[RichTable]:
    """Yield one table, or several with the first columns repeated if the columns do not fit side by side."""
    needed = [_needed(table, k) for k in range(len(table.columns))]
    natural = [_natural(table, k) for k in range(len(table.columns))]
    keys, others = list(range(table.keys)), range(table.keys, len(table.columns))
    widest = max((needed[k] for k in others), default=-_GAP)
    while (excess := _total(needed, keys) - (width - widest - _GAP)) > 0:
        longest = max(keys, key=lambda k: needed[k])
        if needed[longest] <= _LEAST_KEY:
            break
        needed[longest] = max(needed[longest] - excess, _LEAST_KEY)
    part = keys.copy()
    for k in others:
        needed[k] = min(needed[k], max(width - _total(needed, keys) - _GAP, 1))
        if len(part) > len(keys) and _total(needed, [*part, k]) > width:
            yield _rich(table, part, _widths(table, part, needed, natural, width))
            part = keys.copy()
        part.append(k)
    yield _rich(table, part, _widths(table, part, needed, natural, width))


def _total(widths: Sequence[int], part: Sequence[int]) -> int:
    return sum(widths[k] for k in part) + _GAP * (len(part) - 1)


def _natural(table: Table, k: int) -> int:
    texts = (table.columns[k].heading, *(row[k] for row in table.rows))
    return max((cells.cell_len(line) for text in texts for line in text.splitlines()), default=0)


def _needed(table: Table, k: int) -> int:
    """Return the width that a column cannot do without."""
    return min(_natural(table, k), _LEAST_PROSE) if table.columns[k].is_prose else _natural(table, k)


def _widths(
    table: Table, part: Sequence[int], needed: Sequence[int], natural: Sequence[int], width: int
) -> dict[int, int]:
    """Return the widths of the columns of a part; those of prose share the room that is left."""
    room = max(width - _total(needed, part), 0)
    wanted = {k: natural[k] - needed[k] if table.columns[k].is_prose else 0 for k in part}
    share = min(room / max(sum(wanted.values()), 1), 1.0)
    return {k: needed[k] + int(share * wanted[k]) for k in part}


def _rich(table: Table, part: Sequence[int], widths: Mapping[int, int]) -> RichTable:
    made = RichTable(box=None, header_style="bold", pad_edge=False, padding=(0, _GAP, 0, 0))
    height = max(table.columns[k].heading.count("\n") for k in part)
    for k in part:
        column = table.columns[k]
        made.add_column(
            Text("\n" * (height - column.heading.count("\n")) + column.heading),
            justify="right" if column.is_number else "left",
            overflow="fold",
            no_wrap=column.is_number,
            width=widths[k],
        )
    for row in table.rows:
        made.add_row(*(Text(row[k]) for k in part))
    return made


def say(text: str, *, stderr: bool = True) -> None:
    """Print a sentence; on a terminal it is wrapped at words."""
    out = console(stderr=stderr)
    if out.is_terminal:
        text = "\n".join(
            textwrap.fill(
                line,
                out.width,
                subsequent_indent=" " * (len(line) - len(line.lstrip(" "))),
                break_long_words=False,
                break_on_hyphens=False,
            )
            for line in text.split("\n")
        )
    click.echo(text, err=stderr)


def print_files(files: Mapping[str, PurePath | None]) -> None:
    """Print the path of each file that was written, after its name."""
    for name, path in files.items():
        if path is not None:
            click.echo(f"{name}: {path}")
