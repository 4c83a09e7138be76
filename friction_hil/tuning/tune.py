"""Commissioning on the drive, step by step: experiment, identification, candidates, trials, choice."""

import contextlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from friction_hil.config import Configuration
from friction_hil.daemon.assembly import ramp_s
from friction_hil.errors import FrictionHilError, UsageError, choices
from friction_hil.identification import Identification
from friction_hil.identification.settings import chosen_families
from friction_hil.models.model_file import ModelFile
from friction_hil.recordings import Recording, read, read_all
from friction_hil.tuning.announcement import allowed_speeds, experiment_text, trial_text
from friction_hil.tuning.candidates import CandidateFit, candidates, identified, why_not_tried
from friction_hil.tuning.choice import (
    AxisTuning,
    TriedModel,
    keep_best,
    model_content,
    refuse_unwritable_model,
    write_model,
)
from friction_hil.tuning.experiment import refuse_limit_cycle, with_torque
from friction_hil.tuning.motions import experiment_of, experiment_run, sliding_part, trial_run
from friction_hil.tuning.runs import TuningRuns
from friction_hil.tuning.settings import Dialog, TuneSettings
from friction_hil.tuning.trial import judge


@dataclass(slots=True, eq=False)
class Tuning:
    """Result of tuning a machine.

    Attributes
    ----------
    axes : dict of AxisTuning
    recordings : list of Path
    warnings : list of str
        Warnings of the daemon and of the tuning.
    report : Path, optional
        Report, if one was written.
    """

    axes: dict[str, AxisTuning] = field(default_factory=dict)
    recordings: list[Path] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    report: Path | None = None


def tune(configuration: Configuration, settings: TuneSettings, dialog: Dialog) -> Tuning:
    """Identify the friction of axes on their drives, and keep the models that reduce the following error.

    1. Experiment: one axis after another moves as its ``experiment`` allows, uncompensated, the others being held.
    2. Identification: friction models and mechanics of each axis from its recording, dynamic models from all of it and
       static ones from where the axis slides.
    3. Candidates: the best sound static and the best sound dynamic model of each axis.
    4. Trials: all axes make their own motion, first without and then with compensation by one candidate each.
    5. Choice: the candidate with the smallest following error. If it helped and the configuration names a model file
       that does not exist, it is written there; an existing file is left as it is.

    Parameters
    ----------
    configuration : Configuration
        From `friction_hil.config.load`; its model files need not exist.
    settings : TuneSettings
    dialog : Dialog

    Raises
    ------
    OptionError, UsageError
        The configuration lacks a key that tuning needs, or the folder is not empty.
    TuningError
        A run met a fault.
    KeyboardInterrupt
        The user stopped a run; the axes are at rest.
    """
    if configuration.bus is not None and configuration.bus.role == "sidecar":
        raise UsageError(
            "with bus.role: sidecar another controller moves the axes, so 'tune' cannot: record its motion with 'run', "
            "and identify the friction from the recording with 'identify'"
        )
    names = _names(configuration, settings.names)
    chosen_families(settings.families)
    for name in names:
        experiment_of(name, configuration.axes[name])
        if not settings.is_simulated:
            refuse_unwritable_model(name, configuration.axes[name])
    _claim(settings.folder)
    try:
        return _Tuner(configuration, settings, names, dialog).tune()
    finally:
        with contextlib.suppress(OSError):
            settings.folder.rmdir()  # only if it is still empty


