"""The work of ``friction-hil train``: a network of a given structure, or one beside the identified model, or none."""

import math
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import click

from friction_hil.api.training import trained
from friction_hil.cli.output import print_json
from friction_hil.cli.work.progress import status_line
from friction_hil.cli.work.result_files import check_result_files
from friction_hil.cli.work.tables import console, new_table, number, print_files, print_table
from friction_hil.reports import selection_report, training_report
from friction_hil.training import Progress, Selection, TrainedModel


def train(
    *,
    sources: tuple[Path, ...],
    columns: dict[str, str],
    rate_hz: float | None,
    axis: str | None,
    scale: dict[str, float],
    where: str | None,
    output: Path | None,
    report: Path | None,
    as_json: bool,
    verbose: bool,
    **options: Any,
) -> int:
    """Train a network, write model file and report, and print the result; ``options`` are those of `trained`."""
    check_result_files(output, report)
    reading = {"axis": axis, "column": columns, "scale": scale, "rate": rate_hz, "where": where}
    if options["structure"] == "auto" and options["from_model"] is None:
        with console(stderr=True).status("reading") as status:
            found = trained(sources, status.update, _watched, reading=reading, **options)
    else:
        found = trained(sources, lambda _: None, _watched, reading=reading, **options)
    if output is not None:
        found.save(output)
    result, seconds = found.found, found.seconds
    if report is not None:
        if isinstance(result, Selection):
            selection_report.write_report(report, result, seconds)
        else:
            training_report.write_report(report, result, seconds)
    if as_json:
        print_json({**found.facts, "output": output, "report": report})
        return 0
    if isinstance(result, Selection):
        _print_selection(result, seconds, verbose=verbose)
    else:
        _print(result, seconds, verbose=verbose)
    print_files({"model file": output, "report": report})
    if output is None:
        click.echo("next: the same with --output MODEL.yaml, which writes the model file")
    else:
        click.echo(f"next: friction-hil replay ANOTHER_RECORDING --model {output}")
    return 0


@contextmanager
def _watched() -> Iterator[Callable[[Progress], object]]:
    """Yield what shows the progress of a training, and returns False once Ctrl-C is pressed."""
    with _stoppable() as goes_on, _progress() as show:
        yield lambda progress: show(progress) or goes_on()


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
