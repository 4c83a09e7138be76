"""``friction-hil tune``: commissioning on the drive."""

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from friction_hil.cli.output import console, noticed_compilation, option_json, print_json
from friction_hil.errors import FrictionHilError

if TYPE_CHECKING:
    from friction_hil.tuning import AxisTuning, Tuning

_FOLDER = Path("out/tune")
_WIDE = 1000


@click.command("tune")
@click.argument("config", type=click.Path(path_type=Path))
@click.option("--axis", "names", multiple=True, metavar="NAME", help="Axis to tune; all by default. May be repeated.")
@click.option("--models", default="all", metavar="all|NAME,NAME", help="Families of friction models to try.")
@click.option(
    "--output",
    type=click.Path(file_okay=False, path_type=Path),
    metavar="DIR",
    help=f"Folder for recordings, models and report, new or empty; {_FOLDER} by default, the next ones with the time "
    "in the name.",
)
@click.option("--yes", is_flag=True, help="Do not ask before the axes move.")
@click.option("--reset-fault", is_flag=True, help="Leave a drive's fault before enabling it.")
@click.option(
    "--pace",
    type=click.Choice(["real", "sync"]),
    default="real",
    show_default=True,
    help="sync: as fast as simulated drives that run with --pace sync answer.",
)
@option_json
def command(
    config: Path,
    names: tuple[str, ...],
    models: str,
    output: Path | None,
    yes: bool,
    reset_fault: bool,
    pace: str,
    as_json: bool,
) -> int:
    """Let the axes of CONFIG learn their friction on their drives, and try it.

    Each axis moves as far and as fast as its 'experiment' says; a friction model and the inertia are identified from
    that, tried on the axes' own motion, and kept if the following error is smaller with it. The model file that
    CONFIG names need not be there: tune makes it. One that is there stays as it is; the new one is then in DIR.

    Exit status 1 if a model did not help, or if there was a fault.
    """
    if not yes and not sys.stdin.isatty():
        raise click.UsageError("the machine moves several times, minutes apart: --yes says that nobody need be asked")

    from friction_hil.config import file_problems, load, located
    from friction_hil.errors import ConfigurationError, OptionError

    configuration = load(config, needs_models=False)
    if problems := file_problems(config, configuration):
        raise ConfigurationError(problems)

    from friction_hil.daemon.companion import free_path
    from friction_hil.tuning import TuneSettings, tune

    settings = TuneSettings(
        folder=free_path(_FOLDER, 0) if output is None else output,
        names=names,
        families=() if models == "all" else tuple(name.strip() for name in models.split(",")),
        is_fault_reset_wanted=reset_fault,
        is_paced_by_sync=pace == "sync",
        is_status_shown=not as_json and sys.stderr.isatty(),
    )
    try:
        tuning = tune(configuration, settings, _Terminal(is_asked=not yes))
    except OptionError as error:
        raise located(config, error) from None
    tuning.report = _report(settings.folder, tuning)
    if as_json:
        print_json(_as_dict(tuning))
    else:
        _print(tuning, config)
    for warning in tuning.warnings:
        click.echo(f"warning: {warning}", err=True)
    failed = [name for name, axis in tuning.axes.items() if not axis.best.trial.has_helped]
    for name in failed:
        click.echo(f"{name}: compensation did not help: its model is not put to use", err=True)
    return 1 if failed else 0


def _report(folder: Path, tuning: "Tuning") -> Path | None:
    """Write the report; whatever keeps it from being written is told: hours of a machine are worth more than it."""
    from friction_hil.reports.figures import require_matplotlib

    try:
        require_matplotlib()
        from friction_hil.reports.tuning_report import write_reports

        return write_reports(folder, tuning)
    except FrictionHilError as error:  # e.g. a full disk
        click.echo(f"no report: {error}", err=True)
    except Exception as error:  # noqa: BLE001  matplotlib draws on much that may be broken, and raises anything
        click.echo(f"no report: {type(error).__name__}: {error}", err=True)
    return None


class _Terminal:
    """Speaks on stderr, and asks there."""

    def __init__(self, *, is_asked: bool) -> None:
        self._is_asked = is_asked

    def report(self, line: str) -> None:
        click.echo(line, err=True)

    def confirm(self, motion: str) -> None:
        self.report(motion)
        if self._is_asked:
            click.confirm("Is the way clear?", default=True, abort=True, err=True)

    @contextmanager
    def working(self, text: str) -> Iterator[Callable[[str], None]]:
        if not sys.stderr.isatty():
            self.report(f"{text} ...")
        with console(stderr=True).status(text) as line:
            now = text

            def show(what: str) -> None:
                nonlocal now
                now = what
                line.update(now)

            with noticed_compilation(lambda note: line.update(f"{now}: {note}")):
                yield show


def _as_dict(tuning: "Tuning") -> dict[str, Any]:
    return {
        "axes": {name: _axis(axis) for name, axis in tuning.axes.items()},
        "recordings": tuning.recordings,
        "report": tuning.report,
        "warnings": tuning.warnings,
    }


def _axis(axis: "AxisTuning") -> dict[str, Any]:
    best = axis.best
    return {
        "model": best.fit.label,
        "file": axis.file,
        "in_place": axis.is_in_place,
        "reason": best.identification.reason,
        "flags": best.fit.flags,
        "parameters": best.fit.friction[0],
        "mechanics": best.model["mechanics"],
        "tried": [
            {
                "model": each.fit.label,
                **each.trial.figures,
                "reduction": asdict(each.trial.reduction),
            }
            for each in axis.candidates
        ],
    }


def _print(tuning: "Tuning", config: Path) -> None:
    from rich.table import Table
    from rich.text import Text

    from friction_hil.reports.tuning_report import figures

    out = console()
    if not out.is_terminal:
        out.width = _WIDE  # into a file or a pipe: no label is folded
    table = Table("axis", "model", "following error", box=None, header_style="bold", pad_edge=False)
    for head in ("without", "with compensation", "times lower"):
        table.add_column(head, justify="right")
    for name, axis in tuning.axes.items():
        for each in axis.candidates:
            kept = " (kept)" if each is axis.best and each.trial.has_helped else ""
            for k, row in enumerate(figures(axis, each)):
                table.add_row(*(("", "") if k else (name, Text(f"{each.fit.label}{kept}"))), *map(Text, row))
    out.print(table)
    for name, axis in tuning.axes.items():
        for flag in axis.best.fit.flags:
            out.print(f"{name}: {flag}", markup=False, soft_wrap=True)
    for name, axis in tuning.axes.items():
        seen = os.path.relpath(axis.file, config.parent)
        if axis.is_in_place:
            use = "where the configuration looks for it"
        elif axis.best.trial.has_helped:
            use = f"to use it, 'model: {seen}' in {config}"
        else:
            use = "for a look; it did not help"
        out.print(f"{name}: model file: {axis.file}; {use}", markup=False, soft_wrap=True)
    if tuning.report is not None:
        out.print(f"report: {tuning.report}", markup=False, soft_wrap=True)
