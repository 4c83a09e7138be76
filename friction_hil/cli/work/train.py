"""The work of ``friction-hil train``: a network of a given structure, or one beside the identified model, or none."""

import math
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import click

from friction_hil import training
from friction_hil.checked_yaml.text import dump
from friction_hil.cli.output import print_json
from friction_hil.cli.work.progress import status_line
from friction_hil.cli.work.read import kind_of, read_recordings
from friction_hil.cli.work.result_files import check_result_files
from friction_hil.cli.work.tables import console, new_table, number, print_files, print_table
from friction_hil.errors import UsageError
from friction_hil.identification import IdentificationSettings
from friction_hil.models.files import model_from_argument
from friction_hil.reports import selection_report, training_report
from friction_hil.training import Progress, Selection, TrainedModel


def train(
    *,
    sources: tuple[Path, ...],
    structure: Any,
    hidden: tuple[int, ...],
    inputs: tuple[str, ...],
    from_model: str | None,
    samples: int,
    period_s: float,
    top_speed: float | None,
    base: str | None,
    seed: int,
    output: Path | None,
    report: Path | None,
    as_json: bool,
    verbose: bool,
    **options: Any,
) -> int:
    """Train a network, write model file and report, and print the result; ``options`` concern recordings."""
    if bool(sources) == (from_model is not None):
        raise UsageError("train needs recordings or --from-model, one of them")
    check_result_files(output, report)
    if structure == "auto" and from_model is None:
        if hidden:
            raise UsageError("--hidden needs a --structure: auto averages small networks of its own")
        training.NetworkSpec(inputs=inputs)  # raises on an unknown input
        begin = time.monotonic()
        selection = _select(sources, inputs, base, seed, **options)
        seconds = time.monotonic() - begin
        _tell(selection, selection_report, _print_selection, seconds, output, report, as_json=as_json, verbose=verbose)
        return 0
    structure = "gated" if structure == "auto" else structure
    spec = training.NetworkSpec(structure=structure, hidden=hidden, inputs=inputs, seed=seed)
    known = None if base is None else model_from_argument(base)
    if structure == "residual" and from_model is not None:
        raise UsageError("a residual learns what a model misses in recordings: give recordings, not --from-model")
    if from_model is not None:
        task = training.task_of_model(
            model_from_argument(from_model), period_s=period_s, samples=samples, top_speed=top_speed, seed=seed
        )
    else:
        task = _task_of_recordings(sources, structure, known, **options)
    begin = time.monotonic()
    with _stoppable() as goes_on, _progress() as show:
        candidate = training.train_task(task, spec, lambda progress: show(progress) or goes_on())
    seconds = time.monotonic() - begin
    _tell(candidate, training_report, _print, seconds, output, report, as_json=as_json, verbose=verbose)
    return 0


def _tell(
    found: Any,
    reports: Any,  # the module that writes the report
    show: Callable[..., None],
    seconds: float,
    output: Path | None,
    report: Path | None,
    *,
    as_json: bool,
    verbose: bool,
) -> None:
    """Write model file and report, and print the result and how to go on."""
    if output is not None:
        output.write_text(dump(found.model_file()), encoding="utf-8")
    if report is not None:
        reports.write_report(report, found, seconds)
    if as_json:
        print_json({**found.as_json(seconds), "output": output, "report": report})
        return
    show(found, seconds, verbose=verbose)
    print_files({"model file": output, "report": report})
    if output is None:
        click.echo("next: the same with --output MODEL.yaml, which writes the model file")
    else:
        click.echo(f"next: friction-hil replay ANOTHER_RECORDING --model {output}")


def _select(
    sources: tuple[Path, ...],
    inputs: tuple[str, ...],
    base: str | None,
    seed: int,
    *,
    kept_apart: tuple[Path, ...],
    axis: str | None,
    is_linear: bool,
    lowpass_hz: float | None,
    **reading: Any,
) -> Selection:
    """Choose a network and its physical model."""
    known = None if base is None else model_from_argument(base)
    with console(stderr=True).status("reading") as status:
        recordings = read_recordings(sources, axis, **reading)
        validation = read_recordings(kept_apart, axis, **reading)
        kind = known.axis if known is not None else kind_of([*recordings, *validation], is_linear=is_linear)
        return training.select(
            recordings,
            validation,
            known,
            settings=IdentificationSettings(axis=kind, lowpass_hz=lowpass_hz, seed=seed),
            inputs=inputs or None,
            seed=seed,
            progress=status.update,
        )


