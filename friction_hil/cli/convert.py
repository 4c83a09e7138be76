"""``friction-hil convert``: recordings from one format to another, and what is in one."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from friction_hil.cli.output import console, option_json, print_json
from friction_hil.cli.recording_options import recording_options
from friction_hil.errors import RecordingError

if TYPE_CHECKING:
    from friction_hil.recordings import Recording
    from friction_hil.recordings.columns import AxisKind


@click.command("convert")
@click.argument("source", metavar="IN", type=click.Path(path_type=Path))
@click.argument("target", metavar="[OUT]", type=click.Path(path_type=Path), required=False)
@click.option("--info", is_flag=True, help="Say what is in IN; write nothing.")
@click.option("--force", is_flag=True, help="Overwrite OUT if it exists.")
@recording_options
@option_json
def command(
    source: Path,
    target: Path | None,
    info: bool,
    force: bool,
    axis: str | None,
    columns: dict[str, str],
    scale: dict[str, float],
    as_json: bool,
) -> None:
    """Convert the recording IN to OUT, by their suffixes.

    Reads .mcap, .csv (a header of names) and .mat (MATLAB 5); writes .csv and .mcap. Values are kept bit for
    bit. From an MCAP recording of several axes each is written to a CSV file of its own, OUT_x.csv; --axis
    takes one. Metadata, events and restart points stay behind.
    """
    if info == (target is not None):
        raise click.UsageError("give OUT, or --info" if target is None else "--info writes nothing: leave OUT away")

    from friction_hil import recordings

    if axis is None:
        found = recordings.read_all(source, columns=columns, scale=scale)
    else:
        found = {axis: recordings.read(source, axis, columns=columns, scale=scale)}
    if target is None:
        _tell(source, found, as_json)
        return
    if source.suffix.lower() == target.suffix.lower() == ".mcap":
        raise click.UsageError(f"{source} is MCAP already; a copy would lose its metadata and restart points")
    if len(found) > 1 and target.suffix.lower() == ".mcap":
        raise click.UsageError(f"{target} would take one axis; choose it with --axis")
    files = {name: target if len(found) == 1 else target.with_stem(f"{target.stem}_{name}") for name in found}
    for file in () if force else files.values():
        if file.exists():  # before the first is written: all or none
            raise RecordingError(f"{file} exists already; --force replaces it")
    for name, recording in found.items():
        recordings.write(files[name], recording, overwrite=force)
    written = [str(file) for file in files.values()]
    _warn(found)
    if as_json:
        print_json({"written": written, "rows": {name: len(recording) for name, recording in found.items()}})
    else:
        for path, recording in zip(written, found.values(), strict=True):
            click.echo(f"{path}: {len(recording)} rows of {len(recording.columns)} columns")


def _warn(found: "dict[str, Recording]") -> None:
    for name, recording in found.items():
        for problem in recording.problems:
            click.echo(f"{recording.path}: {name}: {problem}", err=True)


def _tell(source: Path, found: "dict[str, Recording]", as_json: bool) -> None:
    axes = {name: _facts(recording) for name, recording in found.items()}
    if as_json:
        print_json({"path": str(source), "axes": axes})
        return
    for name, facts in axes.items():
        _print(name, facts)
    _warn(found)


def _facts(recording: "Recording") -> dict[str, Any]:
    import numpy as np

    from friction_hil.recordings.columns import unit

    kinds = _kinds(recording)
    facts = {}
    for name, values in recording.columns.items():
        finite = values[np.isfinite(values)]
        facts[name] = {
            "unit": " or ".join(dict.fromkeys(filter(None, (unit(name, kind) for kind in kinds)))),
            "values": int(finite.size),
            "min": float(finite.min()) if finite.size else None,
            "max": float(finite.max()) if finite.size else None,
        }
    period_s = recording.period_s
    return {
        "rows": len(recording),
        "duration_s": recording.duration_s,
        "rate_hz": 1.0 / period_s if period_s > 0.0 else None,
        "columns": facts,
        "events": [{"cycle": event.cycle, "name": event.name, "text": event.text} for event in recording.events],
        "restart_points": len(recording.restarts),
        "metadata": sorted(recording.metadata),
        "problems": recording.problems,
    }


def _kinds(recording: "Recording") -> "tuple[AxisKind, ...]":
    """Whether the axis is rotary or linear, where the recording carries the daemon's configuration; else both."""
    try:
        kind = recording.metadata["configuration"]["axes"][recording.axis]["model"]["axis"]
    except (KeyError, TypeError):
        kind = None
    return (kind,) if kind in ("rotary", "linear") else ("rotary", "linear")


def _print(name: str, facts: dict[str, Any]) -> None:
    from rich.table import Table
    from rich.text import Text

    rate = f" at {facts['rate_hz']:.6g} Hz" if facts["rate_hz"] else ""
    out = console()
    out.print(f"{name}: {facts['rows']} rows, {facts['duration_s']:.6g} s{rate}", markup=False)
    table = Table("column", "unit", "values", "min", "max", box=None, header_style="bold", pad_edge=False)
    for number in table.columns[2:]:
        number.justify = "right"
    for column, fact in facts["columns"].items():
        low, high = ("" if fact[key] is None else f"{fact[key]:.6g}" for key in ("min", "max"))
        table.add_row(Text(column), fact["unit"], str(fact["values"]), low, high)
    out.print(table)
    if facts["metadata"]:
        out.print(f"{facts['restart_points']} restart points; metadata: {', '.join(facts['metadata'])}", markup=False)
    for event in facts["events"]:
        out.print(f"cycle {event['cycle']:.0f}: {event['name']}: {event['text']}", markup=False)
