"""The work of ``friction-hil study``."""

import math
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import click

from friction_hil import study
from friction_hil.cli.output import print_json
from friction_hil.cli.work.progress import progress_bar
from friction_hil.cli.work.tables import new_table, number, print_table, prose
from friction_hil.errors import UsageError, choices
from friction_hil.reports.figures import require_matplotlib
from friction_hil.reports.study.report import claim, write_report
from friction_hil.reports.study.text import look, summary_columns
from friction_hil.study import Study, StudySettings
from friction_hil.study.subjects import REFERENCE

_LEVELS = ("coulomb", "static", "stribeck_velocity", "viscous", "stiffness", "damping")
_MAY_BE_ZERO = ("viscous", "damping")
_FASTEST_HZ = 20.0  # 50 periods a lap
_MOTION = ("mass", "spring", "pull", "radius", "frequency")
_EXPERIMENTS = 0.8  # fraction of the time that the experiments take; the figures take the rest


def run_study(
    *,
    names: str | None,
    friction: dict[str, float],
    servo: dict[str, float],
    motion: dict[str, float],
    output: Path,
    as_json: bool,
    verbose: bool,
) -> int:
    """Run the experiments, write the report and print the main numbers; return 1 if a number is not finite."""
    chosen = None if names is None else [name.strip() for name in names.split(",") if name.strip()]
    study.check_names(chosen)
    settings = _settings(friction, servo, motion)
    require_matplotlib()
    claim(output)
    with study_progress() as show:
        result = study.run(chosen, lambda text, done: show(text, _EXPERIMENTS * done), settings=settings)
        report = write_report(output, result, lambda text, done: show(text, _EXPERIMENTS + (1 - _EXPERIMENTS) * done))
    if as_json:
        print_json(result.facts)
    else:
        _print(result, report, verbose=verbose)
    wrong = [
        f"{name}: {fact}" for name, facts in result.facts.items() for fact in facts if not math.isfinite(facts[fact])
    ]
    for each in wrong:
        click.echo(f"not finite: {each}", err=True)
    return 1 if wrong else 0


def _settings(friction: dict[str, float], servo: dict[str, float], motion: dict[str, float]) -> StudySettings:
    """Check the numbers of ``--friction``, ``--servo`` and ``--motion``.

    Raises `UsageError`: a name is unknown, or a number is not finite or not above zero.
    """
    known = {"--friction": (friction, _LEVELS), "--servo": (servo, _LEVELS), "--motion": (motion, _MOTION)}
    for option, (given, names) in known.items():
        for name, value in given.items():
            if name not in names:
                raise UsageError(f"{option} has no {name!r}; {choices(name, names)}")
            if not (0.0 < value < math.inf or (value == 0.0 and name in _MAY_BE_ZERO)):
                raise UsageError(f"{option}: {name} is {value:g}, but must be finite and above zero")
    if motion.get("frequency", 0.0) > _FASTEST_HZ:
        raise UsageError(f"--motion: frequency is {motion['frequency']:g}, but {_FASTEST_HZ:g} Hz is the most")
    levels = replace(REFERENCE, **friction)
    if "stribeck_velocity" in friction:
        levels = replace(levels, top_velocity=100.0 * levels.stribeck_velocity)
    return StudySettings(friction=levels, servo=servo, **motion)


@contextmanager
def study_progress() -> Iterator[Callable[[str, float], None]]:
    """Yield a function that shows a text and the completed fraction on a terminal, on stderr."""
    if not sys.stderr.isatty():
        yield lambda text, done: None
        return
    with progress_bar() as bar:
        task = bar.add_task("compiling", total=1.0)
        yield lambda text, done: bar.update(task, description=text.replace("_", " "), completed=done)


def _print(result: Study, report: Path, *, verbose: bool) -> None:
    columns = summary_columns()
    table = new_table("model", *(number(column.brief) for column in columns))
    remarks = new_table("model", prose("what to look at"))
    for name, facts in result.facts.items():
        table.add_row(name, *(column.write(facts, name) for column in columns))
        remarks.add_row(name, look(name))
    print_table(table)
    click.echo("lag: width of the loop at 25 rad/s; break-away: slow → fast rise of the force;")
    click.echo("stuck, hunting, reversal: without → with compensation by the same model")
    if verbose:
        print_table(remarks)
    click.echo(f"report: {report}")
    click.echo("next: open the report; -v says what to look at, model by model")
