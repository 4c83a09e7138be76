"""``friction-hil run``: the daemon."""

import math
import sys
from pathlib import Path
from typing import Any

import click

from friction_hil.cli.output import option_json, print_json


@click.command("run")
@click.argument("config", type=click.Path(path_type=Path))
@click.option("--duration", type=float, metavar="S", help="Come to rest after S seconds of motion.")
@click.option("--record", type=click.Path(path_type=Path), metavar="FILE", help="Record to FILE (.mcap).")
@click.option("--force", is_flag=True, help="Overwrite FILE if it exists.")
@click.option("--dry-run", is_flag=True, help="Listen, compute, record; never write a controlword, target or offset.")
@click.option("--reset-fault", is_flag=True, help="Leave a drive's fault before enabling it.")
@click.option(
    "--pace",
    type=click.Choice(["real", "sync"]),
    default="real",
    show_default=True,
    help="sync: as fast as simulated drives that run with --pace sync answer.",
)
@option_json
def command(
    config: Path,
    duration: float | None,
    record: Path | None,
    force: bool,
    dry_run: bool,
    reset_fault: bool,
    pace: str,
    as_json: bool,
) -> int:
    """Run the daemon against the drives of CONFIG.

    Moves the axes along their trajectories and takes the friction out. Ctrl-C brings them to rest, fades the
    compensation and disables the drives; so does every fault. Exit status 1 tells of a fault.
    """
    if duration is not None and not (math.isfinite(duration) and duration > 0.0):
        raise click.BadParameter("must be a number of seconds above zero", param_hint="--duration")
    if force and record is None:
        raise click.UsageError("--force goes with --record FILE")

    from friction_hil.config import load, located
    from friction_hil.daemon.stop import stop_on_signals
    from friction_hil.errors import OptionError

    configuration = load(config)
    # Before anything else is loaded: a signal during the start must not leave a half-configured drive either.
    with stop_on_signals() as stop:
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
    report = result.report
    paths = report.recording if report else ()
    summary: dict[str, Any] = {
        "cycles": result.loop.cycles,
        "late_p50_us": result.loop.late_p50_us,
        "late_p99_us": result.loop.late_p99_us,
        "missed": result.loop.missed,
        "faults": result.loop.faults,
        "warnings": result.loop.warnings,
        "axes": result.axes,
        "recording": paths[0] if paths else None,
    }
    if as_json:
        print_json(summary)
    else:
        _print(summary, configuration.period_s, dry_run)
        for path in paths:
            click.echo(f"recorded: {path}")
    for problem in report.problems if report else ():
        click.echo(f"recording: {problem}", err=True)
    is_incomplete = bool(report and report.lost and paths)
    if report and is_incomplete:
        click.echo(f"recording: {report.lost} of {report.rows + report.lost} rows were lost", err=True)
    for warning in result.loop.warnings:
        click.echo(f"warning: {warning}", err=True)
    for fault in result.loop.faults:
        click.echo(f"fault: {fault}", err=True)
    return 1 if result.loop.faults or is_incomplete else 0


def _print(summary: dict[str, Any], period_s: float, dry_run: bool) -> None:
    """Tell a person what the run was like."""
    late = ""
    if summary["cycles"]:
        late = f"late p50 {summary['late_p50_us']:.0f} us, p99 {summary['late_p99_us']:.0f} us; "
    click.echo(f"{summary['cycles']} cycles of {period_s * 1e3:g} ms; {late}{summary['missed']} missed")
    for name, error in summary["axes"].items():
        if not dry_run and math.isfinite(error["rms"]):
            click.echo(f"{name}: following error {error['rms']:.3g} rms, {error['peak']:.3g} peak")
        if error["stale"]:
            click.echo(f"{name}: {error['stale']} cycles without usable feedback were bridged")
