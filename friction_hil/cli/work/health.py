"""The work of ``friction-hil health``."""

import os
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from datetime import datetime
from pathlib import Path
from typing import Any

import click

from friction_hil import recordings
from friction_hil.cli.output import print_json
from friction_hil.cli.work.progress import status_line
from friction_hil.cli.work.result_files import check_result_files
from friction_hil.cli.work.tables import new_table, number, print_files, print_table, prose, say
from friction_hil.daemon.companion import state_folder
from friction_hil.daemon.control.names import is_name
from friction_hil.errors import FrictionHilError, RecordingError, UsageError
from friction_hil.health import Health, Verdict, judge, observe, thresholds
from friction_hil.health.history import History, load, state_of
from friction_hil.health.metrics import metrics_text
from friction_hil.health.observe import COLUMNS, by_axis
from friction_hil.numerics.readable import brief, named_constants
from friction_hil.recordings.given import expanded
from friction_hil.recordings.json_lines import append
from friction_hil.recordings.parts import is_of_fault, parts_of, started_s
from friction_hil.reports.health_report import write_report

CHANGED, NOT_JUDGED = 3, 1  # exit status
_SERVICES = Path("/var/lib/friction-hil")
_SHOWN_LINES = 5


def show_health(
    *,
    sources: Sequence[str],
    fingerprint: bool,
    simulate: bool,
    pace: str,
    reset_fault: bool,
    yes: bool,
    axis: str | None,
    columns: dict[str, str],
    scale: dict[str, float],
    where: str | None,
    rate_hz: float | None,
    is_linear: bool,
    orders: tuple[float, ...],
    window_s: float,
    baseline: int,
    since: datetime | None,
    false_alarms: float,
    history: Path | None,
    report: Path | None,
    metrics: Path | None,
    as_json: bool,
) -> int:
    """Observe recordings that are new, judge all, and print the result; return the exit status."""
    check_result_files(None, report)
    moved: dict[Path, str] = {}
    files: list[Path]
    own_history: Path | None
    if fingerprint:
        from friction_hil.cli.work.fingerprint import record_fingerprints  # imported here: others need no daemon

        config = _configuration(sources)
        moved, own_history = record_fingerprints(
            config, axis=axis, simulate=simulate, pace=pace, reset_fault=reset_fault, yes=yes
        )
        files = list(moved)
    elif simulate or reset_fault or yes or pace != "real":
        raise UsageError("--yes, --simulate, --reset-fault and --pace belong to --fingerprint")
    else:
        files, own_history = _files(sources)
    history = history or own_history
    known = History() if history is None else load(history)
    reading: dict[str, Any] = {"columns": columns, "scale": scale, "where": where, "rate_hz": rate_hz, "only": COLUMNS}
    settings = {"kind": "linear" if is_linear else "rotary", "orders": orders, "window_s": window_s}
    notes = _observe(files, known, history, reading, settings, axis, moved)
    if axis is not None and axis not in known.parts:
        raise UsageError(f"there is no axis {axis!r}; there are: {', '.join(known.parts) or 'none'}")
    least_s = since.timestamp() if since is not None else float("-inf")
    found = [
        judge(
            name,
            [each for each in known.observations(name) if each.time_s >= least_s],
            known.layouts[name],
            baseline=baseline,
            false_alarms=false_alarms,
        )
        for name in known.layouts
        if axis in (None, name)
    ]
    if report is not None:
        write_report(report, found, false_alarms)
    if metrics is not None:
        _replace(metrics, metrics_text(found))
    status = _status(found)
    if as_json:
        print_json(_as_dict(found, notes, false_alarms, status))
    else:
        for note in notes:
            say(note)
        _print(found, false_alarms)
        print_files({"history": history, "report": report, "metrics": metrics})
        if status == CHANGED and report is None:
            click.echo("next: the same with --report health.html, which draws each quantity over time")
    return status


def _configuration(sources: Sequence[str]) -> Path:
    """Return the configuration file whose axes are to be moved."""
    if len(sources) > 1 or Path(sources[0]).suffix not in (".yaml", ".yml"):
        raise UsageError("--fingerprint takes one configuration file, CONFIG.yaml, whose axes it moves")
    return Path(sources[0])


def _files(sources: Sequence[str]) -> tuple[list[Path], Path | None]:
    """Return the recordings that the command names, and the history of a service if it names one."""
    is_file = any(os.path.lexists(each) or Path(each).suffix.lower() in recordings.formats() for each in sources)
    if len(sources) == 1 and is_name(sources[0]) and not is_file:
        return _files_of_service(sources[0])
    files: list[Path] = []
    for source in sources:
        if Path(source).suffix in (".yaml", ".yml"):
            raise UsageError(f"{source} is no recording; with --fingerprint, the axes of a configuration are moved")
        if Path(source).is_dir():
            files += _in_folder(Path(source))
        else:
            files += [part for each in expanded([source]) for part in parts_of(Path(each))]
    if not files:
        raise UsageError(f"{', '.join(sources)}: there is no recording")
    return list(dict.fromkeys(files)), None


def _files_of_service(name: str) -> tuple[list[Path], Path]:
    folder, history = _SERVICES / name, state_folder() / "health" / f"{name}.jsonl"
    files = _in_folder(folder) if folder.is_dir() else []
    if not files and not history.exists():
        raise UsageError(
            f"there is no file {name!r}, and no service of this name has recordings in {folder}; name the recordings "
            "or their folder"
        )
    return files, history


def _in_folder(folder: Path) -> list[Path]:
    suffixes = recordings.formats()
    return sorted(
        path
        for path in folder.iterdir()
        if path.suffix.lower() in suffixes and path.is_file() and not is_of_fault(path)
    )


