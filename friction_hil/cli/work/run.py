"""The work of ``friction-hil run``."""

import math
import sys
from contextlib import ExitStack
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from friction_hil.cli.colour import echo_labelled, yellow
from friction_hil.cli.output import print_json
from friction_hil.cli.work.following import Compared, following_table
from friction_hil.cli.work.tables import print_table, say
from friction_hil.config import load, located, missing_models
from friction_hil.daemon import learning_words
from friction_hil.daemon.control.lock import control_socket
from friction_hil.daemon.control.names import default_name
from friction_hil.daemon.simulated_drives import hint_at_simulated_time, simulated_drives
from friction_hil.daemon.stop import stop_on_signals
from friction_hil.errors import OptionError
from friction_hil.interrupts import Interrupted

if TYPE_CHECKING:
    from friction_hil.config import AxisConfig, Configuration
    from friction_hil.daemon.figures import AxisFigures, ConditionFigures
    from friction_hil.daemon.session import SessionResult

_BASELINE_S = 4.0  # least duration of steady motion that is suggested
_BASELINE_PERIODS = 2
_SHOWN_REASONS = 3


def run(
    *,
    config: Path,
    duration: float | None,
    record: Path | None,
    force: bool,
    dry_run: bool,
    simulate: bool,
    reset_fault: bool,
    pace: str,
    name: str | None,
    group: str | None,
    wait: bool,
    as_json: bool,
) -> int:
    """Run the daemon and print a summary; return 1 after a fault, a lost row, or what was not restored."""
    if duration is not None and not (math.isfinite(duration) and duration > 0.0):
        raise click.BadParameter("must be a number of seconds above zero", param_hint="--duration")
    if force and record is None:
        raise click.UsageError("--force goes with --record FILE")
    if wait and dry_run:
        raise click.UsageError("--wait and --dry-run exclude each other: a dry run enables nothing")
    configuration = load(config, needs_models=not (dry_run or simulate))
    for note in missing_models(config, configuration) if dry_run or simulate else ():
        say(f"note: {note}; until then its friction counts as zero")
    for axis_name, axis in configuration.axes.items():
        if axis.model.is_of_other_axis:
            say(f"note: {axis_name}: the model is {axis.model.is_of_other_axis}: 'tune' identifies that of this axis")
    with stop_on_signals() as stop, ExitStack() as stack:
        # a simulation or a dry run beside another one moves nothing: it takes the next free name
        control = control_socket(
            name or default_name(config), group, is_next_taken=name is None and (simulate or dry_run)
        )
        stack.callback(control.close)
        if control.path.stem != (name or default_name(config)):
            say(f"note: another daemon has the name of the configuration; this one is called {control.path.stem}")
        if simulate:
            drives = simulated_drives(configuration, pace, say, lambda: stop.is_requested)
            configuration = stack.enter_context(drives)
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
            is_waiting=wait,
            control=control,
        )
        try:
            result = run_session(configuration, settings, stop, say)
        except OptionError as error:
            raise located(config, error) from None
        except Interrupted as error:
            click.echo(f"stopped ({error}) before anything was enabled", err=True)
            raise
        if simulate and result.loop.faults:
            hint_at_simulated_time(configuration, pace, say)
    if as_json:
        print_json(_summary(result))
    else:
        is_cut = stop.is_by_user or bool(result.loop.faults)
        _print(result, configuration, dry_run=dry_run, is_real=pace == "real", is_cut=is_cut)
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
        "not_restored": result.loop.leftovers,
        "drive_states": dict(zip(result.axes, (state.words for state in result.loop.drive_states), strict=False)),
        "axes": {name: _axis_summary(figures) for name, figures in result.axes.items()},
        "recording": paths[0] if paths else None,
        "recordings": paths,
        "black_boxes": result.report.black_boxes if result.report else (),
        "learning": result.learning,
    }


def _axis_summary(figures: "AxisFigures") -> dict[str, Any]:
    main = figures.compensated or figures.without
    return {
        "rms": None if main is None else main.rms,
        "peak": None if main is None else main.peak,
        "unit": figures.unit,
        "baseline": _condition(figures.without),
        "compensated": _condition(figures.compensated),
        "reduction": None if figures.reduction is None else asdict(figures.reduction),
        "taken_back": figures.taken_back or None,
        "setpoint_delay_cycles": {"configured": figures.configured_delay, "fitted": figures.delay},
        "stale": figures.stale,
        "bridged": figures.bridged,
        "bridged_reasons": figures.bridged_reasons,
        **({} if figures.load is None else {"load": _axis_summary(figures.load)}),
    }


def _condition(figures: "ConditionFigures | None") -> dict[str, Any] | None:
    return None if figures is None else asdict(figures)


def _report_problems(result: "SessionResult") -> int:
    """Print problems of the recording, warnings and faults on stderr; return the exit status."""
    report = result.report
    for problem in report.problems if report else ():
        echo_labelled("recording:", problem, yellow)
    is_incomplete = bool(report and (report.lost or report.pending) and report.recording)
    if report and is_incomplete and report.lost:
        total = report.rows + report.lost + report.pending
        echo_labelled("recording:", f"{report.lost} of {total} rows were lost")
    for notice in result.loop.notices:
        say(f"notice: {notice}")
    for warning in result.loop.warnings:
        echo_labelled("warning:", warning, yellow)
    for fault in result.loop.faults:
        echo_labelled("fault:", fault)
    for path in report.black_boxes if report else ():
        echo_labelled("black box:", f"the minute before the fault is in {path}")
    return 1 if result.loop.faults or result.loop.leftovers or is_incomplete else 0


