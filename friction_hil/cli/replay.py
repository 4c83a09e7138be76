"""``friction-hil replay``: recordings through friction models, and the compensator run again."""

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from friction_hil.cli.output import console, option_json, print_json
from friction_hil.cli.recording_options import expanded, recording_options
from friction_hil.errors import UsageError

if TYPE_CHECKING:
    from collections.abc import Callable

    from friction_hil.replay.task import ReplayOutcome


_WIDE = 1000


@click.command("replay")
@click.argument("sources", metavar="RECORDING...", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option(
    "--model",
    "model_arguments",
    multiple=True,
    metavar="FILE_OR_NAME",
    help="Model file, pattern of model files, or NAME:coulomb=0.08,viscous=2e-3. May be repeated.",
)
@click.option("--verify", "is_verifying", is_flag=True, help="Run the daemon's compensator again; compare every bit.")
@click.option(
    "--config", type=click.Path(path_type=Path), help="Configuration: of a CAN log; or in place of the one inside."
)
@recording_options
@click.option("--lowpass", "lowpass_hz", type=float, metavar="HZ", help="Low-pass everything, without delay.")
@click.option("--decimate", type=click.IntRange(min=1), default=1, metavar="N", help="Keep each N-th sample.")
@click.option("--output", type=click.Path(path_type=Path), metavar="PICTURE", help="Draw into PICTURE (.png, .svg).")
@click.option(
    "--scheduler",
    metavar="ADDRESS",
    help="Work on the Dask cluster with this scheduler, e.g. tcp://10.0.0.5:8786, in place of this machine's cores. "
    "Its workers read the files: they must reach them by the same paths.",
)
@option_json
def command(
    sources: tuple[Path, ...],
    model_arguments: tuple[str, ...],
    is_verifying: bool,
    config: Path | None,
    axis: str | None,
    columns: dict[str, str],
    scale: dict[str, float],
    where: str | None,
    lowpass_hz: float | None,
    decimate: int,
    output: Path | None,
    scheduler: str | None,
    as_json: bool,
) -> int:
    """Predict the torque of each RECORDING with each model, and compare it with the measured torque.

    RECORDING may be a pattern, also a quoted one: 'logs/**/*.mcap'. Files are worked on by all cores; one that
    cannot be read costs only itself. Reads what `convert` reads, and columns as it does.

    Without --model the daemon's own recording is compared with the model that it ran with. Velocity and
    acceleration are derived from the position where there is no velocity, or with --lowpass. relative error =
    norm(measured - predicted) / norm(measured).

    --verify feeds the recording through the whole compensator, which must give the recorded compensation again:
    exit status 1 and the first cycle that differs otherwise.
    """
    from friction_hil.config import load
    from friction_hil.models.files import model_from_argument
    from friction_hil.replay.batch import replay_many
    from friction_hil.replay.task import ReplayTask
    from friction_hil.reports.replay_picture import draw

    if output is not None and is_verifying and not model_arguments:
        raise click.UsageError("--output draws models: give --model")
    if where is not None and is_verifying:
        raise click.UsageError("--verify takes every row as it was recorded: not with --where")
    files = expanded(sources)
    models = tuple(name for argument in model_arguments for name in _models(argument))
    # before hundreds of files are read: mistakes that would be made in each
    for argument in models:
        model_from_argument(argument)
    if config is not None:
        load(config)
    tasks = [
        ReplayTask(
            source=file,
            models=models,
            is_verifying=is_verifying,
            config=None if config is None else str(config),
            axis=axis,
            columns=columns,
            scale=scale,
            where=where,
            lowpass_hz=lowpass_hz,
            decimate=decimate,
            picture=None if output is None else str(output),
            draw=None if output is None else draw,
            name=name,
            is_only=len(files) == 1,
        )
        for file, name in zip(files, _short_names(files), strict=True)
    ]
    with _progress(len(tasks)) as on_done:
        found = replay_many(tasks, scheduler=scheduler, on_done=on_done, on_note=partial(click.echo, err=True))
    outcomes = [outcome for each in found for outcome in each]
    if as_json:
        print_json({"recordings": [outcome.facts for outcome in outcomes]})
    else:
        _print(outcomes)
    for outcome in outcomes:
        if "error" in outcome.facts:
            click.echo(f"Error: {outcome.facts['error']}", err=True)
    return max((outcome.exit_status for outcome in outcomes), default=0)


def _models(argument: str) -> list[str]:
    """A pattern of model files as their names, everything else as it is."""
    try:
        return expanded([argument])
    except UsageError:
        return [argument]  # no file: model_from_argument says what would be right


def _short_names(files: Sequence[str]) -> list[str]:
    """Stems of files, numbered where several are called the same."""
    names: list[str] = []
    for file in files:
        stem = name = Path(file).stem
        count = 1
        while name in names:
            count += 1
            name = f"{stem}_{count}"
        names.append(name)
    return names


@contextmanager
def _progress(files: int) -> "Iterator[Callable[[], None]]":
    """A progress bar where somebody watches and there is more than one file."""
    errors = console(stderr=True)
    if files < 2 or not errors.is_terminal:
        yield lambda: None
        return
    from rich.progress import Progress

    with Progress(console=errors, transient=True) as progress:
        bar = progress.add_task("replay", total=files)
        yield lambda: progress.advance(bar)


def _print(outcomes: "Sequence[ReplayOutcome]") -> None:
    from rich.table import Table
    from rich.text import Text

    out, errors = console(), console(stderr=True)
    table = Table("recording", "axis", "model", "rmse", "relative error", box=None, header_style="bold", pad_edge=False)
    for outcome in outcomes:
        facts = outcome.facts
        name = Path(facts["path"]).name
        for problem in facts["problems"]:
            errors.print(f"{name}: {facts['axis']}: {problem}", markup=False, soft_wrap=True)
        for each in facts["models"]:
            rmse, share = f"{each['rmse']:.4g} {each['unit']}", each["relative_error"]
            relative = f"{100.0 * share:.3f} %" if math.isfinite(share) else "undefined: measured torque is 0"
            table.add_row(Text(name), facts["axis"], Text(each["model"]), rmse, relative)
        if "verification" in facts:
            out.print(_verdict(name, facts), markup=False, soft_wrap=True)
    if table.row_count:
        if not out.is_terminal:
            out.width = _WIDE  # into a file or a pipe: no name is cut short
        out.print(table)
    for outcome in outcomes:
        if outcome.picture is not None:
            click.echo(f"picture: {outcome.picture}")


def _verdict(name: str, facts: dict[str, Any]) -> str:
    verification = facts["verification"]
    where = f"{name}: {facts['axis']}"
    how = "bit for bit" if verification["tolerance"] == 0.0 else f"to {verification['tolerance']:.3g}"
    if verification["differences"]:
        how += f" (recorded elsewhere: {'; '.join(verification['differences'])})"
    if facts["verified"]:
        return f"{where}: verified: {verification['rows']} rows come out again {how}"
    return f"{where}: NOT verified {how}: {verification['reason']}"
