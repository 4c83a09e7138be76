"""What the commands share that make a model file of recordings: data that judge it, random starts, what is written."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click

Command = TypeVar("Command", bound=Callable[..., Any])

option_validate = click.option(
    "--validate",
    "kept_apart",
    multiple=True,
    type=click.Path(path_type=Path),
    metavar="RECORDING",
    help="Recording to judge by, and not to fit to; without any, parts of the others are held out. May be repeated.",
)
_RESULTS = (
    click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Of the random starts."),
    click.option("--output", type=click.Path(path_type=Path), metavar="MODEL.yaml", help="Write the model file."),
    click.option("--report", type=click.Path(path_type=Path), metavar="FILE.html", help="Write pictures and figures."),
)


def result_options(command: Command) -> Command:
    """Add ``--seed``, ``--output`` and ``--report``; see `check_files`."""
    for option in reversed(_RESULTS):
        command = option(command)
    return command


def check_files(output: Path | None, report: Path | None) -> None:
    """See, before any work is done, that both files can be what they are called.

    Raises
    ------
    click.UsageError
        A name has another ending.
    UsageError
        A report is wanted, and what draws its pictures is not installed.
    """
    if output is not None and output.suffix not in (".yaml", ".yml"):
        raise click.UsageError(f"--output {output}: a model file ends in .yaml")
    if report is not None:
        from friction_hil.reports.figures import require_matplotlib

        require_matplotlib()
        if report.suffix not in (".html", ".htm"):
            raise click.UsageError(f"--report {report}: a report ends in .html")
