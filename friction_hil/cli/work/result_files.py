"""Checks of the files that a command will write, made before any work is done."""

from pathlib import Path

import click

from friction_hil.reports.figures import require_matplotlib


def check_result_files(output: Path | None, report: Path | None) -> None:
    """Check the names of a model file and a report.

    Raises
    ------
    click.UsageError
        A name has the wrong suffix.
    UsageError
        A report is requested and matplotlib is not installed.
    """
    if output is not None and output.suffix not in (".yaml", ".yml"):
        raise click.UsageError(f"--output {output}: a model file ends in .yaml")
    if report is not None:
        require_matplotlib()
        if report.suffix not in (".html", ".htm"):
            raise click.UsageError(f"--report {report}: a report ends in .html")
