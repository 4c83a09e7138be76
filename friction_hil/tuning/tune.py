"""Commissioning on the drive: each axis moves to show its friction, models of it are tried, the best one is kept."""

import contextlib
import math
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from friction_hil import friction as models
from friction_hil.checked_yaml.text import dump
from friction_hil.config import AxisConfig, Configuration
from friction_hil.daemon.assembly import ramp_s
from friction_hil.daemon.safety import LoopState
from friction_hil.daemon.session import SessionResult, SessionSettings, run_session
from friction_hil.daemon.stop import stop_on_signals
from friction_hil.errors import FrictionHilError, OptionError, RecordingError, UsageError, choices
from friction_hil.identification import Fit, Identification, identify
from friction_hil.identification import Settings as IdentificationSettings
from friction_hil.identification.choice import is_determined
from friction_hil.identification.export import as_model_file
from friction_hil.identification.identify import chosen_families
from friction_hil.identification.refine import is_dynamic
from friction_hil.models.model_file import ModelFile
from friction_hil.motion.experiment import is_fast
from friction_hil.numerics.jit import Array
from friction_hil.recordings import Recording, read, read_all
from friction_hil.tuning.motions import TuningError, experiment_of, experiment_run, sliding_part, trial_run
from friction_hil.tuning.trial import Trial, judge

_LEAST_SPEED = 0.05  # of the highest: below, to a model without presliding friction is whatever holds the axis
_LOOK_S = 0.02  # over which a speed is looked at: no count of an encoder matters
_SWINGING = 2.0  # times the speed that was asked for


class Talk(Protocol):
    """What tuning says to the user, and asks. Nothing of it is called while axes move, but `tell`."""

    def tell(self, line: str) -> None:
        """Take a line about what is going on."""
        ...

    def confirm(self, motion: str) -> None:
        """Let the user say that this may move now, or give up (``click.Abort``)."""
        ...

    def working(self, text: str) -> AbstractContextManager[Callable[[str], None]]:
        """Show that long work goes on; the function takes what it is at."""
        ...


@dataclass(frozen=True, slots=True)
class Settings:
    """What to tune, and where to leave it.

    Attributes
    ----------
    names : tuple of str
        Axes to tune; empty for all.
    folder : Path
        For recordings, model files and reports; new or empty.
    families : tuple of str
        Friction models to look at; empty for all.
    is_fault_reset_wanted, is_paced_by_sync, is_status_shown : bool
        As of a session.
    """

    folder: Path
    names: tuple[str, ...] = ()
    families: tuple[str, ...] = ()
    is_fault_reset_wanted: bool = False
    is_paced_by_sync: bool = False
    is_status_shown: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """A model that was tried on the machine."""

    identification: Identification
    fit: Fit
    model: dict[str, Any]
    trial: Trial


@dataclass(frozen=True, slots=True, eq=False)
class AxisTuning:
    """What an axis has learned.

    Attributes
    ----------
    candidates : tuple of Candidate
        What was tried.
    file : Path
        Model file of the best of them.
    is_in_place : bool
        Whether it stands where the configuration looks for it.
    """

    candidates: tuple[Candidate, ...]
    file: Path
    is_in_place: bool

    @property
    def best(self) -> Candidate:
        """Of those that helped, if any: the one with the smallest following error on the machine, RMS times peak."""
        return min(self.candidates, key=_rank)


@dataclass(slots=True, eq=False)
class Tuning:
    """What came of it.

    Attributes
    ----------
    axes : dict of AxisTuning
    recordings : list of Path
    warnings : list of str
        The daemon's.
    report : Path, optional
        Where one was written.
    """

    axes: dict[str, AxisTuning] = field(default_factory=dict)
    recordings: list[Path] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    report: Path | None = None


def tune(configuration: Configuration, settings: Settings, talk: Talk) -> Tuning:
    """Let axes learn their friction.

    One after another they make their experiment, the others being held. Of each recording friction model and mechanics
    are identified, dynamic models of all of it and static ones of where the axis slides; then all of them move once
    without, once with compensation by the best one of each kind: what counts in the end is the following error of the
    machine. A model that helped is put where the configuration names a file that is not there yet; a file that is
    there stays as it is.

    Parameters
    ----------
    configuration : Configuration
        From `friction_hil.config.load`; model files need not be there.
    settings : Settings
    talk : Talk

    Raises
    ------
    OptionError, UsageError
        The configuration does not say what is needed, or the folder is in use.
    TuningError
        A run met a fault.
    KeyboardInterrupt
        The user stopped a run; the axes are at rest.
    """
    names = _names(configuration, settings.names)
    chosen_families(settings.families)
    for name in names:
        experiment_of(name, configuration.axes[name])
        _refuse_no_place(name, configuration.axes[name])
    _claim(settings.folder)
    try:
        return _Tuner(configuration, settings, names, talk).tune()
    finally:
        with contextlib.suppress(OSError):
            settings.folder.rmdir()  # if nothing has come of it


