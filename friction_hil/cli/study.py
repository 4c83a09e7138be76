"""``friction-hil study``: what each friction model does to a servo."""

import math
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import click

from friction_hil.cli.output import console, option_json, print_json

if TYPE_CHECKING:
    from friction_hil.study import Study

_PICTURES_FROM = 0.8  # share of the time that the experiments take


@click.command("study")
@click.option("--models", "names", metavar="A,B,...", help="Friction models, separated by commas; all when not given.")
@click.option(
    "--output",
    type=click.Path(file_okay=False, path_type=Path),
    default=Path("out/study"),
    show_default=True,
    metavar="DIR",
    help="Folder for the report; that of a former study is replaced.",
)
@option_json
def command(names: str | None, output: Path, as_json: bool) -> int:
    """Show what friction does to a servo, model by model, in nine experiments.

    Static curves, velocity pulse, presliding, stress and strain, frictional lag, break-away, stick-slip, hunting
    and reversal spikes; the last three without and with compensation by each model. Writes report.html with
    pictures, numbers and explanations; it takes less than a minute and gives the same numbers each time. Exit
    status 1 if a number is not finite.
    """
    from friction_hil import study
    from friction_hil.reports.figures import require_matplotlib
    from friction_hil.reports.study.report import claim, write_report

    chosen = None if names is None else [name.strip() for name in names.split(",") if name.strip()]
    study.check_names(chosen)
    require_matplotlib()
    claim(output)
    with _progress() as tell:
        result = study.run(chosen, lambda text, share: tell(text, _PICTURES_FROM * share))
        report = write_report(output, result, lambda text, share: tell(text, _PICTURES_FROM + 0.2 * share))
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
def _progress() -> Iterator[Callable[[str, float], None]]:
    """Show a bar on a terminal, on stderr; nothing elsewhere."""
    if not sys.stderr.isatty():
        yield lambda text, share: None
        return
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (BarColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
    with Progress(*columns, console=console(stderr=True), transient=True) as bar:
        task = bar.add_task("compiling", total=1.0)

        def tell(text: str, share: float) -> None:
            bar.update(task, description=text.replace("_", " "), completed=share)

        yield tell


def _print(result: "Study", report: Path) -> None:
    from rich.markup import escape
    from rich.table import Table

    from friction_hil.reports.study.text import look, summary_columns

    columns = summary_columns()
    table = Table("model", box=None, header_style="bold", pad_edge=False)
    for column in columns:
        table.add_column(escape(column.brief), justify="right", no_wrap=True)
    remarks = Table("model", "what to look at", box=None, header_style="bold", pad_edge=False)
    for name, facts in result.facts.items():
        table.add_row(name, *(column.write(facts, name) for column in columns))
        remarks.add_row(name, look(name))
    out = console()
    out.print(table)
    out.print("lag: width of the loop at 25 rad/s; break-away: slow → fast rise of the force;")
    out.print("stuck, hunting, reversal: without → with compensation by the same model\n")
    out.print(remarks)
    out.print(f"\nreport: {report}", markup=False, soft_wrap=True)