class _Tuner:
    def __init__(
        self, configuration: Configuration, settings: TuneSettings, names: Sequence[str], dialog: Dialog
    ) -> None:
        self._configuration, self._settings, self._names, self._dialog = configuration, settings, names, dialog
        self._runs = TuningRuns(settings, dialog)
        self._warnings: list[str] = []

    def tune(self) -> Tuning:
        """Carry out all steps; see `tune`."""
        recorded = {name: self._experiment(name) for name in self._names}
        found = {name: self._identification(recorded.pop(name)) for name in self._names}
        tried = self._trials({name: candidates(each) for name, each in found.items()})
        is_simulated = self._settings.is_simulated
        axes = {
            name: keep_best(self._configuration.axes[name], each, self._file(name), is_simulated=is_simulated)
            for name, each in tried.items()
        }
        return Tuning(axes, self._runs.recordings, [*self._runs.warnings, *self._warnings])

    def _experiment(self, name: str) -> Recording:
        """Record the experiment of an axis."""
        bounds = experiment_of(name, self._configuration.axes[name])
        run, duration_s = experiment_run(self._configuration, name)
        unit = "rad" if self._configuration.axes[name].model.axis == "rotary" else "m"
        self._dialog.confirm(experiment_text(run, name, bounds, duration_s))
        speeds = allowed_speeds(run, {name: bounds})
        recording = read(self._runs.run(run, duration_s, f"{name}_experiment.mcap", speeds), name)
        if warning := refuse_limit_cycle(sliding_part(recording, self._configuration), bounds.velocity, unit):
            self._dialog.report(warning)
        return recording

    def _identification(self, recording: Recording) -> list[Identification]:
        """Identify an axis from its experiment, and write the best model of the first identification."""
        name = recording.axis
        axis = self._configuration.axes[name]
        recording = with_torque(recording, axis.mode)
        for problem in recording.problems:
            self._dialog.report(f"{name}: {problem}")
        with self._dialog.working(f"{name}: identifying friction and inertia") as show:
            found = identified(
                recording,
                self._configuration,
                self._settings.families,
                on_fit=lambda step: show(f"{name}: {step.stage}: {step.label}", step.number, step.count),
                on_problem=lambda problem: self._dialog.report(f"{name}: {problem}"),
            )
        chosen = [fit for _, fit in candidates(found)]
        for each in found:
            self._dialog.report(f"{name}: {each.best.label}: {each.reason}")
            if each.best not in chosen:
                self._dialog.report(f"{name}: {each.best.label} is not tried: {why_not_tried(each.best)}")
        write_model(self._file(name), model_content(found[0], found[0].best, axis))
        return found

    def _trials(self, chosen: Mapping[str, Sequence[CandidateFit]]) -> dict[str, tuple[TriedModel, ...]]:
        """Try every candidate of each axis; an axis with fewer than the others repeats its last one, uncounted."""
        tried: dict[str, list[TriedModel]] = {name: [] for name in self._names}
        for k in range(max(map(len, chosen.values()))):
            fits = {name: each[min(k, len(each) - 1)] for name, each in chosen.items()}
            try:
                found = self._trial(fits, k + 1)
            except FrictionHilError as error:
                if not k:
                    raise  # later, the first models have been tried and are worth keeping
                self._warnings.append(f"the second models could not be tried: {error}")
                break
            for name in self._names:
                if k < len(chosen[name]):
                    tried[name].append(found[name])
        return {name: tuple(each) for name, each in tried.items()}

    def _trial(self, fits: Mapping[str, CandidateFit], number: int) -> dict[str, TriedModel]:
        """Run the machine without and with one candidate for each axis."""
        files = {name: model_content(*each, self._configuration.axes[name]) for name, each in fits.items()}
        run, duration_s = trial_run(
            self._configuration, {name: ModelFile.model_validate(model) for name, model in files.items()}
        )
        labels = {name: fit.label for name, (_, fit) in fits.items()}
        bounds = {name: experiment_of(name, self._configuration.axes[name]) for name in fits}
        self._dialog.confirm(trial_text(run, bounds, labels, duration_s))
        speeds = allowed_speeds(run, bounds)
        recordings = read_all(self._runs.run(run, duration_s, f"trial_{number}.mcap", speeds))
        start_s = ramp_s(run.axes.values())
        return {
            name: TriedModel(*each, files[name], judge(recordings[name], run.axes[name], run.period_s, start_s))
            for name, each in fits.items()
        }

    def _file(self, name: str) -> Path:
        return self._settings.folder / f"{name}.yaml"


def _names(configuration: Configuration, wanted: Sequence[str]) -> tuple[str, ...]:
    for name in wanted:
        if name not in configuration.axes:
            raise UsageError(f"no axis is called {name!r}; {choices(name, configuration.axes)}")
    return tuple(dict.fromkeys(wanted)) or tuple(configuration.axes)


def _claim(folder: Path) -> None:
    """Create the folder; refuse one that is not empty."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        is_empty = not any(folder.iterdir())
    except OSError as error:
        raise UsageError(f"{folder} cannot be made: {error.strerror}; name another folder with --output") from None
    if not is_empty:
        raise UsageError(f"{folder} is not empty, and nothing in it is replaced; name another folder with --output")