class _Tuner:
    def __init__(self, configuration: Configuration, settings: Settings, names: Sequence[str], talk: Talk) -> None:
        self._configuration, self._settings, self._names, self._talk = configuration, settings, names, talk
        self._told: set[str] = set()
        self._result = Tuning()

    def tune(self) -> Tuning:
        paths = {name: self._experiment(name) for name in self._names}
        found = {name: self._identified(name, path) for name, path in paths.items()}
        tried: dict[str, list[Candidate]] = {name: [] for name in self._names}
        choice = {name: _candidates(each) for name, each in found.items()}
        for k in range(max(map(len, choice.values()))):
            fits = {name: each[min(k, len(each) - 1)] for name, each in choice.items()}
            try:
                candidates = self._tried(fits, k + 1)
            except FrictionHilError as error:
                if not k:
                    raise  # else the first models have been tried, and are worth keeping
                self._result.warnings.append(f"the second models could not be tried: {error}")
                break
            for name in self._names:
                if k < len(choice[name]):
                    tried[name].append(candidates[name])
        for name in self._names:
            self._result.axes[name] = self._kept(name, tuple(tried[name]))
        return self._result

    def _experiment(self, name: str) -> Path:
        """Record the experiment of an axis; return the recording."""
        bounds = experiment_of(name, self._configuration.axes[name])
        run, duration_s = experiment_run(self._configuration, name)
        held = ", ".join(each for each in run.axes if each != name)
        unit = "rad" if self._configuration.axes[name].model.axis == "rotary" else "m"
        self._talk.confirm(
            f"{name} moves by up to {bounds.travel:g} {unit} to either side of where it stands, at up to "
            f"{bounds.velocity:g} {unit}/s, for {duration_s:.0f} s, without compensation"
            + (f"; {held} held" if held else "")
        )
        path = self._run(run, duration_s, f"{name}_experiment.mcap")
        if jumps := _refuse_swinging(sliding_part(read(path, name), self._configuration), bounds.velocity, unit):
            self._talk.tell(jumps)
        return path

    def _identified(self, name: str, path: Path) -> list[Identification]:
        """Identify an axis from its experiment, and write the first model."""
        recording = _with_torque(read(path, name), self._configuration.axes[name].mode)
        for problem in recording.problems:
            self._talk.tell(f"{name}: {problem}")
        found = []
        with self._talk.working(f"{name}: identifying friction and inertia") as show:
            for part, settings in self._views(name, recording):
                try:
                    found.append(identify([part], settings, progress=lambda label: show(f"{name}: fitting {label}")))
                except RecordingError as error:  # e.g. an axis that hardly slides
                    if not found:
                        raise
                    self._talk.tell(f"{name}: no static model: {error}")
        tried = [fit for _, fit in _candidates(found)]
        for each in found:
            self._talk.tell(f"{name}: {each.best.label}: {each.reason}")
            if each.best not in tried:
                self._talk.tell(f"{name}: {each.best.label} is not tried: the data do not determine its parameters")
        self._write(name, self._model(name, found[0], found[0].best))
        return found

    def _views(self, name: str, recording: Recording) -> Iterator[tuple[Recording, IdentificationSettings]]:
        """What of an experiment is looked at, and for which models: dynamic ones, then static ones."""
        axis, wanted = self._configuration.axes[name], self._settings.families
        families = chosen_families(wanted)
        static = tuple(family for family in families if models.describe(family).is_static)
        dynamic = tuple(family for family in families if family not in static)
        least_speed = _LEAST_SPEED * experiment_of(name, axis).velocity
        sliding = IdentificationSettings(families=static, axis=axis.model.axis, least_speed=least_speed)
        if not is_fast(1.0 / self._configuration.period_s):  # too slow to see presliding, and what follows from it
            yield recording, replace(sliding, families=wanted or static)
            return
        if dynamic:
            yield recording, IdentificationSettings(families=dynamic, axis=axis.model.axis)
        if static:
            yield sliding_part(recording, self._configuration), sliding

    def _tried(self, fits: dict[str, tuple[Identification, Fit]], number: int) -> dict[str, Candidate]:
        """Run the machine with a model for each axis."""
        files = {name: self._model(name, *each) for name, each in fits.items()}
        run, duration_s = trial_run(
            self._configuration, {name: ModelFile.model_validate(model) for name, model in files.items()}
        )
        labels = ", ".join(f"{name} by {fit.label}" for name, (_, fit) in fits.items())
        motions = ", ".join(f"{name}: {run.axes[name].trajectory.kind}" for name in fits)
        self._talk.confirm(
            f"the axes move ({motions}) for {duration_s:.0f} s, the first half without compensation, then {labels}"
        )
        recordings = read_all(self._run(run, duration_s, f"trial_{number}.mcap"))
        start_s = ramp_s(run.axes.values())
        return {
            name: Candidate(*each, files[name], judge(recordings[name], run.axes[name], run.period_s, start_s))
            for name, each in fits.items()
        }

    def _kept(self, name: str, candidates: tuple[Candidate, ...]) -> AxisTuning:
        """Write the best model of an axis: into the folder, and where the configuration waits for it."""
        best = AxisTuning(candidates, Path(), False).best
        model = {**best.model, "fit": {**best.model["fit"], "trial": best.trial.figures}}
        file = self._write(name, model)
        wanted = self._configuration.axes[name].model.source_path
        is_in_place = wanted is not None and not wanted.exists() and best.trial.has_helped
        if wanted is not None and is_in_place:
            file = _written(wanted, model)
        return AxisTuning(candidates, file, is_in_place)

    def _write(self, name: str, model: dict[str, Any]) -> Path:
        return _written(self._settings.folder / f"{name}.yaml", model)

    def _model(self, name: str, found: Identification, fit: Fit) -> dict[str, Any]:
        """Model file of a fit; what no recording tells is taken from the axis's former one."""
        model = as_model_file(found, fit)
        before = self._configuration.axes[name].model.mechanics
        model["mechanics"] |= {"delay_s": before.delay_s, "torque_lag_s": before.torque_lag_s}
        return model

    def _run(self, run: Configuration, duration_s: float, file: str) -> Path:
        """Run the daemon once; return its recording."""
        path = self._settings.folder / file
        session = SessionSettings(
            duration_s=duration_s,
            record=path,
            is_fault_reset_wanted=self._settings.is_fault_reset_wanted,
            is_paced_by_sync=self._settings.is_paced_by_sync,
            is_status_shown=self._settings.is_status_shown,
        )
        with stop_on_signals() as stop:
            result = run_session(run, session, stop, self._tell_once)
        self._note(result, path)
        if stop.is_by_user:
            self._talk.tell(f"stopped, the axes are at rest; what there is so far is in {self._settings.folder}")
            raise KeyboardInterrupt
        return path

    def _note(self, result: SessionResult, path: Path) -> None:
        report = result.report
        self._result.warnings += [each for each in result.loop.warnings if each not in self._result.warnings]
        if report is not None and report.recording:
            self._result.recordings.append(path)
        if result.loop.faults:
            where = f"; the run is in {path}"
            if not _has_run(path):
                path.unlink(missing_ok=True)
                where = "; nothing has moved"
            raise TuningError("; ".join(result.loop.faults) + where)
        if report is None or report.lost or not report.recording:
            problems = "; ".join(report.problems) if report is not None and report.problems else "rows were lost"
            raise TuningError(f"{path}: the recording is not whole: {problems}")

    def _tell_once(self, line: str) -> None:
        if line not in self._told:
            self._told.add(line)
            self._talk.tell(line)