def _task_of_recordings(
    sources: tuple[Path, ...],
    structure: str,
    known: Any,
    kept_apart: tuple[Path, ...],
    axis: str | None,
    is_linear: bool,
    lowpass_hz: float | None,
    **reading: Any,
) -> training.TrainingTask:
    with console(stderr=True).status("reading"):
        recordings = read_recordings(sources, axis, **reading)
        validation = read_recordings(kept_apart, axis, **reading)
        return training.task_of_recordings(
            recordings,
            validation,
            known,
            is_linear=known is None and kind_of([*recordings, *validation], is_linear=is_linear) == "linear",
            is_static=structure in ("static", "residual"),
            is_residual=structure == "residual",
            lowpass_hz=lowpass_hz,
        )


@contextmanager
def _stoppable() -> Iterator[Callable[[], bool]]:
    """Yield a function that is true until Ctrl-C is pressed; pressed again, it ends the program."""
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
def _progress() -> Iterator[Callable[[Progress], None]]:
    """Yield a function that shows the progress: in one line on a terminal, else a line for each try when it is over."""
    tries = Tries()
    if not console(stderr=True).is_terminal:
        click.echo(_MEANING, err=True)

        def tell(progress: Progress) -> None:
            for line in tries.take(progress):
                click.echo(line, err=True)

        yield tell
        for line in tries.end():
            click.echo(line, err=True)
        return
    with status_line("training") as show:

        def write(progress: Progress) -> None:
            tries.take(progress)
            # the searches often end before their last iteration: the time left is the longest that it may take
            show(tries.now, progress.iteration, progress.most_iterations)

        yield write


_MEANING = (
    "Several random starts are tried briefly, and the best ones are continued. Their error is the NRMSE: the RMS error "
    "in free run on validation data, over the standard deviation of its torque."
)
_CONTINUED = "parallel"  # stage


class Tries:
    """What a training tries, in words, with the best error so far."""

    def __init__(self) -> None:
        self._key: tuple[int, bool] | None = None
        self._what = ""
        self._error = self._best = math.inf

    def take(self, progress: Progress) -> list[str]:
        """Take the progress of an iteration; return the line of the try that is over, if another one has begun."""
        is_continued = progress.stage == _CONTINUED
        lines = []
        if (progress.start, is_continued) != self._key:
            lines = self.end()
            self._key = progress.start, is_continued
            way = "continuing" if is_continued else "trying"
            self._what = f"{way} start {progress.start + 1} of {progress.starts}"
            self._error = math.inf
        self._error = min(self._error, progress.validation_error)
        self._best = min(self._best, self._error)
        return lines

    @property
    def now(self) -> str:
        """The current try."""
        return f"{self._what}: error {self._error:.4f}, best so far {self._best:.4f}"

    def end(self) -> list[str]:
        """Return the line of the last try; empty if there was none."""
        return [] if self._key is None else [self.now]


def _print(candidate: TrainedModel, seconds: float, *, verbose: bool) -> None:
    trained = candidate.trained
    click.echo(f"{candidate.network}: {trained.iterations} iterations in {seconds:.1f} s")
    if verbose or not candidate.relative_errors:
        table = new_table("NRMSE", number("one step"), number("free run"))
        for name, errors in (("training", trained.train), ("validation", trained.validation)):
            table.add_row(name, f"{errors.one_step:.4f}", f"{errors.free_run:.4f}")
        print_table(table)
    if candidate.relative_errors:
        gains = candidate.gains
        compared = new_table("relative_error of the torque, held out", number(""), number("network lower by"))
        for name, error in candidate.relative_errors.items():
            compared.add_row(name, f"{100.0 * error:.3f} %", str(gains.get(name, "")))
        print_table(compared)
    for words in candidate.not_for:
        click.echo(f"- not for motion {words}")
    for note in (*trained.flags, *(candidate.task.notes if verbose else ())):
        click.echo(f"- {note}")


def _print_selection(found: Selection, seconds: float, *, verbose: bool) -> None:
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
