"""``friction-hil convert``: recordings from one format to another, and what is in one."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from friction_hil.cli.output import console, option_json, print_json
from friction_hil.cli.recording_options import recording_options
from friction_hil.errors import RecordingError, UsageError

if TYPE_CHECKING:
    from friction_hil.recordings import Recording
    from friction_hil.recordings.columns import AxisKind


@click.command("convert")
@click.argument("source", metavar="IN", type=click.Path(path_type=Path))
@click.argument("target", metavar="[OUT]", type=click.Path(path_type=Path), required=False)
@click.option("--info", is_flag=True, help="Say what is in IN; write nothing.")
@click.option("--config", type=click.Path(path_type=Path), help="Configuration, by which a CAN log is decoded.")
@click.option("--force", is_flag=True, help="Overwrite OUT if it exists.")
@recording_options
@option_json
def command(
    source: Path,
    target: Path | None,
    info: bool,
    config: Path | None,
    force: bool,
    axis: str | None,
    columns: dict[str, str],
    scale: dict[str, float],
    where: str | None,
    as_json: bool,
) -> None:
    """Convert the recording IN to OUT, by their suffixes.

    Reads .mcap, .csv (a header of names), .parquet, .mf4 and .mdf, .h5 and .hdf5, .mat (MATLAB 5 to 7.3), .npz,
    .json (a list of rows), and logs of raw CAN frames (candump .log, .asc, .blf; --config says what is in them).
    Writes all but CAN logs, .mdf and MATLAB 7.3. Parquet, MDF and HDF5 need: pip install "friction-hil[formats]".

    Values are kept bit for bit, units where the format has a place for them. From a recording of several axes each
    is written to a file of its own, OUT_x.csv; --axis takes one. Metadata, events and restart points stay behind.

    In place of --column, IN.columns.yaml beside IN, or columns.yaml for all files of its folder, may say
    `columns: {time_s: t, torque: vir*35.15}`. With --where, the torque is NaN where it does not count.

    A model file of a trained network becomes ONNX, for controllers that run it: net.yaml net.onnx.
    """
    if info == (target is not None):
        raise click.UsageError("give OUT, or --info" if target is None else "--info writes nothing: leave OUT away")

    if target is not None and target.suffix.lower() == ".onnx":
        _write_onnx(source, target, force)
        return
    from friction_hil import recordings
    from friction_hil.config import load

    options: dict[str, Any] = {"columns": columns, "scale": scale, "where": where}
    options["configuration"] = None if config is None else load(config)
    found = recordings.read_all(source, **options) if axis is None else {axis: recordings.read(source, axis, **options)}
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
        for problem in facts["problems"]:
            click.echo(f"{source}: {name}: {problem}", err=True)


def _facts(recording: "Recording") -> dict[str, Any]:
    import numpy as np

    from friction_hil.recordings.columns import TIME, unit
    from friction_hil.recordings.even import what_to_repair
    from friction_hil.recordings.quality import resolution, time_facts

    kinds = _kinds(recording)
    facts = {}
    for name, values in recording.columns.items():
        finite = values[np.isfinite(values)]
        ours = " or ".join(dict.fromkeys(filter(None, (unit(name, kind) for kind in kinds))))
        facts[name] = {
            "unit": recording.units.get(name, ours),
            "values": int(finite.size),
            "min": float(finite.min()) if finite.size else None,
            "max": float(finite.max()) if finite.size else None,
            "step": resolution(values),
        }
    times = time_facts(recording.columns[TIME])
    return {
        "rows": len(recording),
        "duration_s": recording.duration_s,
        "rate_hz": 1.0 / times.period_s if times.period_s > 0.0 else None,
        "jitter_s": times.jitter_s,
        "gaps": len(times.gaps),
        "longest_gap_s": times.longest_gap_s,
        "columns": facts,
        "events": [{"cycle": event.cycle, "name": event.name, "text": event.text} for event in recording.events],
        "restart_points": len(recording.restarts),
        "metadata": sorted(recording.metadata),
        "problems": [*recording.problems, *what_to_repair(recording)],
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
    gaps = f", {facts['gaps']} gaps up to {facts['longest_gap_s']:.6g} s" if facts["gaps"] else ""
    if facts["jitter_s"] > 0.0 or gaps:
        out.print(f"time stamps off by up to {facts['jitter_s']:.3g} s{gaps}", markup=False)
    table = Table("column", "unit", "values", "min", "max", "step", box=None, header_style="bold", pad_edge=False)
    for number in table.columns[2:]:
        number.justify = "right"
    for column, fact in facts["columns"].items():
        low, high = ("" if fact[key] is None else f"{fact[key]:.6g}" for key in ("min", "max"))
        step = "" if fact["step"] is None else f"{fact['step']:.4g}"
        table.add_row(Text(column), Text(fact["unit"]), str(fact["values"]), low, high, step)
    out.print(table)
    if facts["metadata"]:
        out.print(f"{facts['restart_points']} restart points; metadata: {', '.join(facts['metadata'])}", markup=False)
    for event in facts["events"]:
        out.print(f"cycle {event['cycle']:.0f}: {event['name']}: {event['text']}", markup=False)


def _write_onnx(source: Path, target: Path, force: bool) -> None:
    from friction_hil import models
    from friction_hil.models import onnx_file

    model = models.load(source)
    if target.exists() and not force:
        raise UsageError(f"{target} exists already; --force replaces it")
    onnx_file.write(model, target)
