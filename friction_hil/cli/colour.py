"""Errors and warnings on stderr: on a terminal wrapped at words, and coloured unless the user does not want it."""

import contextlib
import os
import sys
import textwrap
from collections.abc import Callable, Sequence

import click

from friction_hil.errors import MOST_PRINTED, Problem, more_problems
from friction_hil.printable import own_style, printable

_USUAL_WIDTH = 80


def red(text: str) -> str:
    """Return ``text`` in red; `PrintableStream` takes the colour away again where there is no terminal."""
    return _styled(text, "red")


def yellow(text: str) -> str:
    """Return ``text`` in yellow; see `red`."""
    return _styled(text, "yellow")


def echo_labelled(label: str, text: str, style: Callable[[str], str] = red) -> None:
    """Print ``label`` in colour and ``text`` on stderr; on a terminal no word is cut.

    Words that are wider than the terminal stay in one piece, so that a path can be copied.
    """
    lines = f"{printable(label)} {printable(text)}".rstrip().split("\n")
    if sys.stderr.isatty():
        width = _width()
        lines = [
            textwrap.fill(line, width, break_long_words=False, break_on_hyphens=False) if line.strip() else line
            for line in lines
        ]
    shown = "\n".join(lines)
    if shown.startswith(printable(label)):
        shown = style(label) + shown[len(printable(label)) :]
    click.echo(shown, err=True)


def echo_problems(problems: Sequence[Problem]) -> None:
    """Print the mistakes in a file on stderr, with file and line number in red; of very many, the first ones."""
    for problem in problems[:MOST_PRINTED]:
        where = f"{problem.path if problem.line is None else f'{problem.path}:{problem.line}'}:"
        echo_labelled(where, str(problem).removeprefix(where).lstrip(" "))
    for line in more_problems(problems):
        path = f"{problems[0].path}:"
        echo_labelled(path, line.removeprefix(path).lstrip(" "))


def _width() -> int:
    """Return the width of the terminal, which COLUMNS overrides as for rich."""
    if (given := os.environ.get("COLUMNS", "")).isdecimal() and int(given):
        return int(given)
    with contextlib.suppress(OSError, ValueError):
        return os.get_terminal_size(sys.stderr.fileno()).columns or _USUAL_WIDTH
    return _USUAL_WIDTH


def _styled(text: str, colour: str) -> str:
    # no-color.org: any value but an empty one switches colours off
    if os.environ.get("NO_COLOR") or os.environ.get("TERM") == "dumb":
        return text
    return own_style(click.style(printable(text), fg=colour, bold=True))
