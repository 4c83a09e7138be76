"""``friction-hil train``: a network that takes the friction of an axis from recordings, or of a model."""

import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from friction_hil.cli.fit_options import check_files, option_validate, result_options
from friction_hil.cli.output import console, noticed_compilation, option_json, print_json
from friction_hil.cli.recording_options import read_recordings, recording_options
from friction_hil.errors import UsageError

if TYPE_CHECKING:
    from friction_hil.training import Progress, TrainedModel

_INPUTS = ("position", "load_torque", "temperature")


@click.command("train")
@click.argument("sources", metavar="RECORDING...", nargs=-1, type=click.Path(path_type=Path))
@click.option(
    "--structure",
    type=click.Choice(["gated", "narx", "static", "residual"]),
    default="gated",
    show_default=True,
    help="gated: a state that stands still at rest; narx: fed its past torques; static: no state; residual: a static "
    "network beside a model of the library.",
)
@click.option("--hidden", metavar="N[,N]", help="Tanh units of one or two layers.  [default: 10; residual 4]")
@click.option(
    "--inputs",
    default="",
    metavar="NAME,NAME",
    help="Inputs besides the velocity: position, load_torque, temperature.",
)
@option_validate
@click.option(
    "--from-model", "from_model", metavar="FILE_OR_NAME", help="Learn this model, along a designed excitation."
)
@click.option("--samples", type=click.IntRange(min=1000), default=20000, show_default=True, help="With --from-model.")
@click.option("--period", "period_s", type=float, default=1e-3, show_default=True, metavar="S", help="As --samples.")
@click.option("--speed", "top_speed", type=float, metavar="V", help="As --samples: top speed; ten Stribeck velocities.")
@click.option(
    "--base",
    metavar="FILE",
    help="Model file with the mechanics of the axis, and for a residual its friction. Else both are identified first.",
)
@click.option("--linear", "is_linear", is_flag=True, help="The axis is a linear one, where no --base says so.")
@recording_options
@click.option("--lowpass", "lowpass_hz", type=float, metavar="HZ", help="Low-pass everything, without delay.")
@result_options
@option_json
def command(
    sources: tuple[Path, ...],
    structure: str,
    hidden: str | None,
    inputs: str,
    kept_apart: tuple[Path, ...],
    from_model: str | None,
    samples: int,
    period_s: float,
    top_speed: float | None,
    base: str | None,
    is_linear: bool,
    axis: str | None,
    columns: dict[str, str],
    scale: dict[str, float],
    where: str | None,
    lowpass_hz: float | None,
    seed: int,
    output: Path | None,
    report: Path | None,
    as_json: bool,
) -> int:
    """Train a network on the friction of an axis, by Levenberg-Marquardt, in the free run in which it will be used.

    What is judged and kept is the free run on data that it was not trained on. Ctrl-C ends the training and keeps the
    best network so far.
    """
    if bool(sources) == (from_model is not None):
        raise UsageError("train needs recordings, or --from-model; one of them")
    check_files(output, report)
    from friction_hil import training

    spec = training.NetworkSpec(
        structure=structure,  # type: ignore[arg-type]
        hidden=_numbers(hidden),
        inputs=tuple(name.strip() for name in inputs.split(",") if name.strip()),
        seed=seed,
    )
    known = None if base is None else _model_file(base)
    if structure == "residual" and from_model is not None:
        raise UsageError("a residual learns what a model misses in recordings: give recordings, and not --from-model")
    if from_model is not None:
        task = training.task_of_model(
            _model_file(from_model), period_s=period_s, samples=samples, top_speed=top_speed, seed=seed
        )
    else:
        options: dict[str, Any] = {"columns": columns, "scale": scale, "where": where}
        with console(stderr=True).status("reading"):
            task = training.task_of_recordings(
                read_recordings(sources, axis, **options),
                read_recordings(kept_apart, axis, **options),
                known,
                is_linear=is_linear,
                is_static=structure in ("static", "residual"),
                is_residual=structure == "residual",
                lowpass_hz=lowpass_hz,
            )
    begin = time.monotonic()
    with _stoppable() as goes_on, _shown() as show:
        candidate = training.train_task(task, spec, lambda progress: show(progress) or goes_on())
    seconds = time.monotonic() - begin
    if output is not None:
        from friction_hil.checked_yaml.text import dump

        output.write_text(dump(candidate.model_file()), encoding="utf-8")
    if report is not None:
        from friction_hil.reports.training_report import write_report

        write_report(report, candidate, seconds)
    if as_json:
        print_json({**candidate.as_json(seconds), "output": output, "report": report})
    else:
        _print(candidate, seconds, {"model file": output, "report": report})
    return 0