def _print(
    result: "SessionResult", configuration: "Configuration", *, dry_run: bool, is_real: bool, is_cut: bool
) -> None:
    loop, timing = result.loop, "in simulated time"
    if is_real:
        late = f"late p50 {loop.late_p50_us:.0f} µs, p99 {loop.late_p99_us:.0f} µs; " if loop.cycles else ""
        timing = f"{late}{loop.missed} missed"
    click.echo(f"{loop.cycles} cycles of {configuration.period_s * 1e3:g} ms; {timing}")
    if not dry_run:
        _print_errors(result.axes, configuration, is_cut=is_cut)
    for name, figures in result.axes.items():
        if figures.bridged:
            was = "cycle without usable feedback was" if figures.bridged == 1 else "cycles without usable feedback were"
            click.echo(f"{name}: {figures.bridged} {was} bridged")
            for reason, count in sorted(figures.bridged_reasons.items(), key=lambda item: -item[1])[:_SHOWN_REASONS]:
                say(f"   {count} of them: {reason}", stderr=False)
    for name, learned in result.learning.get("axes", {}).items():
        say(learning_words.last_line(name, learned), stderr=False)
    paths = result.report.recording if result.report else ()
    for path in paths:
        click.echo(f"recorded: {path}")
    if paths and not dry_run:
        click.echo(f"next: friction-hil plot {paths[0]} --output run.html")


def _print_errors(axes: "dict[str, AxisFigures]", configuration: "Configuration", *, is_cut: bool) -> None:
    """Print the following error without and with compensation, and why one of them is missing."""
    shown = {}
    for name, figures in axes.items():
        shown[name] = figures
        if figures.load is not None:
            shown[f"{name}, load"] = figures.load
    rows = [
        Compared((name,), each.unit, each.without, each.compensated, each.reduction)
        for name, each in shown.items()
        if each.without is not None or each.compensated is not None
    ]
    if rows:
        print_table(following_table(("axis",), rows))
    for name, figures in axes.items():
        counted = [each for each in (figures.without, figures.compensated) if each is not None]
        if left_out := sum(each.left_out for each in counted):
            of = left_out + sum(each.counted for each in counted)
            reason = "a period was missed or feedback was late"
            say(f"{name}: {left_out} of {of} cycles are left out: {reason}", stderr=False)
        if math.isfinite(figures.delay):
            say(f"{name}: {_delay_text(figures)}", stderr=False)
        if hint := _hint(figures, configuration.axes[name], is_cut=is_cut):
            say(f"{name}: {hint}", stderr=False)


def _delay_text(figures: "AxisFigures") -> str:
    """Say which delay of the set-points the following error fits."""
    whole, _, part = f"{figures.delay:.2f}".partition(".")
    fit = f"{whole}.{part.rstrip('0') or '0'}"
    return (
        f"the set-points arrive {fit} periods late (setpoint_delay_cycles is {figures.configured_delay:g}): the "
        f"following error grows with the speed. Set setpoint_delay_cycles: {fit}; the figures above leave this out"
    )


def _hint(figures: "AxisFigures", axis: "AxisConfig", *, is_cut: bool = False) -> str:
    """Say how to get what a comparison lacks; nothing if it is complete, or the axis has no set-point.

    No longer run is advised where a fault or the user ended this one.
    """
    from friction_hil.daemon.figures import SETTLE_S  # imported here: with the daemon

    given, trajectory = axis.compensation, axis.trajectory
    if trajectory.kind == "none" or figures.reduction is not None:
        return ""
    advice = "the run was cut short" if is_cut else "take a longer --duration"
    partial = [each for each in (figures.without, figures.compensated) if each is not None and not each.is_whole]
    if partial:
        which = "with compensation" if partial[-1] is figures.compensated else "without compensation"
        return f"the figures {which} cover less than a period of the motion, so they do not compare: {advice}"
    if figures.without is not None and figures.compensated is not None:
        return f"a motion of kind {trajectory.kind} does not repeat itself, so that the two do not compare"
    if figures.lacks_demand:
        return f"no position demand in {axis.mode}: no following error can be given"
    if figures.without is None and figures.compensated is None:
        return f"nothing to compare: the run ended before the motion was steady, {SETTLE_S:g} s after its ramp"
    if not given.enabled:
        return "compensation.enabled is false: nothing was compensated"
    if figures.compensated is None:
        return f"the run ended before it was compensated long enough to compare: {advice}"
    ramp_s, period_s = getattr(trajectory, "ramp_s", 0.0), 1.0 / getattr(trajectory, "frequency", math.inf)
    enough_s = math.ceil(ramp_s + SETTLE_S + max(_BASELINE_S, _BASELINE_PERIODS * period_s))
    return f"compensation: {{baseline_s: {enough_s}}} makes the first {enough_s} s a comparison without compensation"
