"""The work of ``friction-hil tune``."""

import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import click

from friction_hil.analysis.following import Figures
from friction_hil.api.tuning import FOLDER, tuned
from friction_hil.cli.colour import echo_labelled, yellow
from friction_hil.cli.output import print_json
from friction_hil.cli.work.following import Compared, following_table
from friction_hil.cli.work.progress import status_line
from friction_hil.cli.work.tables import Table, new_table, number, print_table, prose, say
from friction_hil.daemon.companion import free_path
from friction_hil.errors import FrictionHilError
from friction_hil.numerics.readable import POSITION_UNITS, digits
from friction_hil.reports.figures import require_matplotlib
from friction_hil.reports.tuning_report import write_reports
from friction_hil.tuning import AxisTuning, TriedModel, TuneSettings, Tuning
from friction_hil.tuning.choice import motion_names
from friction_hil.tuning.cogging import position_share
from friction_hil.tuning.outcome import apply_recommended, as_dict, recommended_keys, share_left
from friction_hil.tuning.settings import ShowStep


def tune_machine(
    *,
    config: Path,
    names: tuple[str, ...],
    models: tuple[str, ...],
    output: Path | None,
    mechanics: bool,
    yes: bool,
    apply: bool,
    simulate: bool,
    reset_fault: bool,
    pace: str,
    verbose: bool,
    as_json: bool,
) -> int:
    """Tune the axes of a configuration and print the result; return 1 if one did not help, or one is not restored."""
    if not yes and not sys.stdin.isatty():
        raise click.UsageError(
            "the machine moves several times, minutes apart, and there is no terminal to ask for confirmation: "
            "--yes moves it without asking"
        )
    settings = TuneSettings(
        folder=free_path(FOLDER, 0) if output is None else output,
        names=names,
        families=models,
        is_fault_reset_wanted=reset_fault,
        is_paced_by_sync=pace == "sync",
        is_status_shown=not as_json and sys.stderr.isatty(),
        is_shaken=mechanics,
        is_simulated=simulate,
    )
    tuning = tuned(config, settings, Terminal(is_asked=not yes, is_verbose=verbose), pace, is_applied=apply)
    tuning.report = _report(settings.folder, tuning, is_simulated=simulate)
    applied, problem = dict[str, dict[str, Any]](), ""
    if apply:
        try:
            applied = apply_recommended(tuning, config)
        except FrictionHilError as error:  # hours on a machine are not lost with it
            problem = str(error)
    if as_json:
        print_json(as_dict(tuning, config, applied))
    else:
        if verbose:
            _print_details(tuning)
        _print_summary(tuning, config, applied, is_simulated=simulate)
    if problem:
        click.echo(problem, err=True)
    for warning in tuning.warnings:
        echo_labelled("warning:", warning, yellow)
    failed = [name for name, axis in tuning.axes.items() if not axis.recommended.trial.has_helped]
    for name in failed:
        why = "makes it oscillate" if tuning.axes[name].recommended.trial.own.is_swinging else "did not help"
        say(f"{name}: compensation {why}: its model is not used")
    return 1 if failed or tuning.leftovers or problem else 0  # the runs have told what was not restored


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
    """Messages and questions on stderr; details only if they are wanted."""

    def __init__(self, *, is_asked: bool, is_verbose: bool = True) -> None:
        self._is_asked, self._is_verbose = is_asked, is_verbose

    def report(self, line: str) -> None:
        """Show a detail."""
        if self._is_verbose:
            say(line)

    def tell(self, line: str) -> None:
        """Show a line that everybody has to see."""
        say(line)

    def confirm(self, motion: str) -> None:
        """Show what will move, and ask whether it may."""
        if not (self._is_asked or self._is_verbose):  # how far, how fast, how long
            lines = [line for line in motion.split("\n") if not line.startswith(" ")]
            motion = "\n".join(line.split("; ")[0] for line in lines)
        say(motion)
        if self._is_asked:
            click.confirm("Is the way clear?", default=False, abort=True, err=True)

    @contextmanager
    def working(self, text: str) -> Iterator[ShowStep]:
        """Show that a long computation goes on."""
        if not sys.stderr.isatty():
            self.report(f"{text} ...")
        with status_line(text) as show:
            yield show


def _print_details(tuning: Tuning) -> None:
    print_table(_table(tuning))
    click.echo()
    print_table(_motions_table(tuning))
    click.echo()
    for name, axis in tuning.axes.items():
        lag, ratio, experiment = (
            each.get(name) for each in (tuning.torque_lags, tuning.torque_ratios, tuning.experiments)
        )
        for text in (
            *(f"{each.label}: {problem}" for each in axis.candidates for problem in each.trial.problems),
            *axis.best.fit.flags,
            *(each.text for each in (experiment, lag, ratio) if each is not None),
            *(f"gain {each.gain:g}: {each.text}" for each in axis.gains),
        ):
            say(f"{name}: {text}", stderr=False)


