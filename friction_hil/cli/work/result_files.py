"""Checks of the files that a command will write, made before any work is done."""

import os
from pathlib import Path

import click

from friction_hil.errors import UsageError
from friction_hil.reports.figures import require_matplotlib


def check_result_files(output: Path | None, report: Path | None) -> None:
    """Check the names of a model file and a report.

    Raises `click.UsageError`: a name has the wrong suffix; `UsageError`: a report is requested and matplotlib is not
    installed, or a file cannot be written.
    """
    if output is not None and output.suffix not in (".yaml", ".yml"):
        raise click.UsageError(f"--output {output}: a model file ends in .yaml")
    if report is not None:
        require_matplotlib()
        if report.suffix not in (".html", ".htm"):
            raise click.UsageError(f"--report {report}: a report ends in .html")
    for option, path in (("--output", output), ("--report", report)):
        if path is not None:
            check_writable(path, option)


def check_writable(path: Path, option: str) -> None:
    """Check that a file can be written where an option names it: hours of work must not fail at their last step.

    Raises `UsageError`: there is no such folder, the name is that of a folder, or writing is not permitted.
    """
    folder = path.parent
    if path.is_dir():
        raise UsageError(f"{option} {path} is a folder; name a file")
    if not folder.is_dir():
        raise UsageError(f"{option} {path}: there is no folder {folder}; create it first")
    if not os.access(path if path.exists() else folder, os.W_OK):
        raise UsageError(f"{option} {path} cannot be written: permission denied; name another file")
