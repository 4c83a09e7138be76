"""``friction-hil doctor``: why the daemon does not start, or would run badly, and what mends it."""

from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING

import click

from friction_hil.cli.output import console, print_json

if TYPE_CHECKING:
    from rich.console import Console

    from friction_hil.drive.finding import Finding

_STYLES = {"pass": "green", "warn": "yellow", "fail": "bold red"}
_INDENT = " " * 6


@click.command("doctor")
@click.argument("config", required=False, type=click.Path(path_type=Path))
@click.option("--json", "as_json", is_flag=True, help="Print one JSON list on stdout, nothing else.")
def command(config: Path | None, as_json: bool) -> int:
    """Tell what this machine lacks for the daemon, and what stands between CONFIG and its drives.

    Run it as the user who runs the daemon. Ports and buses are opened and given back at once; nothing is written to
    a drive. Each check ends with pass, warn (the daemon runs, but worse, or the system does not tell) or fail (it
    will not run, or not safely), and with what mends it. Exit status 1 if a check fails, 2 if CONFIG has mistakes.
    """
    from dataclasses import asdict

    from friction_hil.doctor.checks import CONFIGURATION, examine

    out = console()
    findings = []
    for finding in examine(config):
        findings.append(finding)
        if not as_json:
            _print(out, finding)
    if as_json:
        print_json([asdict(finding) for finding in findings])
    else:
        _print_summary(findings)
    failed = {finding.check for finding in findings if finding.result == "fail"}
    return 2 if CONFIGURATION in failed else int(bool(failed))


def _print(out: "Console", finding: "Finding") -> None:
    """Print one check at once: the next may take its time."""
    import textwrap

    from rich.text import Text

    text = f"{finding.result}  {finding.check}: {finding.detail}"
    # a path or a command must not be torn apart: the terminal breaks what is too long
    wrapped = textwrap.fill(text, out.width, subsequent_indent=_INDENT, break_long_words=False, break_on_hyphens=False)
    shown = Text(wrapped)
    shown.stylize(_STYLES[finding.result], 0, len(finding.result))
    out.print(shown, soft_wrap=True)
    if finding.fix:
        out.print(Text(f"{_INDENT}fix: {finding.fix}"), soft_wrap=True)


def _print_summary(findings: "list[Finding]") -> None:
    count = Counter(finding.result for finding in findings)
    click.echo(f"\n{count['pass']} passed, {count['warn']} with a warning, {count['fail']} failed")