def _has_run(path: Path) -> bool:
    """Whether a recording tells of axes that were about to move."""
    try:
        return any(np.any(each["state"] == LoopState.RUNNING) for each in read_all(path).values())
    except FrictionHilError:  # no row, or no file
        return False


def _refuse_no_place(name: str, axis: AxisConfig) -> None:
    """Refuse a model file that cannot be made where the configuration names it, before anything moves for it."""
    wanted = axis.model.source_path
    if wanted is None or wanted.exists():
        return
    if not wanted.parent.is_dir():
        raise OptionError(name, "model", f"there is no folder {wanted.parent} to make it in")
    if not os.access(wanted.parent, os.W_OK):
        raise OptionError(name, "model", f"cannot be made: nothing may be written to {wanted.parent}")


def _refuse_swinging(recording: Recording, velocity: float, unit: str) -> str:
    """Refuse an axis whose loop swings by itself; return what is to be told of one that jumps.

    Both move much faster than they were asked to. One that breaks away from friction jumps where its set-point goes,
    once or a few times in each stroke; one that swings turns round at such a speed more often than its set-point does.

    Parameters
    ----------
    recording : Recording
        The slow sweeps: in fast ones any loop may lag behind by half a period.
    velocity : float
        Highest speed of the experiment.
    unit : str
        rad or m.
    """
    is_running = recording["state"] == LoopState.RUNNING
    position, demand = recording["position"][is_running], recording["velocity_demand"][is_running]
    step = max(1, round(_LOOK_S / recording.period_s))
    seen = (position[step:] - position[:-step]) / (step * recording.period_s)
    fastest = float(np.max(np.abs(seen), initial=0.0))
    if fastest <= _SWINGING * velocity:
        return ""
    what = f"{recording.axis} has moved at {fastest:.3g} {unit}/s, where its experiment asks for {velocity:g} at most"
    if _reversals(seen, velocity) > _reversals(demand, 0.0):
        raise TuningError(
            f"{what}: the loop that controls it swings (lower its velocity_gain, or the drive's, or take a shorter "
            "period_s)"
        )
    return (
        f"{what}: the loop that controls it is soft, and the axis jumps where it breaks away (raise its velocity_gain, "
        "or the experiment's velocity, for a better model)"
    )


