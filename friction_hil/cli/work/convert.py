"""The work of ``friction-hil convert``."""

import shlex
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np

from friction_hil import recordings
from friction_hil.checked_yaml.output import check_writable
from friction_hil.cli.output import print_json
from friction_hil.cli.work.tables import new_table, number, print_table, say
from friction_hil.errors import RecordingError, UsageError, choices
from friction_hil.numerics.readable import brief
from friction_hil.recordings import Recording
from friction_hil.recordings.columns import TIME, unit
from friction_hil.recordings.contradictions import contradictions, turned_torque, unsigned_register
from friction_hil.recordings.even import what_to_repair
from friction_hil.recordings.mapping import parse_source
from friction_hil.recordings.parts import only_recording
from friction_hil.recordings.quality import resolution, time_facts, without_overflow
from friction_hil.recordings.recording import CHANGE, Array, rename
from friction_hil.recordings.source import new_file
from friction_hil.recordings.suggestion import Suggestion, joint_options, suggest, unit_of

if TYPE_CHECKING:
    from friction_hil.recordings.columns import AxisKind

_SHOWN = {"us": "µs"}  # units that files spell in ASCII


def convert(
    *,
    source: Path,
    target: Path | None,
    info: bool,
    config: Path | None,
    force: bool,
    axis: str | None,
    as_json: bool,
    **options: Any,
) -> None:
    """Convert a recording or a model file, or print what is in a recording; ``options`` are those of `recordings`."""
    if info == (target is not None):
        raise click.UsageError("give OUT, or --info" if target is None else "--info writes nothing: leave OUT away")
    if target is not None and target.suffix.lower() == ".onnx":
        _write_onnx(source, target, force)
        return
    if target is not None:
        check_writable(target, "OUT ")
    source = only_recording(source)
    options["configuration"] = None
    if config is not None:
        from friction_hil.config import load  # imported here: a recording alone needs neither models nor numba

        options["configuration"] = load(config)
    if target is None:
        found = recordings.read_all(source, is_preview=True, **options)
        _print_info(source, found if axis is None else {axis: _chosen(source, found, axis)}, options, as_json)
        return
    found = recordings.read_all(source, **options) if axis is None else {axis: recordings.read(source, axis, **options)}
    files = _targets(source, target, list(found), force)
    _write(found, files, force)
    for name, recording in found.items():
        for problem in recording.problems:
            say(f"{recording.path}: {name}: {problem}")
    written = [str(file) for file in files.values()]
    if as_json:
        print_json({"written": written, "rows": {name: len(recording) for name, recording in found.items()}})
    else:
        for path, recording in zip(written, found.values(), strict=True):
            click.echo(f"{path}: {len(recording)} rows of {len(recording.columns)} columns")
        if target.suffix.lower() == ".mcap":
            say(f"next: {shlex.join(['friction-hil', 'identify', written[0]])}", stderr=False)


def _targets(source: Path, target: Path, axes: list[str], force: bool) -> dict[str, Path]:
    """Return the file of each axis.

    Raises `click.UsageError`: MCAP to MCAP, or several axes to one MCAP file; `RecordingError`: a file exists and
    ``force`` is not given; nothing is written then.
    """
    if source.suffix.lower() == target.suffix.lower() == ".mcap":
        raise click.UsageError(f"{source} is MCAP already; a copy would lose its metadata and restart points")
    if len(axes) > 1 and target.suffix.lower() == ".mcap":
        raise click.UsageError(f"{target} would hold one axis; choose it with --axis")
    files = {name: target if len(axes) == 1 else target.with_stem(f"{target.stem}_{name}") for name in axes}
    for file in () if force else files.values():
        if file.exists():
            raise RecordingError(f"{file} exists already; --force replaces it")
    return files


def _write(found: dict[str, Recording], files: dict[str, Path], force: bool) -> None:
    """Write a file for each axis; if one cannot be written, those that did not exist before are removed again."""
    written: list[Path] = []
    try:
        for name, recording in found.items():
            is_new = not files[name].exists()
            recordings.write(files[name], recording, overwrite=force)
            if is_new:
                written.append(files[name])
    except BaseException:
        for file in written:
            file.unlink(missing_ok=True)
        raise


def _write_onnx(source: Path, target: Path, force: bool) -> None:
    from friction_hil import models  # imported here: a recording needs no models
    from friction_hil.models import onnx_file

    model = models.load(source)
    if target.exists() and not force:
        raise UsageError(f"{target} exists already; --force replaces it")
    with new_file(target, overwrite=force) as part:
        onnx_file.write(model, part)


def _chosen(source: Path, found: dict[str, Recording], axis: str) -> Recording:
    """Return one axis; the only one of a table has any name that it is given."""
    if axis not in found and len(found) > 1:
        raise UsageError(f"{source} has no axis {axis!r}; {choices(axis, found)}")
    return found.get(axis) or next(iter(found.values()))


def _print_info(source: Path, found: dict[str, Recording], options: dict[str, Any], as_json: bool) -> None:
    axes = {name: _facts(source, recording, options, len(found) > 1) for name, recording in found.items()}
    if as_json:
        print_json({"path": str(source), "axes": axes})
        return
    for name, facts in axes.items():
        print_axis(name, facts)
        for problem in facts["problems"]:
            say(f"{source}: {name}: {problem}")
        for note in facts["suggestion"]["notes"]:
            say(note)
        if facts["suggestion"]["command"]:
            say(f"next: {facts['suggestion']['command']}", stderr=False)
    if len(axes) > 1:
        command = f"friction-hil identify {shlex.quote(str(source))} --joints all"
        say(f"all axes at once: {command}, those of an arm with --urdf FILE", stderr=False)


