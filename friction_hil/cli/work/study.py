"""The work of ``friction-hil study``."""

import math
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import click

from friction_hil import study
from friction_hil.cli.output import print_json
from friction_hil.cli.work.progress import progress_bar
from friction_hil.cli.work.tables import new_table, number, print_table, prose
from friction_hil.reports.figures import require_matplotlib
from friction_hil.reports.study.report import claim, write_report
from friction_hil.reports.study.text import look, summary_columns
from friction_hil.study import Study

_EXPERIMENTS = 0.8  # fraction of the time that the experiments take; the figures take the rest


def run_study(*, names: str | None, output: Path, as_json: bool) -> int:
    """Run the experiments, write the report and print the main numbers; return 1 if a number is not finite."""
    chosen = None if names is None else [name.strip() for name in names.split(",") if name.strip()]
    study.check_names(chosen)
    require_matplotlib()
    claim(output)
    with study_progress() as show:
        result = study.run(chosen, lambda text, done: show(text, _EXPERIMENTS * done))
        report = write_report(output, result, lambda text, done: show(text, _EXPERIMENTS + (1 - _EXPERIMENTS) * done))
    if as_json:
        print_json(result.facts)
    else:
        _print(result, report)
    wrong = [
        f"{name}: {fact}" for name, facts in result.facts.items() for fact in facts if not math.isfinite(facts[fact])
    ]
    for each in wrong:
        click.echo(f"not finite: {each}", err=True)
    return 1 if wrong else 0


@contextmanager
def study_progress() -> Iterator[Callable[[str, float], None]]:
    """Yield a function that shows a text and the completed fraction on a terminal, on stderr."""
    if not sys.stderr.isatty():
        yield lambda text, done: None
        return
    with progress_bar() as bar:
        task = bar.add_task("compiling", total=1.0)
        yield lambda text, done: bar.update(task, description=text.replace("_", " "), completed=done)


def _print(result: Study, report: Path) -> None:
    columns = summary_columns()
    table = new_table("model", *(number(column.brief) for column in columns))
    remarks = new_table("model", prose("what to look at"))
    for name, facts in result.facts.items():
        table.add_row(name, *(column.write(facts, name) for column in columns))
        remarks.add_row(name, look(name))
    print_table(table)
    click.echo("lag: width of the loop at 25 rad/s; break-away: slow → fast rise of the force;")
    click.echo("stuck, hunting, reversal: without → with compensation by the same model\n")
    print_table(remarks)
    click.echo(f"\nreport: {report}")
