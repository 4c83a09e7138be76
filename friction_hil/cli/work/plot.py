"""The work of ``friction-hil plot``."""

import math
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import click

from friction_hil import recordings
from friction_hil.analysis.baseline import Phase
from friction_hil.cli.output import print_json
from friction_hil.cli.work.following import Compared, following_table
from friction_hil.cli.work.progress import status_line
from friction_hil.cli.work.tables import print_table, say
from friction_hil.config import Configuration, from_dict, load
from friction_hil.errors import ConfigurationError, FrictionHilError, Problem, UsageError
from friction_hil.recordings import Recording
from friction_hil.recordings.parts import only_recording
from friction_hil.reports.figures import new_figure_for
from friction_hil.reports.run.page import write_run_page
from friction_hil.reports.run.picture import draw_run
from friction_hil.reports.run.view import RunView, make_view

_PAGES = (".html", ".htm")


def plot(
    *,
    source: Path,
    output: Path | None,
    begin: float | None,
    end: float | None,
    config: Path | None,
    axis: str | None,
    as_json: bool,
    **options: Any,
) -> None:
    """Draw a recording into a file for each axis, or all axes into one page, and print the figures."""
    window = _window(begin, end)
    source = only_recording(source)
    target = source.with_suffix(".png") if output is None else output
    _check_target(source, target)
    configuration = None if config is None else load(config)
    options["configuration"] = configuration
    with status_line("reading") as show:
        found = (
            recordings.read_all(source, **options) if axis is None else {axis: recordings.read(source, axis, **options)}
        )
        show("drawing")
        notes: dict[str, list[str]] = {name: list(each.problems) for name, each in found.items()}
        if configuration is None:
            configuration = _inside(found, notes)
        views = {name: make_view(each, configuration, window) for name, each in found.items()}
        files = _write(views, target)
    for name, view in views.items():
        for note in (*notes[name], *view.notes):
            say(f"{source}: {name}: {note}")
    if as_json:
        print_json({"files": files, "axes": {name: _as_dict(view) for name, view in views.items()}})
    else:
        _print(views, files)


def _window(begin: float | None, end: float | None) -> tuple[float, float] | None:
    if begin is None and end is None:
        return None
    low, high = -math.inf if begin is None else begin, math.inf if end is None else end
    if not low < high:
        raise click.UsageError(f"--from {low:g} --to {high:g}: the part must end after it begins")
    return low, high


def _check_target(source: Path, target: Path) -> None:
    """Refuse a wrong suffix or a missing package before anything is read."""
    if target.resolve() == source.resolve():
        raise UsageError(f"--output {target}: is the recording itself")
    if target.suffix.lower() not in _PAGES:
        new_figure_for(target, 1.0, 1.0)


def _inside(found: dict[str, Recording], notes: dict[str, list[str]]) -> Configuration | None:
    """Return the configuration in a recording; a note says if it cannot be used."""
    for name, recording in found.items():
        content = recording.metadata.get("configuration")
        if content is None:
            continue
        try:
            if not isinstance(content, Mapping):
                raise ConfigurationError([Problem(str(recording.path), None, "configuration", "is no mapping")])
            return from_dict(content, f"{recording.path} (configuration inside)", reads_files=False)
        except FrictionHilError as error:
            notes[name].append(f"the configuration inside cannot be used; name one with --config: {error}")
            return None
    return None


def _write(views: dict[str, RunView], target: Path) -> list[Path]:
    if target.suffix.lower() in _PAGES:
        size = write_run_page(target, list(views.values()))
        if size > 1:
            click.echo(
                f"{target} holds minimum and maximum of each {size} rows; --from and --to draw a part with every row",
                err=True,
            )
        return [target]
    is_only = len(views) == 1
    files = {name: target if is_only else target.with_stem(f"{target.stem}_{name}") for name in views}
    for name, view in views.items():
        draw_run(view, files[name])
    return list(files.values())


def _as_dict(view: RunView) -> dict[str, Any]:
    without, compensated = view.phases
    return {
        "following_error": {"without": _figures(without), "with": _figures(compensated)},
        "missed": int(view.missed.sum()),
        "events": [{"time_s": mark.time_s, "name": mark.kind, "text": mark.text} for mark in view.marks],
        "panels": [panel.name for panel in view.panels] + ["friction"] * (view.friction is not None),
        "notes": view.notes,
    }


def _figures(phase: Phase | None) -> dict[str, Any] | None:
    if phase is None:
        return None
    return {**asdict(phase.figures), "from_s": phase.intervals_s[0][0], "to_s": phase.intervals_s[-1][1]}


def _print(views: dict[str, RunView], files: list[Path]) -> None:
    rows = []
    for name, view in views.items():
        without, compensated = (None if each is None else each.figures for each in view.phases)
        if without or compensated:
            reduction = without.times(compensated) if without and compensated else None
            rows.append(Compared((name,), view.units[0], without, compensated, reduction))
    if rows:
        print_table(following_table(("axis",), rows))
    for view in views.values():
        faults = [mark for mark in view.marks if mark.is_fault]
        for mark in faults:
            click.echo(f"{mark.time_s:.3f} s: {mark.kind}: {mark.text}")
        break  # the events are those of the run
    for file in files:
        click.echo(f"{'page' if file.suffix.lower() in _PAGES else 'picture'}: {file}")
