"""The work of ``friction-hil doctor``."""

import textwrap
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import click
from rich.console import Console
from rich.text import Text

from friction_hil.cli.output import print_json
from friction_hil.cli.work.tables import console
from friction_hil.doctor.checks import CONFIGURATION, examine
from friction_hil.drive.finding import Finding
from friction_hil.errors import UsageError

_STYLES = {"pass": "green", "warn": "yellow", "fail": "bold red"}
_INDENT = " " * 6


def run_doctor(*, config: Path | None, as_json: bool, try_watchdog: bool = False, warm: bool = False) -> int:
    """Run all checks and print their findings; return 2 after mistakes of the configuration, 1 after other failures."""
    if try_watchdog and config is None:
        raise UsageError("--try-watchdog needs CONFIG: it tries the drives of a configuration")
    if warm:
        # imported here: the demo needs all that others do without
        from friction_hil.cli.work.demo import demo_progress
        from friction_hil.demo.demonstration import compile_demo

        with demo_progress() as show:
            compile_demo(show)
    out = console()
    findings = []
    for finding in examine(config, try_watchdog=try_watchdog):
        findings.append(finding)
        if not as_json:
            _print(out, finding)
    if as_json:
        print_json([asdict(finding) for finding in findings])
    else:
        _print_summary(findings)
    failed = {finding.check for finding in findings if finding.result == "fail"}
    return 2 if CONFIGURATION in failed else int(bool(failed))


def _print(out: Console, finding: Finding) -> None:
    """Print one finding at once, because the next check may take seconds."""
    code = f" [{finding.code}]" if finding.code else ""
    text = f"{finding.result}  {finding.check}: {finding.detail}{code}"
    # paths and commands stay in one piece: the terminal breaks what is too long
    wrapped = textwrap.fill(text, out.width, subsequent_indent=_INDENT, break_long_words=False, break_on_hyphens=False)
    shown = Text(wrapped)
    shown.stylize(_STYLES[finding.result], 0, len(finding.result))
    out.print(shown, soft_wrap=True)
    if finding.fix:
        fix = textwrap.fill(
            finding.fix,
            out.width,
            initial_indent=f"{_INDENT}fix: ",
            subsequent_indent=_INDENT,
            break_long_words=False,
            break_on_hyphens=False,
        )
        out.print(Text(fix), soft_wrap=True)


def _print_summary(findings: Sequence[Finding]) -> None:
    count = Counter(finding.result for finding in findings)
    click.echo(f"\n{count['pass']} passed, {count['warn']} with a warning, {count['fail']} failed")