def _reversals(velocity: Array, least: float) -> int:
    """How often a velocity (n,) changes its sign, where it is above ``least``."""
    signs = np.sign(velocity[np.abs(velocity) > least])
    return int(np.count_nonzero(signs[1:] != signs[:-1]))


def _with_torque(recording: Recording, mode: str) -> Recording:
    """The recording of an experiment; of a drive that does not tell its torque, with the commanded one as it acted.

    Raises
    ------
    TuningError
        The command is not the whole torque either.
    """
    [facts] = (each for each in recording.metadata["facts"] if each["name"] == recording.axis)
    if facts["torque_delay_s"] is not None:
        return recording
    if mode != "cst":
        raise TuningError(
            f"{recording.axis}: its drive does not tell its torque, and in mode {mode} nobody else knows it; "
            "tune it in mode cst"
        )
    time_s, delay_s = recording["time_s"], facts["actuation_delay_s"] + 0.5 * recording.period_s  # a mean, as measured
    recording.columns["torque"] = np.interp(time_s - delay_s, time_s, recording["command"])
    recording.problems.append("the drive does not tell its torque: the commanded one is taken")
    return recording


def _candidates(found: Sequence[Identification]) -> list[tuple[Identification, Fit]]:
    """The best sound static fit and the best sound dynamic one, in the order in which they were looked for."""
    fits: dict[bool, tuple[Identification, Fit]] = {}
    for identification in found:
        for fit in identification.fits:
            if math.isfinite(fit.held_out.rmse) and _is_sound(fit):
                fits.setdefault(is_dynamic(fit.structure), (identification, fit))
    return list(fits.values()) or [(found[0], found[0].best)]


def _is_sound(fit: Fit) -> bool:
    """Whether the data determine a fit, and no parameter of a static one ran into a bound.

    Around a reversal presliding looks like a level near zero at standstill; fed forward by a model that has no
    presliding, that takes the torque away just where the axis reverses.
    """
    is_at_bound = any(each.name in fit.estimate.at_bound for each in fit.structure.coordinates)
    return is_determined(fit) and (is_dynamic(fit.structure) or not is_at_bound)


def _names(configuration: Configuration, wanted: Sequence[str]) -> tuple[str, ...]:
    for name in wanted:
        if name not in configuration.axes:
            raise UsageError(f"no axis is called {name!r}; {choices(name, configuration.axes)}")
    return tuple(dict.fromkeys(wanted)) or tuple(configuration.axes)


def _claim(folder: Path) -> None:
    """Make the folder; refuse one in which something is."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        is_empty = not any(folder.iterdir())
    except OSError as error:
        raise UsageError(f"{folder} cannot be made: {error.strerror}; name another folder with --output") from None
    if not is_empty:
        raise UsageError(f"{folder} is not empty: what is in it stays; name another folder with --output")


def _rank(candidate: Candidate) -> tuple[bool, float]:
    trial = candidate.trial
    return not trial.has_helped, trial.compensated.rms * trial.compensated.peak


def _written(path: Path, model: dict[str, Any]) -> Path:
    """Write a model file that can be read again."""
    ModelFile.model_validate(model)
    try:
        path.write_text(dump(model), encoding="utf-8")
    except OSError as error:
        raise FrictionHilError(f"{path} cannot be written: {error.strerror}") from None
    return path
