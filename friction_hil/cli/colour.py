"""Colour of errors and warnings on stderr: on a terminal only, and not if the user does not want it."""

import os

import click

from friction_hil.errors import Problem
from friction_hil.printable import own_style, printable


def red(text: str) -> str:
    """Return ``text`` in red; `PrintableStream` takes the colour away again where there is no terminal."""
    return _styled(text, "red")


def yellow(text: str) -> str:
    """Return ``text`` in yellow; see `red`."""
    return _styled(text, "yellow")


def problem_line(problem: Problem) -> str:
    """Return a mistake in a file as one line, with file and line number in red."""
    text = str(problem)
    where = problem.path if problem.line is None else f"{problem.path}:{problem.line}"
    return f"{red(f'{where}:')}{text.removeprefix(f'{where}:')}"


def _styled(text: str, colour: str) -> str:
    # no-color.org: any value but an empty one switches colours off
    if os.environ.get("NO_COLOR") or os.environ.get("TERM") == "dumb":
        return text
    return own_style(click.style(printable(text), fg=colour, bold=True))
