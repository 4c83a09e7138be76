"""The work of ``friction-hil run``."""

import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from friction_hil.cli.output import print_json
from friction_hil.config import load, located, missing_models
from friction_hil.daemon.stop import stop_on_signals
from friction_hil.errors import OptionError
from friction_hil.interrupts import Interrupted

if TYPE_CHECKING:
    from friction_hil.daemon.session import SessionResult

_SHOWN_REASONS = 3


def run(
    *,
    config: Path,
    duration: float | None,
    record: Path | None,
    force: bool,
    dry_run: bool,
    reset_fault: bool,
    pace: str,
    as_json: bool,
) -> int:
    """Run the daemon and print a summary; return 1 after a fault, or if rows of the recording were lost."""
    if duration is not None and not (math.isfinite(duration) and duration > 0.0):
        raise click.BadParameter("must be a number of seconds above zero", param_hint="--duration")
    if force and record is None:
        raise click.UsageError("--force goes with --record FILE")
    configuration = load(config, needs_models=not dry_run)
    for note in missing_models(config, configuration) if dry_run else ():
        click.echo(f"note: {note}; until then its friction counts as zero", err=True)
    with stop_on_signals() as stop:
        with stop.raised():  # imported here: compiling takes a minute, and --help must not wait for it
            from friction_hil.daemon.session import SessionSettings, run_session

        settings = SessionSettings(
            duration_s=math.inf if duration is None else duration,
            record=record,
            is_overwrite_allowed=force,
            dry_run=dry_run,
            is_fault_reset_wanted=reset_fault,
            is_paced_by_sync=pace == "sync",
            is_status_shown=not as_json and sys.stderr.isatty(),
        )
        try:
            result = run_session(configuration, settings, stop, lambda line: click.echo(line, err=True))
        except OptionError as error:
            raise located(config, error) from None
        except Interrupted as error:
            click.echo(f"stopped ({error}) before anything was enabled", err=True)
            raise
    if as_json:
        print_json(_summary(result))
    else:
        _print(result, configuration.period_s, dry_run)
    return _report_problems(result)


def _summary(result: "SessionResult") -> dict[str, Any]:
    paths = result.report.recording if result.report else ()
    return {
        "cycles": result.loop.cycles,
        "late_p50_us": result.loop.late_p50_us,
        "late_p99_us": result.loop.late_p99_us,
        "missed": result.loop.missed,
        "faults": result.loop.faults,
        "warnings": result.loop.warnings,
        "notices": result.loop.notices,
        "drive_states": dict(zip(result.axes, (state.words for state in result.loop.drive_states), strict=False)),
        "axes": result.axes,
        "recording": paths[0] if paths else None,
        "recordings": paths,
    }


def _report_problems(result: "SessionResult") -> int:
    """Print problems of the recording, warnings and faults on stderr; return the exit status."""
    report = result.report
    for problem in report.problems if report else ():
        click.echo(f"recording: {problem}", err=True)
    is_incomplete = bool(report and (report.lost or report.pending) and report.recording)
    if report and is_incomplete and report.lost:
        total = report.rows + report.lost + report.pending
        click.echo(f"recording: {report.lost} of {total} rows were lost", err=True)
    for notice in result.loop.notices:
        click.echo(f"notice: {notice}", err=True)
    for warning in result.loop.warnings:
        click.echo(f"warning: {warning}", err=True)
    for fault in result.loop.faults:
        click.echo(f"fault: {fault}", err=True)
    return 1 if result.loop.faults or is_incomplete else 0


def _print(result: "SessionResult", period_s: float, dry_run: bool) -> None:
    loop, late = result.loop, ""
    if loop.cycles:
        late = f"late p50 {loop.late_p50_us:.0f} us, p99 {loop.late_p99_us:.0f} us; "
    click.echo(f"{loop.cycles} cycles of {period_s * 1e3:g} ms; {late}{loop.missed} missed")
    for name, error in result.axes.items():
        if not dry_run and math.isfinite(error["rms"]):
            click.echo(f"{name}: following error {error['rms']:.3g} rms, {error['peak']:.3g} peak")
        if not dry_run and math.isfinite(error.get("baseline_rms", math.nan)):
            rms, peak = error["baseline_rms"], error["baseline_peak"]
            click.echo(f"{name}: without compensation {rms:.3g} rms, {peak:.3g} peak")
        if error["bridged"]:
            click.echo(f"{name}: {error['bridged']} cycles without usable feedback were bridged")
            for reason, count in sorted(error["bridged_reasons"].items(), key=lambda item: -item[1])[:_SHOWN_REASONS]:
                click.echo(f"   {count} of them: {reason}")
    for path in result.report.recording if result.report else ():
        click.echo(f"recorded: {path}")