def _observe(
    files: Iterable[Path],
    known: History,
    history: Path | None,
    reading: dict[str, Any],
    settings: dict[str, Any],
    axis: str | None,
    moved: Mapping[Path, str],
) -> list[str]:
    """Add what new recordings show, the oldest first; return notes on them. ``moved``: the only axis that did so."""
    notes: list[str] = []
    started: dict[Path, tuple[float, str, str]] = {}
    for path in files:
        start, is_known = started_s(path)
        name, state = f"{path.name} {start:.3f}", state_of(path)
        if known.states.get(name) != state:
            started[path] = start, name, state
            if not (is_known or path in moved):  # a simulated one that was made just now is of now
                notes.append(f"{path}: the start is not recorded; the time of the last change of the file is taken")
    notes = _shortened(notes)
    problems: list[str] = []
    with status_line("reading") as show:
        for path, (start, name, state) in sorted(started.items(), key=lambda pair: pair[1]):
            show(path.name)
            try:
                several = recordings.read_all(path, is_alone=True, **reading)
                lines = []
                for own, recording in by_axis(path, several, axis).items():
                    if own != moved.get(path, own):
                        continue
                    layout = known.layouts.get(own)
                    found, made, why_not = observe(recording, started_s=start, layout=layout, **settings)
                    if layout is None and found:
                        lines.append(known.add_layout(own, made))
                    lines.append(known.add(name, state, own, found))
                    problems += why_not
            except RecordingError as error:
                problems.append(str(error))
                continue
            if history is not None:
                append(history, lines)
    return [*notes, *_shortened(problems)]


def _shortened(lines: list[str]) -> list[str]:
    more = len(lines) - _SHOWN_LINES
    return lines if more <= 0 else [*lines[:_SHOWN_LINES], f"... and {more} more like these"]


def _status(found: Sequence[Health]) -> int:
    if any(each.changed for each in found):
        return CHANGED
    return 0 if found and any(each.is_judged for each in found) else NOT_JUDGED


def _replace(path: Path, text: str) -> None:
    """Write a file as a whole: its reader never sees a part of it."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile("w", dir=path.parent, delete=False, encoding="utf-8") as file:
            file.write(text)
        os.chmod(file.name, 0o644)
        os.replace(file.name, path)
    except OSError as error:
        raise FrictionHilError(f"{path} cannot be written: {error.strerror}") from None


def _as_dict(found: Sequence[Health], notes: Sequence[str], false_alarms: float, status: int) -> dict[str, Any]:
    return {
        "state": {0: "unchanged", CHANGED: "changed"}.get(status, "not judged"),
        "false_alarms_per_axis_year": false_alarms,
        "notes": list(notes),
        "axes": {each.axis: _axis_as_dict(each) for each in found},
        "thresholds": named_constants(thresholds),
    }


def _axis_as_dict(health: Health) -> dict[str, Any]:
    return {
        "observations": health.count,
        "notes": health.notes,
        "layout": asdict(health.layout),
        "changed": [_sentence(each) for each in health.changed],
        "quantities": [
            {**asdict(each), "share": each.share, "values": each.values, "errors": each.errors, "times_s": each.times_s}
            for each in health.verdicts
        ],
    }


def _print(found: Sequence[Health], false_alarms: float) -> None:
    for health in found:
        click.echo()
        say(f"{health.axis}: {health.count} observations, {_headline(health, false_alarms)}", stderr=False)
        table = new_table(
            prose("quantity"), number("baseline"), number("error"), "unit", number("per K"), number("now"), "state"
        )
        for each in health.verdicts:
            if each.state == "not shown":
                continue
            now = brief(float(each.values[-1]), 4) if each.values.size else "-"
            slope = "-" if each.slope is None else f"{brief(each.slope, 2)} ± {brief(each.slope_error or 0.0, 2)}"
            base = "-" if each.baseline is None else brief(each.baseline, 4)
            error = "-" if each.baseline_error is None else brief(each.baseline_error, 2)
            state = f"{each.state}: {each.reason}" if each.reason else each.state
            table.add_row(each.label, base, error, each.unit, slope, now, state)
        print_table(table)
        for each in health.changed:
            say(f"! {_sentence(each)}", stderr=False)
        hidden: dict[str, list[str]] = {}
        for each in health.verdicts:
            if each.state == "not shown":
                hidden.setdefault(each.reason, []).append(each.label)
        for how, labels in hidden.items():
            say(f"- not shown by the motion: {'; '.join(labels)} ({how})", stderr=False)
        for note in health.notes:
            say(f"- {note}", stderr=False)


def _headline(health: Health, false_alarms: float) -> str:
    if health.changed:
        return f"{len(health.changed)} {'quantity has' if len(health.changed) == 1 else 'quantities have'} changed"
    if health.is_judged:
        return f"nothing has changed (at most {false_alarms:g} false alarms a year)"
    return "too few to judge"


def _sentence(verdict: Verdict) -> str:
    """Return what changed, since when and by how much."""
    since, alarm = (datetime.fromtimestamp(each or 0.0) for each in (verdict.since_s, verdict.alarm_s))
    share = "" if verdict.share is None else f" ({100.0 * verdict.share:+.0f} %)"
    size = f"{brief(abs(verdict.change), 3)} ± {brief(verdict.change_error, 2)} {verdict.unit}{share}"
    return (
        f"{verdict.label}: {'rose' if verdict.change > 0.0 else 'fell'} by {size} since {since:%Y-%m-%d %H:%M}; "
        f"alarm {alarm:%Y-%m-%d %H:%M}"
    )