def _numbers(text: str | None) -> tuple[int, ...]:
    if text is None:
        return ()
    try:
        return tuple(int(part) for part in text.split(","))
    except ValueError:
        raise click.BadParameter(f"--hidden {text}: one or two whole numbers, as in 10 or 8,4") from None


def _model_file(argument: str) -> Any:
    from friction_hil.models.files import model_from_argument

    return model_from_argument(argument)


@contextmanager
def _stoppable() -> Iterator[Callable[[], bool]]:
    """Function that says whether to go on: until Ctrl-C is pressed; pressed again, it ends the program."""
    is_stopped = False

    def stop(*_: object) -> None:
        nonlocal is_stopped
        is_stopped = True
        signal.signal(signal.SIGINT, before)

    before = signal.signal(signal.SIGINT, stop)
    try:
        yield lambda: not is_stopped
    finally:
        signal.signal(signal.SIGINT, before)


@contextmanager
def _shown() -> Iterator[Callable[["Progress"], None]]:
    """Function that shows where the training stands, on a terminal."""
    out = console(stderr=True)
    if not out.is_terminal:
        yield _line_by_line()
        return
    with out.status("training") as status, noticed_compilation(lambda note: status.update(f"training: {note}")):

        def show(progress: "Progress") -> None:
            status.update(
                f"iteration {progress.iteration}, start {progress.start + 1}, {progress.stage}: error "
                f"{progress.error:.4f}, on validation {progress.validation_error:.4f}, damping {progress.damping:.1g}"
            )

        yield show


def _line_by_line() -> Callable[["Progress"], None]:
    """Function that writes a line whenever a new start, or another stage of it, begins."""
    last: tuple[int, str] | None = None

    def write(progress: "Progress") -> None:
        nonlocal last
        if (progress.start, progress.stage) != last:
            last = progress.start, progress.stage
            click.echo(
                f"start {progress.start + 1}, {progress.stage}: on validation {progress.validation_error:.4f}", err=True
            )

    return write


def _print(candidate: "TrainedModel", seconds: float, files: dict[str, Path | None]) -> None:
    from rich.table import Table

    out, trained = console(), candidate.trained
    out.print(f"{candidate.network}: {trained.iterations} iterations in {seconds:.1f} s", markup=False)
    table = Table("NRMSE", "one step", "free run", box=None, header_style="bold", pad_edge=False)
    for name, errors in (("training", trained.train), ("validation", trained.validation)):
        table.add_row(name, f"{errors.one_step:.4f}", f"{errors.free_run:.4f}")
    out.print(table)
    if candidate.relative_errors:
        out.print()
        compared = Table("relative error of the torque, held out", "", box=None, header_style="bold", pad_edge=False)
        for name, error in candidate.relative_errors.items():
            compared.add_row(name, f"{100.0 * error:.3f} %")
        out.print(compared)
    for note in (*candidate.task.notes, *trained.flags):
        out.print(f"- {note}", markup=False, soft_wrap=True)
    for what, path in files.items():
        if path is not None:
            out.print(f"{what}: {path}", markup=False, soft_wrap=True)
