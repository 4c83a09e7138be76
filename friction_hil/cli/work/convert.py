"""The work of ``friction-hil convert``."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np

from friction_hil import models, recordings
from friction_hil.cli.output import print_json
from friction_hil.cli.work.tables import new_table, number, print_table, say
from friction_hil.config import load
from friction_hil.errors import RecordingError, UsageError
from friction_hil.models import onnx_file
from friction_hil.numerics.readable import brief
from friction_hil.recordings import Recording
from friction_hil.recordings.columns import TIME, unit
from friction_hil.recordings.even import what_to_repair
from friction_hil.recordings.parts import only_recording
from friction_hil.recordings.quality import resolution, time_facts, without_overflow
from friction_hil.recordings.recording import CHANGE
from friction_hil.recordings.source import new_file

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
    source = only_recording(source)
    options["configuration"] = None if config is None else load(config)
    found = recordings.read_all(source, **options) if axis is None else {axis: recordings.read(source, axis, **options)}
    if target is None:
        _print_info(source, found, as_json)
        return
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


def _targets(source: Path, target: Path, axes: list[str], force: bool) -> dict[str, Path]:
    """Return the file of each axis.

    Raises
    ------
    click.UsageError
        MCAP to MCAP, or several axes to one MCAP file.
    RecordingError
        A file exists and ``force`` is not given; nothing is written then.
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
    model = models.load(source)
    if target.exists() and not force:
        raise UsageError(f"{target} exists already; --force replaces it")
    with new_file(target, overwrite=force) as part:
        onnx_file.write(model, part)


def _print_info(source: Path, found: dict[str, Recording], as_json: bool) -> None:
    axes = {name: _facts(recording) for name, recording in found.items()}
    if as_json:
        print_json({"path": str(source), "axes": axes})
        return
    for name, facts in axes.items():
        _print(name, facts)
        for problem in facts["problems"]:
            say(f"{source}: {name}: {problem}")


def _facts(recording: Recording) -> dict[str, Any]:
    times = time_facts(recording.columns[TIME])
    return {
        "rows": len(recording),
        "duration_s": recording.duration_s,
        "rate_hz": 1.0 / times.period_s if times.period_s > 0.0 else None,
        "jitter_s": times.jitter_s,
        "gaps": len(times.gaps),
        "longest_gap_s": times.longest_gap_s,
        "columns": _column_facts(recording),
        "events": [{"cycle": event.cycle, "name": event.name, "text": event.text} for event in recording.events],
        "restart_points": len(recording.restarts),
        "metadata": sorted(recording.metadata),
        "problems": [*recording.problems, *what_to_repair(recording)],
    }


def _column_facts(recording: Recording) -> dict[str, dict[str, Any]]:
    kinds = _kinds(recording)
    facts = {}
    for name, all_values in recording.columns.items():
        values = without_overflow(all_values)
        finite = values[np.isfinite(values)]
        expected = " or ".join(dict.fromkeys(filter(None, (unit(name, kind) for kind in kinds))))
        facts[name] = {
            "unit": recording.units.get(name, expected),
            "values": int(finite.size),
            "min": float(finite.min()) if finite.size else None,
            "max": float(finite.max()) if finite.size else None,
            "step": resolution(values),
        }
    return facts


def _kinds(recording: Recording) -> "tuple[AxisKind, ...]":
    """Return the kind of the axis if the recording carries the daemon's configuration, else both kinds."""
    kind = recording.axis_kind
    return ("rotary", "linear") if kind is None else (kind,)


def _print(name: str, facts: dict[str, Any]) -> None:
    rate = f" at {facts['rate_hz']:.6g} Hz" if facts["rate_hz"] else ""
    click.echo(f"{name}: {facts['rows']} rows, {facts['duration_s']:.6g} s{rate}")
    gaps = f", {facts['gaps']} gaps up to {facts['longest_gap_s']:.6g} s" if facts["gaps"] else ""
    if facts["jitter_s"] > 0.0 or gaps:
        click.echo(f"time stamps deviate by up to {facts['jitter_s']:.3g} s{gaps}")
    table = new_table("column", "unit", *map(number, ("values", "min", "max", "step")))
    for column, fact in facts["columns"].items():
        low, high, step = ("" if fact[key] is None else brief(fact[key], 4) for key in ("min", "max", "step"))
        table.add_row(column, _SHOWN.get(fact["unit"], fact["unit"]), str(fact["values"]), low, high, step)
    print_table(table)
    if facts["metadata"]:
        click.echo(f"{facts['restart_points']} restart points; metadata: {', '.join(facts['metadata'])}")
    for event in facts["events"]:
        if event["name"] == CHANGE:
            continue
        click.echo(f"cycle {event['cycle']:.0f}: {event['name']}: {event['text']}")
