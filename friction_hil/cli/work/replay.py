"""The work of ``friction-hil replay``."""

import math
import shlex
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import click

from friction_hil.cli.colour import echo_labelled
from friction_hil.cli.output import print_json
from friction_hil.cli.work.progress import progress_bar
from friction_hil.cli.work.tables import console, new_table, number, print_table, say
from friction_hil.config import load
from friction_hil.errors import UsageError
from friction_hil.models.files import model_from_argument
from friction_hil.numerics.readable import digits, quantity, readable
from friction_hil.recordings.given import expanded
from friction_hil.replay.batch import replay_many
from friction_hil.replay.task import ReplayOutcome, ReplayTask
from friction_hil.reports.replay_picture import draw


def replay(
    *,
    sources: tuple[Path, ...],
    model_arguments: tuple[str, ...],
    is_verifying: bool,
    config: Path | None,
    output: Path | None,
    scheduler: str | None,
    lowpass: float | None,
    as_json: bool,
    **options: Any,
) -> int:
    """Replay files and print the result; return the highest exit status. ``options`` go to each `ReplayTask`."""
    if output is not None and is_verifying and not model_arguments:
        raise click.UsageError("--output draws models: give --model")
    if options["where"] is not None and is_verifying:
        raise click.UsageError("--verify uses every row as it was recorded: not with --where")
    files = expanded(sources)
    models = tuple(name for argument in model_arguments for name in _models(argument))
    _check_once(models, config)
    tasks = [
        ReplayTask(
            source=file,
            models=models,
            is_verifying=is_verifying,
            config=None if config is None else str(config),
            picture=None if output is None else str(output),
            draw=None if output is None else draw,
            name=name,
            is_only=len(files) == 1,
            lowpass_hz=lowpass,
            **options,
        )
        for file, name in zip(files, _short_names(files), strict=True)
    ]
    with _progress(len(tasks)) as on_done:
        found = replay_many(tasks, scheduler=scheduler, on_done=on_done, on_note=partial(click.echo, err=True))
    outcomes = [outcome for each in found for outcome in each]
    if as_json:
        print_json({"recordings": [outcome.facts for outcome in outcomes]})
    else:
        print_outcomes(outcomes)
        _print_summary(outcomes)
    for outcome in outcomes:
        if "error" in outcome.facts:
            echo_labelled("Error:", outcome.facts["error"])
    return max((outcome.exit_status for outcome in outcomes), default=0)


def _models(argument: str) -> list[str]:
    """Expand a pattern of model files; return any other argument as it is."""
    try:
        return expanded([argument])
    except UsageError:
        return [argument]  # no file; `model_from_argument` reports what is wrong with it


def _check_once(models: Sequence[str], config: Path | None) -> None:
    """Read models and configuration once, so that a mistake is not reported for each of hundreds of files."""
    for argument in models:
        model_from_argument(argument)
    if config is not None:
        load(config)


def _short_names(files: Sequence[str]) -> list[str]:
    """Return the stems of files, with a number appended where several are equal."""
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
def _progress(files: int) -> Iterator[Callable[[], None]]:
    """Show a progress bar on a terminal if there are several files."""
    errors = console(stderr=True)
    if files < 2 or not errors.is_terminal:
        yield lambda: None
        return
    with progress_bar() as bar:
        task = bar.add_task(f"0 of {files} recordings", total=files)
        done = 0

        def advance() -> None:
            nonlocal done
            done += 1
            bar.update(task, completed=done, description=f"{done} of {files} recordings")

        yield advance


def print_outcomes(outcomes: Sequence[ReplayOutcome]) -> None:
    """Print the errors of the models on each recording."""
    labels = _labels([each["model"] for outcome in outcomes for each in outcome.facts["models"]])
    factor, unit = _common_unit(outcomes)
    table = new_table("recording", "axis", "model", number(f"rmse{unit}"), number("relative_error"))
    for outcome in outcomes:
        facts = outcome.facts
        name = Path(facts["path"]).name
        for problem in facts["problems"]:
            say(f"{name}: {facts['axis']}: {problem}")
        for each in facts["models"]:
            rmse = digits(each["rmse"] * factor, 4) if unit else quantity(each["rmse"], each["unit"])
            error = rmse, _percent(each["relative_error"])
            table.add_row(name, facts["axis"], labels[each["model"]], *error)
        if "verification" in facts:
            click.echo(_verdict(name, facts))
    if table.rows:
        print_table(table)
    for outcome in outcomes:
        if outcome.picture is not None:
            click.echo(f"picture: {outcome.picture}")


def _print_summary(outcomes: Sequence[ReplayOutcome]) -> None:
    """Print what the errors are, which is the lowest, and what to do next."""
    verdicts = [outcome.facts["verified"] for outcome in outcomes if "verification" in outcome.facts]
    if len(verdicts) > 1:
        click.echo(f"{sum(verdicts)} of {len(verdicts)} verified")
    found = [(each, outcome) for outcome in outcomes for each in outcome.facts["models"]]
    if not found:
        return
    say("relative_error: RMS of measured minus modelled torque, over the RMS of the measured torque", stderr=False)
    if len({each["model"] for each, _ in found}) > 1:
        labels = _labels([each["model"] for each, _ in found])
        best, outcome = min(found, key=lambda pair: _finite_or_inf(pair[0]["relative_error"]))
        where = f"{Path(outcome.facts['path']).name}, {outcome.facts['axis']}"
        say(f"lowest: {labels[best['model']]}, {_percent(best['relative_error'])} ({where})", stderr=False)
    _, outcome = max(found, key=lambda pair: _finite_or_inf(pair[0]["relative_error"]))
    fit = shlex.join(["friction-hil", "identify", outcome.facts["path"], "--axis", outcome.facts["axis"]])
    say(f"next: {fit} fits models to {'this' if len(outcomes) == 1 else 'the worst'} recording", stderr=False)


def _finite_or_inf(value: float) -> float:
    return value if math.isfinite(value) else math.inf


def _common_unit(outcomes: Sequence[ReplayOutcome]) -> tuple[float, str]:
    """Return the factor and, in brackets, the unit that fits all errors; no unit if they are of several kinds."""
    found = [each for outcome in outcomes for each in outcome.facts["models"]]
    units = {each["unit"] for each in found}
    if len(units) != 1:
        return 1.0, ""
    factor, unit = readable(units.pop(), [each["rmse"] for each in found])
    return factor, f" [{unit}]"


def _labels(models: Sequence[str]) -> dict[str, str]:
    """Return a short label of each model, ``NAME:...`` for one with its parameters; in full where that is ambiguous."""
    short = {model: f"{model.partition(':')[0]}:..." if "=" in model else model for model in dict.fromkeys(models)}
    count = Counter(short.values())
    return {model: label if count[label] == 1 else model for model, label in short.items()}


def _percent(relative_error: float) -> str:
    return f"{100.0 * relative_error:.3f} %" if math.isfinite(relative_error) else "undefined: measured torque is 0"


def _verdict(name: str, facts: dict[str, Any]) -> str:
    verification = facts["verification"]
    where = f"{name}: {facts['axis']}"
    how = "bit for bit" if verification["tolerance"] == 0.0 else f"to {verification['tolerance']:.3g}"
    if verification["differences"]:
        how += f" (recorded elsewhere: {'; '.join(verification['differences'])})"
    if facts["verified"]:
        return f"{where}: verified: {verification['rows']} rows are reproduced {how}"
    return f"{where}: NOT verified {how}: {verification['reason']}"
