"""The work of ``friction-hil train`` without a given structure: a network beside the identified model, or none."""

import time
from pathlib import Path
from typing import Any

import click

from friction_hil import training
from friction_hil.checked_yaml.text import dump
from friction_hil.cli.output import print_json
from friction_hil.cli.work.read import kind_of, read_recordings
from friction_hil.cli.work.tables import console, new_table, number, print_files, print_table
from friction_hil.identification import IdentificationSettings
from friction_hil.models.files import model_from_argument
from friction_hil.reports.selection_report import write_report
from friction_hil.training import Selection


def select(
    sources: tuple[Path, ...],
    inputs: tuple[str, ...],
    base: str | None,
    seed: int,
    output: Path | None,
    report: Path | None,
    as_json: bool,
    verbose: bool,
    *,
    kept_apart: tuple[Path, ...],
    axis: str | None,
    is_linear: bool,
    lowpass_hz: float | None,
    **reading: Any,
) -> int:
    """Choose a network and its physical model, write model file and report, and print the result."""
    known = None if base is None else model_from_argument(base)
    begin = time.monotonic()
    with console(stderr=True).status("reading") as status:
        recordings = read_recordings(sources, axis, **reading)
        validation = read_recordings(kept_apart, axis, **reading)
        kind = known.axis if known is not None else kind_of([*recordings, *validation], is_linear=is_linear)
        found = training.select(
            recordings,
            validation,
            known,
            settings=IdentificationSettings(axis=kind, lowpass_hz=lowpass_hz, seed=seed),
            inputs=inputs or None,
            seed=seed,
            progress=status.update,
        )
    seconds = time.monotonic() - begin
    if output is not None:
        output.write_text(dump(found.model_file()), encoding="utf-8")
    if report is not None:
        write_report(report, found, seconds)
    if as_json:
        print_json({**found.as_json(seconds), "output": output, "report": report})
    else:
        _print(found, seconds, verbose=verbose)
        print_files({"model file": output, "report": report})
        say_next(output)
    return 0


def say_next(output: Path | None) -> None:
    """Say how to go on with a model file, or how to get one."""
    if output is None:
        click.echo("next: the same with --output MODEL.yaml, which writes the model file")
    else:
        click.echo(f"next: friction-hil replay ANOTHER_RECORDING --model {output}")


def _print(found: Selection, seconds: float, *, verbose: bool) -> None:
    kinds = list(found.physical.errors)
    shown = [each for each in found.judged if verbose or each in (found.chosen, found.physical)]
    click.echo(f"{found.chosen.label}: {found.network or 'no network'}, after {seconds:.1f} s")
    click.echo(
        f"relative_error of the torque on held-out data; mean square error lower than that of {found.physical.label} by"
    )
    table = new_table("model", *(number(text) for kind in kinds for text in (kind, "lower by")))
    for each in shown:
        gains = {} if each is found.physical else each.gains(found.physical)
        cells = [
            text
            for kind in kinds
            for text in (
                f"{100.0 * each.errors[kind].relative_error:.3f} %" if kind in each.errors else "-",
                str(gains[kind]) if kind in gains else "",
            )
        ]
        table.add_row(each.label, *cells)
    print_table(table)
    click.echo(f"Chosen: {found.chosen.label}, because {found.reason}.")
    if found.network is None:
        click.echo("The model file holds this model without a network. --structure trains a network in any case.")
    for note in found.notes if verbose else ():
        click.echo(f"- {note}")
