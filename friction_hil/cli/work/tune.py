"""The work of ``friction-hil tune``."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import asdict
from pathlib import Path
from typing import Any

import click

from friction_hil.cli.colour import echo_labelled, yellow
from friction_hil.cli.output import print_json
from friction_hil.cli.work.following import Compared, following_table
from friction_hil.cli.work.progress import status_line
from friction_hil.cli.work.simulated import simulated_drives
from friction_hil.cli.work.tables import Table, new_table, number, print_table, prose, say
from friction_hil.config import Configuration, file_problems, load, located
from friction_hil.daemon.companion import free_path
from friction_hil.errors import ConfigurationError, FrictionHilError, OptionError
from friction_hil.numerics.readable import digits
from friction_hil.reports.figures import require_matplotlib
from friction_hil.reports.tuning_report import write_reports
from friction_hil.tuning import AxisTuning, TriedModel, TuneSettings, Tuning, tune
from friction_hil.tuning.choice import motion_names
from friction_hil.tuning.settings import ShowStep

_FOLDER = Path("out/tune")


def tune_machine(
    *,
    config: Path,
    names: tuple[str, ...],
    models: tuple[str, ...],
    output: Path | None,
    mechanics: bool,
    yes: bool,
    simulate: bool,
    reset_fault: bool,
    pace: str,
    as_json: bool,
) -> int:
    """Tune the axes of a configuration and print the result; return 1 if one did not help, or one is not restored."""
    if not yes and not sys.stdin.isatty():
        raise click.UsageError(
            "the machine moves several times, minutes apart, and there is no terminal to ask for confirmation: "
            "--yes moves it without asking"
        )
    configuration = checked(config)
    settings = TuneSettings(
        folder=free_path(_FOLDER, 0) if output is None else output,
        names=names,
        families=models,
        is_fault_reset_wanted=reset_fault,
        is_paced_by_sync=pace == "sync",
        is_status_shown=not as_json and sys.stderr.isatty(),
        is_shaken=mechanics,
        is_simulated=simulate,
    )
    terminal = Terminal(is_asked=not yes)
    try:
        with simulated_drives(configuration, pace, terminal.report) if simulate else nullcontext(configuration) as own:
            tuning = tune(own, settings, terminal)
    except OptionError as error:
        raise located(config, error) from None
    tuning.report = _report(settings.folder, tuning, is_simulated=simulate)
    if as_json:
        print_json(_as_dict(tuning))
    else:
        _print(tuning, config, is_simulated=simulate)
    for warning in tuning.warnings:
        echo_labelled("warning:", warning, yellow)
    failed = [name for name, axis in tuning.axes.items() if not axis.best.trial.has_helped]
    for name in failed:
        why = "makes it oscillate" if tuning.axes[name].best.trial.own.is_swinging else "did not help"
        say(f"{name}: compensation {why}: its model is not used")
    return 1 if failed or tuning.leftovers else 0  # the runs have told what was not restored


def checked(config: Path) -> Configuration:
    """Return a configuration whose model files need not exist, but whose other files must.

    Raises
    ------
    ConfigurationError
        It is wrong, or a file is missing.
    """
    configuration = load(config, needs_models=False)
    if problems := file_problems(config, configuration):
        raise ConfigurationError(problems)
    return configuration


def _report(folder: Path, tuning: Tuning, *, is_simulated: bool) -> Path | None:
    """Write the report; an error is printed, not raised, because the result of hours on a machine is worth more."""
    try:
        require_matplotlib()
        return write_reports(folder, tuning, is_simulated=is_simulated)
    except FrictionHilError as error:  # e.g. a full disk
        click.echo(f"no report: {error}", err=True)
    except Exception as error:  # noqa: BLE001  a broken installation of matplotlib raises anything
        click.echo(f"no report: {type(error).__name__}: {error}", err=True)
    return None


class Terminal:
    """Messages and questions on stderr."""

    def __init__(self, *, is_asked: bool) -> None:
        self._is_asked = is_asked

    def report(self, line: str) -> None:
        """Show a line."""
        say(line)

    def confirm(self, motion: str) -> None:
        """Show what will move, and ask whether it may."""
        self.report(motion)
        if self._is_asked:
            click.confirm("Is the way clear?", default=False, abort=True, err=True)

    @contextmanager
    def working(self, text: str) -> Iterator[ShowStep]:
        """Show that a long computation goes on."""
        if not sys.stderr.isatty():
            self.report(f"{text} ...")
        with status_line(text) as show:
            yield show


def _as_dict(tuning: Tuning) -> dict[str, Any]:
    return {
        "axes": {name: _axis(name, tuning) for name in tuning.axes},
        "recordings": tuning.recordings,
        "report": tuning.report,
        "warnings": tuning.warnings,
        "not_restored": tuning.leftovers,
    }


def _axis(name: str, tuning: Tuning) -> dict[str, Any]:
    axis, lag, ratio = tuning.axes[name], tuning.torque_lags.get(name), tuning.torque_ratios.get(name)
    best = axis.best
    return {
        "model": best.label,
        "file": axis.file,
        "in_place": axis.is_in_place,
        "reason": best.identification.reason,
        "flags": best.fit.flags,
        "parameters": best.model["friction"]["parameters"],
        "mechanics": best.model["mechanics"],
        "experiment": tuning.experiments[name].figures if name in tuning.experiments else None,
        "torque_lag": None if lag is None else lag.figures,
        "torque_ratio": None if ratio is None else ratio.figures,
        "tried": [
            {
                "model": each.label,
                **each.trial.figures,
                "reduction": asdict(each.trial.reduction),
                "has_helped": each.trial.has_helped,
            }
            for each in axis.candidates
        ],
    }


def _print(tuning: Tuning, config: Path, *, is_simulated: bool) -> None:
    print_table(_table(tuning))
    click.echo()
    print_table(_motions_table(tuning))
    click.echo()
    for name, axis in tuning.axes.items():
        for each in axis.candidates:
            for problem in each.trial.problems:
                say(f"{name}: {each.label}: {problem}", stderr=False)
    for name, axis in tuning.axes.items():
        for flag in axis.best.fit.flags:
            say(f"{name}: {flag}", stderr=False)
    for name, experiment in tuning.experiments.items():
        say(f"{name}: {experiment.text}", stderr=False)
    for name, lag in tuning.torque_lags.items():
        say(f"{name}: {lag.text}", stderr=False)
    for name, ratio in tuning.torque_ratios.items():
        say(f"{name}: {ratio.text}", stderr=False)
    for name, axis in tuning.axes.items():
        say(f"{name}: model file: {axis.file}; {_use(axis, config, is_simulated=is_simulated)}", stderr=False)
    if tuning.report is not None:
        click.echo(f"report: {tuning.report}")


def _table(tuning: Tuning) -> Table:
    rows = []
    for name, axis in tuning.axes.items():
        unit = "rad" if axis.best.identification.settings.axis == "rotary" else "m"
        for each in axis.candidates:
            own = each.trial.own
            labels = name, _label(axis, each)
            rows.append(Compared(labels, unit, own.uncompensated, own.compensated, own.reduction))
    return following_table(("axis", prose("model")), rows)


def _motions_table(tuning: Tuning) -> Table:
    """Return how many times lower the following error of each motion is with each model."""
    motions = motion_names(tuning.axes.values())
    table = new_table("axis", prose("model"), "times\nlower", *map(number, motions), keys=3)
    for name, axis in tuning.axes.items():
        for each in axis.candidates:
            found = {motion.name: motion.reduction for motion in each.trial.motions}
            cells = (
                "\n".join(digits(value, 2) for value in (found[motion].rms, found[motion].peak))
                if motion in found
                else "-"
                for motion in motions
            )
            table.add_row(name, _label(axis, each), "rms\npeak", *cells)
    return table


def _label(axis: AxisTuning, each: TriedModel) -> str:
    return f"{each.label}{' (kept)' if each is axis.best and each.trial.has_helped else ''}"


def _use(axis: AxisTuning, config: Path, *, is_simulated: bool) -> str:
    """Say what is to be done with the model file of an axis."""
    if is_simulated:
        return "the friction of the simulated drive, not that of the machine: the configuration is as it was"
    if axis.is_in_place:
        return "the configuration names it already"
    if axis.best.trial.has_helped:
        return f"to use it, write 'model: {os.path.relpath(axis.file, config.parent)}' in {config}"
    return "not used: it did not help"
