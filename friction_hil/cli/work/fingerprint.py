"""The motion of ``friction-hil health --fingerprint``: always the same one, so that its recordings compare."""

import sys
import time
from contextlib import nullcontext
from pathlib import Path

import click

from friction_hil.cli.work.tune import Terminal
from friction_hil.config import Compensation, Configuration, located
from friction_hil.daemon.companion import state_folder
from friction_hil.daemon.simulated_drives import simulated_drives
from friction_hil.errors import OptionError, UsageError, choices
from friction_hil.tuning import TuneSettings
from friction_hil.tuning.announcement import allowed_speeds, experiment_text
from friction_hil.tuning.motions import TuningError, experiment_of, experiment_run, refuse_shared_beam
from friction_hil.tuning.outcome import checked
from friction_hil.tuning.runs import TuningRuns

HISTORY_NAME = "{}-fingerprint"


def record_fingerprints(
    config: Path, *, axis: str | None, simulate: bool, pace: str, reset_fault: bool, yes: bool
) -> tuple[dict[Path, str], Path]:
    """Move the axes of a configuration one after the other, as their ``experiment`` says, and record them.

    Returns the axis that moved by the path of its recording, and the file of the observations of this configuration.
    ``axis``: only this one; None for all. The others are options of the command. Raises `UsageError` or `OptionError`:
    there is nobody to ask, no such axis, or an axis without ``experiment``; `TuningError`: a run met a fault.
    """
    if not yes and not sys.stdin.isatty():
        raise click.UsageError(
            "the axes move, and there is no terminal to ask for confirmation: --yes moves them without asking"
        )
    configuration = checked(config)
    try:
        names = _names(configuration, axis)
    except OptionError as error:
        raise located(config, error) from None
    folder = state_folder() / "health" / HISTORY_NAME.format(config.stem)
    folder.mkdir(parents=True, exist_ok=True)
    settings = TuneSettings(
        folder=folder,
        is_fault_reset_wanted=reset_fault,
        is_paced_by_sync=pace == "sync",
        is_status_shown=sys.stderr.isatty(),
        is_simulated=simulate,
    )
    terminal = Terminal(is_asked=not yes)
    recorded = {}
    with simulated_drives(configuration, pace, terminal.report) if simulate else nullcontext(configuration) as own:
        runs = TuningRuns(settings, terminal)
        for name in names:
            given = _with_compensation(own, name)
            bounds, (run, duration_s) = experiment_of(name, given.axes[name]), experiment_run(given, name)
            terminal.confirm(experiment_text(run, name, bounds, duration_s))
            file = f"{name}-{time.strftime('%Y%m%d-%H%M%S')}.mcap"
            recorded[runs.run(run, duration_s, file, allowed_speeds(run, {name: bounds}))] = name
        for warning in runs.warnings:
            terminal.report(f"warning: {warning}")
        if runs.leftovers:
            raise TuningError(f"{'; '.join(runs.leftovers)}; the recordings are in {folder}")
    return recorded, folder.with_suffix(".jsonl")


def _with_compensation(configuration: Configuration, name: str) -> Configuration:
    """Return the configuration of a tune, which tries a compensation; in its experiment there is none."""
    axis = configuration.axes[name].model_copy(update={"compensation": Compensation()})
    return configuration.model_copy(update={"axes": {**configuration.axes, name: axis}})


def _names(configuration: Configuration, axis: str | None) -> list[str]:
    if axis is not None and axis not in configuration.axes:
        raise UsageError(f"there is no axis {axis!r}; {choices(axis, configuration.axes)}")
    if configuration.bus is not None and configuration.bus.role == "sidecar":
        raise UsageError("with bus.role: sidecar another controller moves the axes, so --fingerprint cannot")
    names = list(configuration.axes) if axis is None else [axis]
    for name in names:
        refuse_shared_beam(name, configuration)
        experiment_of(name, _with_compensation(configuration, name).axes[name])
    return names
