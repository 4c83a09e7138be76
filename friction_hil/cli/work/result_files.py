"""Checks of the files that a command will write, made before any work is done."""

from pathlib import Path

import click

from friction_hil.checked_yaml.output import check_model_path, check_writable
from friction_hil.reports.figures import require_matplotlib


def check_result_files(output: Path | None, report: Path | None) -> None:
    """Check the names of a model file and a report.

    Raises `click.UsageError`: a report has the wrong suffix; `UsageError`: that of a model file is wrong, a report is
    requested and matplotlib is not installed, or a file cannot be written.
    """
    if output is not None:
        check_model_path(output, "--output ")
    if report is not None:
        require_matplotlib()
        if report.suffix not in (".html", ".htm"):
            raise click.UsageError(f"--report {report}: a report ends in .html")
        check_writable(report, "--report ")