def _facts(source: Path, recording: Recording, options: dict[str, Any], is_one_of_several: bool) -> dict[str, Any]:
    found = suggest(recording)
    clock = _clock(recording, found)
    times = time_facts(clock)
    suspicious = [*what_to_repair(recording), *contradictions(recording)] if TIME in recording.columns else []
    suspicious += [text] if (text := turned_torque(recording)) else []
    registers = [unsigned_register([recording], name) for name in ("torque", "velocity") if name in recording]
    return {
        "rows": len(recording),
        "duration_s": float(clock[-1] - clock[0]) if len(clock) else None,
        "rate_hz": 1.0 / times.period_s if times.period_s > 0.0 else None,
        "jitter_s": times.jitter_s,
        "gaps": len(times.gaps),
        "longest_gap_s": times.longest_gap_s,
        "columns": _column_facts(recording),
        "events": [{"cycle": event.cycle, "name": event.name, "text": event.text} for event in recording.events],
        "restart_points": len(recording.restarts),
        "metadata": sorted(recording.metadata),
        "problems": [*recording.problems, *suspicious, *filter(None, registers)],
        "suggestion": {
            "columns": found.columns,
            "notes": found.notes,
            "command": _command(source, recording, found, options, is_one_of_several),
        },
    }


def _clock(recording: Recording, found: Suggestion) -> Array:
    """Return the time stamps, or what would be them by the suggestion, s; empty if nothing is known of them."""
    if TIME in recording.columns:
        return recording.columns[TIME]
    given = {name: source for name, source in found.columns.items() if name == TIME}
    if given:
        looked_at = replace(recording, columns=dict(recording.columns), units=dict(recording.units), problems=[])
        source, factor = parse_source(given[TIME])
        rename(looked_at, {TIME: source}, {} if factor == 1.0 else {TIME: factor})
        values = looked_at.columns[TIME]
        return values[np.isfinite(values)]
    return np.arange(len(recording)) / found.rate_hz if found.rate_hz else np.empty(0)


def _command(
    source: Path, recording: Recording, found: Suggestion, options: dict[str, Any], is_one_of_several: bool
) -> str:
    """Return the command that would read the file; empty for a recording of the daemon."""
    if "configuration" in recording.metadata or options.get("configuration") is not None:
        return ""
    words = ["friction-hil", "identify", str(source), *(["--axis", recording.axis] if is_one_of_several else [])]
    for name, given in (options.get("columns") or {}).items():
        factor = (options.get("scale") or {}).get(name)
        words += ["--column", f"{name}={given}" + ("" if factor is None else f"*{factor:.10g}")]
    for name, factor in (options.get("scale") or {}).items():
        if name not in (options.get("columns") or {}):
            words += ["--scale", f"{name}={factor:.10g}"]
    if options.get("rate_hz") is not None:
        words += ["--rate", f"{options['rate_hz']:.10g}"]
    names = {*recording.columns, *recording.others, *found.columns}
    if {"velocity", "torque"} <= names and not {TIME, "position"} & names and found.rate_hz is None:
        words.append("--static")  # points of a map have no time
    joints = [] if is_one_of_several or found.rate_hz is not None else joint_options(found.columns, names)
    return shlex.join([*words, *(joints or found.options)])


def _column_facts(recording: Recording) -> dict[str, dict[str, Any]]:
    kinds = _kinds(recording)
    facts = {}
    for name, all_values in recording.columns.items():
        values = without_overflow(all_values)
        finite = values[np.isfinite(values)]
        expected = " or ".join(dict.fromkeys(filter(None, (unit(name, kind) for kind in kinds))))
        facts[name] = {
            "unit": unit_of(recording, name) or expected,
            "values": int(finite.size),
            "min": float(finite.min()) if finite.size else None,
            "max": float(finite.max()) if finite.size else None,
            "step": resolution(values),
        }
        if name in recording.labels:
            facts[name]["label"] = recording.labels[name]
    return facts


def _kinds(recording: Recording) -> "tuple[AxisKind, ...]":
    """Return the kind of the axis if the recording carries the daemon's configuration, else both kinds."""
    kind = recording.axis_kind
    return ("rotary", "linear") if kind is None else (kind,)


def print_axis(name: str, facts: dict[str, Any]) -> None:
    """Print what one axis of a recording has."""
    rate = f" at {facts['rate_hz']:.6g} Hz" if facts["rate_hz"] else ""
    duration = "no time stamps" if facts["duration_s"] is None else f"{facts['duration_s']:.6g} s"
    click.echo(f"{name}: {facts['rows']} rows, {duration}{rate}")
    gaps = f", {facts['gaps']} gaps up to {facts['longest_gap_s']:.6g} s" if facts["gaps"] else ""
    if facts["jitter_s"] > 0.0 or gaps:
        click.echo(f"time stamps deviate by up to {facts['jitter_s']:.3g} s{gaps}")
    has_labels = any("label" in fact for fact in facts["columns"].values())
    label = ["in the file"] if has_labels else []
    table = new_table("column", *label, "unit", *map(number, ("values", "min", "max", "step")))
    for column, fact in facts["columns"].items():
        low, high, step = ("" if fact[key] is None else brief(fact[key], 4) for key in ("min", "max", "step"))
        said = [fact.get("label", "")] if has_labels else []
        table.add_row(column, *said, _SHOWN.get(fact["unit"], fact["unit"]), str(fact["values"]), low, high, step)
    print_table(table)
    if facts["metadata"]:
        click.echo(f"{facts['restart_points']} restart points; metadata: {', '.join(facts['metadata'])}")
    for event in facts["events"]:
        if event["name"] == CHANGE:
            continue
        click.echo(f"cycle {event['cycle']:.0f}: {event['name']}: {event['text']}")