def _print_summary(
    tuning: Tuning, config: Path, applied: Mapping[str, Mapping[str, Any]], *, is_simulated: bool
) -> None:
    """Print what was found, what it is worth and what to do next."""
    rows = [Compared((name, _best_label(axis)), *_compared(axis)) for name, axis in tuning.axes.items()]
    print_table(following_table(("axis", prose("model")), rows))
    if is_simulated:
        click.echo("This is the friction of the simulated drive, not that of the machine.")
    for name, axis in tuning.axes.items():
        say(f"{name}: {_recommendation(axis, config, applied.get(name))}", stderr=False)
        joint = tuning.joints[name].text if name in tuning.joints else ""
        for text in (joint, _positions(axis), _uncertainty(name, axis, tuning), _clipped(axis)):
            if text:
                say(f"{name}: {text}", stderr=False)
    if tuning.arm_text:
        say(f"arm: {tuning.arm_text}", stderr=False)
    if tuning.report is not None:
        click.echo(f"report: {tuning.report}")
    helped = [name for name, axis in tuning.axes.items() if axis.recommended.trial.has_helped]
    left = [name for name in helped if name not in applied and recommended_keys(tuning.axes[name], config)]
    first = f"write these keys into {config} (--apply does that), then: " if left else ""
    where = " --simulate" if is_simulated else ""  # never to a machine with the friction of a simulated drive
    more = f"next: {first}friction-hil run {config}{where} --duration 20"
    say(
        more if helped else f"next: compare models: friction-hil replay {tuning.recordings[0]} --model ...",
        stderr=False,
    )


def _best_label(axis: AxisTuning) -> str:
    gain = axis.recommended.gain
    return axis.best.label if gain is None else f"{axis.best.label}, gain {gain:g}"


def _recommendation(axis: AxisTuning, config: Path, applied: Mapping[str, Any] | None) -> str:
    best = axis.recommended
    if not best.trial.has_helped:
        return f"model not used, because it did not help; its file is {axis.file}"
    keys = ", ".join(f"{key}: {_flow(value)}" for key, value in recommended_keys(axis, config).items())
    done = f"written into {config}: " if applied else "recommended: "
    said = f"{done}{keys}" if keys else f"the configuration stays as it is; its model file is {axis.file}"
    others = [each for each in axis.gains if each is not best]
    than = "; ".join(f"gain {each.gain:g}: {each.text}" for each in others)
    return f"{said} ({than})" if than else said


def _flow(value: Any) -> str:
    return f"{{gain: {value['gain']:g}}}" if isinstance(value, dict) else str(value)


def _uncertainty(name: str, axis: AxisTuning, tuning: Tuning) -> str:
    """Say how well the friction is known, and what was not determined."""
    said = list(axis.recommended.trial.problems)
    experiment = tuning.experiments.get(name)
    if experiment is not None and experiment.unknown is not None:
        said.append(f"parameters uncertain by {100.0 * experiment.unknown.known_to:.2g} % of the friction")
    lag, ratio = tuning.torque_lags.get(name), tuning.torque_ratios.get(name)
    unknown = ["torque lag"] if lag is not None and not lag.is_determined else []
    unknown += ["torque ratio"] if ratio is not None and not ratio.is_determined else []
    if unknown:
        said.append(f"not determined: {', '.join(unknown)}")
    if flags := axis.best.fit.flags:
        said.append(f"{len(flags)} remark{'s' if len(flags) > 1 else ''} on the fit")
    if (unknown or flags) and tuning.report is not None:
        said.append("the report says why")
    return "; ".join(said)


def _positions(axis: AxisTuning) -> str:
    """Say what depends on the position, and how much of the error neither that nor friction removes."""
    share, own = position_share(axis.best.model), axis.recommended.trial.own
    if share is None:
        return ""
    left = 100.0 * share_left(own.compensated.rms, own.uncompensated.rms)
    return f"{share.text(_torque_unit(axis))}; with friction, it leaves {left:.2g} % of the following error (RMS)"


def _torque_unit(axis: AxisTuning) -> str:
    return "N m" if _unit(axis) == "rad" else "N"


def _clipped(axis: AxisTuning) -> str:
    found = axis.recommended.clipping
    if found is None:
        return ""
    unit = _torque_unit(axis)
    where = f"limits.torque {found.limit:g} {unit} clipped the compensation in {100.0 * found.share:.2g} % of the rows"
    return where if found.enough is None else f"{where}; {found.enough:g} {unit} would not, if the machine bears it"


def _unit(axis: AxisTuning) -> str:
    return POSITION_UNITS[axis.best.identification.settings.axis]


def _compared(axis: AxisTuning) -> tuple[str, Figures, Figures, Figures]:
    own = axis.recommended.trial.own
    return _unit(axis), own.uncompensated, own.compensated, own.reduction


def _table(tuning: Tuning) -> Table:
    rows = []
    for name, axis in tuning.axes.items():
        for each in axis.candidates:
            own = each.trial.own
            labels = name, _label(axis, each)
            rows.append(Compared(labels, _unit(axis), own.uncompensated, own.compensated, own.reduction))
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
