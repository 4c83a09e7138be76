"""Commissioning on the drive, step by step: experiment, identification, candidates, trials, choice."""

import contextlib
import math
import shlex
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from friction_hil.config import Configuration
from friction_hil.config.load import only_driver
from friction_hil.errors import FrictionHilError, RecordingError, UsageError, internal_error
from friction_hil.identification.mechanics import Mechanics
from friction_hil.identification.settings import chosen_families
from friction_hil.identification.torque_timing import TorqueTiming
from friction_hil.models.model_file import ModelFile
from friction_hil.numerics.readable import POSITION_UNITS
from friction_hil.recordings import Recording, read, read_all
from friction_hil.tuning import thresholds as th
from friction_hil.tuning.analysis import Analysis, analysed, compile_ahead
from friction_hil.tuning.announcement import allowed_speeds, experiment_text, once_more_text, shaken_text, trial_text
from friction_hil.tuning.arm import JointCheck, check_joint, refuse_torque_loops, without_weight
from friction_hil.tuning.arm_box import has_box, refuse_plan
from friction_hil.tuning.beside import Worker
from friction_hil.tuning.candidates import CandidateFit, ExperimentPart, candidates, slow_sweeps
from friction_hil.tuning.choice import SCALED, TriedModel, Turn, best_of, keep_best
from friction_hil.tuning.cogging import large_position_torque
from friction_hil.tuning.experiment import refuse_limit_cycle, with_torque
from friction_hil.tuning.gains import Gains, GainTrial
from friction_hil.tuning.model_files import inertia_problem, model_content, refuse_unwritable_model, write_model
from friction_hil.tuning.motions import (
    experiment_of,
    experiment_run,
    refuse_shared_beam,
    shaken_run,
    sliding_part,
    trial_run,
    uncompensated,
)
from friction_hil.tuning.outcome import Tuning
from friction_hil.tuning.rehearsed import RehearsedFit, rehearsal_text, to_try
from friction_hil.tuning.runs import Seconds, TuningRuns
from friction_hil.tuning.sequential import ExperimentResult, Observer, part_durations
from friction_hil.tuning.settings import Dialog, TuneSettings, chosen_axes, claim
from friction_hil.tuning.torque_lag import TorqueLag, find_torque_lag, with_torque_lag
from friction_hil.tuning.torque_ratio import TorqueRatio, find_torque_ratio, refuse_turned_torque, with_torque_ratio

_WITHOUT = "trial_without.mcap"


def tune(configuration: Configuration, settings: TuneSettings, dialog: Dialog) -> Tuning:
    """Identify the friction of axes on their drives, and keep the models that reduce the following error.

    1. Experiment: one axis after another moves as its ``experiment`` allows, uncompensated, the others being held, in
       parts, until what is unknown of its friction does not matter for its own motion any more; if wanted, it is
       shaken while it slides, too.
    2. Identification: friction models and mechanics of each axis from its recording, dynamic models from all of it and
       static ones from where the axis slides. Where torque over the position is as large, also from its own motion.
    3. Candidates: each model compensates each plausible axis in simulation, with the loops that the experiment showed;
       the best two or three that swing nowhere are tried. This and the identification are computed by another process,
       while other axes make their experiments, and all of them the first run of the trial.
    4. Trials: all axes make their own motion, slow, small, tiny and fast ones, and strokes with rests; first without
       compensation, then again with each candidate, and with the best one at other gains.
    5. Torque lag and ratio: how the reported torque follows the commanded one in the trial. Where it clearly is another
       multiple of it than the model says, the best model is scaled by that, and tried once more.
    6. Choice: the candidate with the smallest following error that does harm in no motion. If it helped and the
       configuration names a model file that does not exist, it is written there; an existing file is left as it is.

    ``configuration``: from `friction_hil.config.load`; its model files need not exist.

    Raises `OptionError` or `UsageError`: the configuration lacks a key that tuning needs, or the folder is not empty;
    `TuningError`: a run met a fault; `KeyboardInterrupt`: the user stopped a run, and the axes are at rest.

    An exception that is raised after motion has a note with the recordings that are kept, and how to go on from them.
    """
    only_driver(configuration)
    if configuration.bus is not None and configuration.bus.role == "sidecar":
        raise UsageError(
            "with bus.role: sidecar another controller moves the axes, so 'tune' cannot: record its motion with 'run', "
            "and identify the friction from the recording with 'identify'"
        )
    names = chosen_axes(configuration, settings.names)
    chosen_families(settings.families)
    refuse_torque_loops(configuration)
    for name in names:
        refuse_shared_beam(name, configuration)
        experiment_of(name, configuration.axes[name])
        if not settings.is_simulated:
            refuse_unwritable_model(name, configuration.axes[name])
    claim(settings.folder)
    worker = Worker()
    tuner = _Tuner(configuration, settings, names, dialog, worker)
    try:
        with worker:
            return tuner.tune()
    except Exception as error:
        if kept := tuner.kept():
            error.add_note(kept)
        raise
    finally:
        with contextlib.suppress(OSError):
            settings.folder.rmdir()  # only if it is still empty


class _Tuner:
    def __init__(
        self,
        configuration: Configuration,
        settings: TuneSettings,
        names: Sequence[str],
        dialog: Dialog,
        worker: Worker,
    ) -> None:
        self._configuration, self._settings, self._names, self._dialog = configuration, settings, names, dialog
        self._runs, self._worker, self._seconds = TuningRuns(settings, dialog), worker, Seconds()
        self._warnings: list[str] = []
        self._mechanics: dict[str, Mechanics] = {}
        self._joints: dict[str, JointCheck] = {}
        self._of_arm = frozenset(() if configuration.arm is None else configuration.arm.joints)
        self._resolutions: dict[str, float] = {}  # of the encoders, found in the experiments
        self._timings: dict[str, TorqueTiming] = {}
        self._torque_lags: dict[str, TorqueLag] = {}
        self._torque_ratios: dict[str, TorqueRatio] = {}
        self._experiments: dict[str, ExperimentResult] = {}
        self._gains: dict[str, Gains] = {}
        self._all_rehearsed: dict[str, tuple[RehearsedFit, ...]] = {}
        self._recorded: dict[str, list[Path]] = {}  # complete parts of experiments, by axis

    def kept(self) -> str:
        """Return which recordings there are, and how to identify from them; empty if nothing has moved."""
        if not self._runs.recordings:
            return ""
        lines = [f"The recordings made so far are kept: {', '.join(map(str, self._runs.recordings))}."]
        for name, paths in self._recorded.items():
            files = shlex.join(map(str, paths))
            target = shlex.quote(str(self._settings.folder / f"{name}_identified.yaml"))
            lines.append(f"To go on from them: friction-hil identify {files} --axis {name} --output {target}")
        return "\n".join(lines)

    def tune(self) -> Tuning:
        """Carry out all steps; see `tune`."""
        recorded, jobs, is_shaken = {}, {}, self._settings.is_shaken
        if has_box(self._configuration):
            refuse_plan(self._configuration, self._names, self._runs.look(self._configuration), is_shaken=is_shaken)
        for name in self._names:
            recorded[name] = self._experiment(name)
            if not is_shaken:
                jobs[name] = self._submit(name, recorded[name], {})
        for name in self._names if is_shaken else ():
            jobs[name] = self._submit(name, recorded[name], self._shake(name))
        without = self._trial_ahead()
        for name in self._names if without is not None and not is_shaken else ():
            self._look_over_positions(jobs[name], recorded[name], (without or {})[name])
        recorded.clear()
        tried = self._trials({name: self._candidates(name, job) for name, job in jobs.items()}, without)
        is_simulated = self._settings.is_simulated
        axes = {
            name: keep_best(
                self._configuration.axes[name],
                each,
                self._file(name),
                tuple(self._gains[name].tried),
                is_simulated=is_simulated,
            )
            for name, each in tried.items()
        }
        return Tuning(
            axes,
            self._runs.recordings,
            [*self._runs.warnings, *self._warnings],
            torque_lags=self._torque_lags,
            torque_ratios=self._torque_ratios,
            experiments=self._experiments,
            leftovers=self._runs.leftovers,
            rehearsed=self._all_rehearsed,
            joints=self._joints,
            seconds=self._seconds,
        )

    def _run(self, run: Configuration, duration_s: float, file: str, speeds: Mapping[str, float]) -> Path:
        """Record a run, while the worker goes on beside it."""
        with self._worker.aside(), self._seconds.moving(duration_s):
            return self._runs.run(run, duration_s, file, speeds)

    def _confirm(self, text: str) -> None:
        with self._seconds.asking():
            self._dialog.confirm(text)

    def _submit(self, name: str, parts: Sequence[ExperimentPart], shaken: Mapping[str, Recording]) -> int:
        """Have the worker identify an axis and rehearse its models; return the number of that job."""
        held = dict(shaken)
        own = [held.pop(name)] if held else []
        return self._worker.submit(analysed, self._configuration, self._settings.families, parts, own, held, None)

    def _look_over_positions(self, job: int, parts: Sequence[ExperimentPart], without: Recording) -> None:
        """Have an axis identified over the positions of its own motion, if they change its torque by much."""
        name, configuration = without.axis, self._configuration
        if name in self._of_arm:  # the others move too: weight and coupling that they change look like such a torque
            return
        try:
            own = with_torque(without, configuration.axes[name].mode)
            with self._dialog.working(f"{name}: looking for a torque that depends on the position"):
                whole = large_position_torque(*slow_sweeps(parts, configuration, ("coulomb",)), own)
        except RecordingError:  # the axis hardly slides
            return
        except Exception as error:  # noqa: BLE001  it costs the positions, not the models
            self._warn(f"{name}: positions are not looked at, because of {internal_error(error)}")
            return
        if whole is not None:
            self._dialog.report(f"{name}: {whole.text}")
            self._worker.replace(job, configuration, self._settings.families, parts, [], {}, whole)

    def _trial_ahead(self) -> dict[str, Recording] | None:
        """Record the run of the trial without compensation, if no model matters for it; None if one does."""
        axes = {name: self._configuration.axes[name] for name in self._names}
        if any(
            axis.mode == "cst" or axis.compensation.velocity == "kalman" or axis.compensation.adaptation is not None
            for axis in axes.values()
        ):
            return None
        models = {name: axis.model for name, axis in axes.items()}
        run, duration_s = trial_run(self._configuration, models, self._resolutions)
        bounds = {name: experiment_of(name, axis) for name, axis in axes.items()}
        self._confirm(trial_text(run, bounds, [], duration_s))
        return read_all(self._run(uncompensated(run), duration_s, _WITHOUT, allowed_speeds(run, bounds)))

    def _experiment(self, name: str) -> list[ExperimentPart]:
        """Record the experiment of an axis, part by part, until what is unknown does not matter any more."""
        bounds = experiment_of(name, self._configuration.axes[name])
        lengths = part_durations(bounds.duration_s)
        runs = [experiment_run(self._configuration, name, length_s) for length_s in lengths]
        duration_s = math.fsum(duration_s for _, duration_s in runs)
        self._confirm(experiment_text(runs[0][0], name, bounds, duration_s, lengths))
        speeds = allowed_speeds(runs[0][0], {name: bounds})
        observer = Observer(self._configuration, name)
        parts: list[ExperimentPart] = []
        unknown, problem = None, ""
        for number, (length_s, (run, duration_s)) in enumerate(zip(lengths, runs, strict=True), start=1):
            file = f"{name}_experiment{f'_{number}' if len(lengths) > 1 else ''}.mcap"
            parts.append(ExperimentPart(self._part(name, run, duration_s, file, speeds, length_s), length_s))
            if number == 1 < len(lengths):  # whatever it shows is confirmed by a second part
                self._worker.submit(compile_ahead, self._configuration, self._settings.families, parts[0])
                continue
            if problem:
                continue
            try:
                with self._dialog.working(f"{name}: estimating what is unknown of the friction"):
                    for part in parts if number == 2 else parts[-1:]:
                        unknown = observer.take(part)
            except FrictionHilError as error:
                unknown, problem = None, str(error)
                continue
            if unknown is not None and unknown.is_negligible:
                break
            if unknown is not None and number < len(lengths):
                self._dialog.report(f"{name}: after {sum(lengths[:number]):g} s: {unknown.text}")
        result = ExperimentResult(tuple(each.duration_s for each in parts), bounds.duration_s, unknown, problem)
        self._experiments[name] = result
        for text in (*dict.fromkeys(each for part in parts for each in part.recording.problems), result.text):
            self._dialog.report(f"{name}: {text}")
        return parts

    def _part(
        self, name: str, run: Configuration, duration_s: float, file: str, speeds: Mapping[str, float], part_s: float
    ) -> Recording:
        """Record a part of the experiment of an axis, with a torque."""
        axis = self._configuration.axes[name]
        path = self._run(run, duration_s, file, speeds)
        self._recorded.setdefault(name, []).append(path)
        recording = read(path, name)
        [facts] = (each for each in recording.metadata["facts"] if each["name"] == name)
        self._resolutions[name] = facts["position_resolution"]
        unit = POSITION_UNITS[axis.model.axis]
        slow = sliding_part(recording, self._configuration, part_s)
        if warning := refuse_limit_cycle(slow, experiment_of(name, axis).velocity, unit):
            self._warn(warning)
        recording = with_torque(recording, axis.mode)
        refuse_turned_torque(recording, axis)
        return recording

    def _shake(self, name: str) -> dict[str, Recording]:
        """Record an axis that is shaken while it slides, and the others, which are held."""
        bounds = experiment_of(name, self._configuration.axes[name])
        run, duration_s = shaken_run(self._configuration, name)
        self._confirm(shaken_text(run, name, bounds, duration_s))
        speeds = allowed_speeds(run, {name: bounds})
        recorded = read_all(self._run(run, duration_s, f"{name}_shaken.mcap", speeds))
        return {**recorded, name: with_torque(recorded[name], run.axes[name].mode)}

    def _candidates(self, name: str, job: int) -> list[CandidateFit]:
        """Return the models to try on an axis by its analysis, and write the first of them."""
        with self._dialog.working(f"{name}: identifying friction and inertia") as show:
            analysis: Analysis = self._worker.result(job, show)
        for problem in analysis.problems:
            self._warn(f"{name}: {problem}")
        timings = [each.torque for each in analysis.found if each.torque is not None]
        if timings:
            self._timings.setdefault(name, timings[0])
        for text in dict.fromkeys(each.text for each in timings):
            self._dialog.report(f"{name}: {text}")
        for each in analysis.found:
            self._dialog.report(f"{name}: {each.best.label}: {each.reason}")
        mechanics = self._mechanics[name] = analysis.mechanics
        for line in (*mechanics.lines, *mechanics.notes):
            self._dialog.report(f"{name}: {line}")
        for flag in mechanics.flags:
            self._warn(f"{name}: {flag}")
        chosen = self._chosen(name, analysis)
        for _, fit in chosen:
            if problem := inertia_problem(fit):
                self._dialog.report(f"{name}: {fit.label}: {problem}; the model file keeps the former one")
        self._check_joint(name, chosen[0])
        write_model(self._file(name), self._content(name, chosen[0]))
        return chosen

    def _check_joint(self, name: str, best: CandidateFit) -> None:
        """Compare what the experiment shows of a joint of the arm with the arm's file."""
        if name not in self._of_arm:
            return
        model = model_content(*best, self._configuration.axes[name], self._mechanics[name])
        recorded = read_all(self._recorded[name][-1])
        self._joints[name] = found = check_joint(self._configuration, recorded, model, best[1], name)
        self._dialog.report(f"{name}: {found.text}")
        self._warnings += (f"{name}: {text}" for text in found.contradictions)

    def _content(self, name: str, pair: CandidateFit) -> dict[str, Any]:
        """Return the model file of a fit as it is tried; a joint of the arm has its weight from there."""
        model = model_content(*pair, self._configuration.axes[name], self._mechanics[name])
        return without_weight(model, pair[1], self._joints[name]) if name in self._joints else model

    def _chosen(self, name: str, analysis: Analysis) -> list[CandidateFit]:
        """Return the models to try: the best ones of the rehearsal, or where there was none, the best fits."""
        rehearsed = analysis.rehearsed
        if not rehearsed:
            text = f"{name}: the models are not rehearsed in simulation"
            if analysis.is_internal:
                self._warn(f"{text}, because of {analysis.unrehearsed}")
            else:
                self._dialog.report(f"{text}: {analysis.unrehearsed}")
            return candidates(analysis.found)
        self._all_rehearsed[name] = rehearsed
        for each in rehearsed:
            self._dialog.report(f"{name}: {rehearsal_text(each)}")
        chosen = to_try(rehearsed)
        if rehearsed[0].swings:
            self._dialog.report(f"{name}: each model makes the axis oscillate or follow worse in some simulated motion")
        self._dialog.report(f"{name}: to be tried on the axis: {', '.join(fit.label for _, fit in chosen)}")
        return chosen

    def _trials(
        self, chosen: Mapping[str, Sequence[CandidateFit]], without: Mapping[str, Recording] | None
    ) -> dict[str, tuple[TriedModel, ...]]:
        """Try every candidate of each axis; an axis with fewer than the others repeats its last one, uncounted.

        All runs are the same motion; the first is without compensation, for all candidates. ``without``: its
        recording, if there is one already.
        """
        turns = self._turns(chosen)
        bounds = {name: experiment_of(name, self._configuration.axes[name]) for name in self._names}
        first = turns[0]
        labels = [{name: fit.label for name, (_, fit) in turn.fits.items()} for turn in turns]
        self._confirm(trial_text(first.run, bounds, labels, first.duration_s, has_baseline=without is not None))
        speeds = allowed_speeds(first.run, bounds)

        def recorded(run: Configuration, file: str) -> dict[str, Recording]:
            return read_all(self._run(run, first.duration_s, file, speeds))

        if without is None:
            without = recorded(uncompensated(first.run), _WITHOUT)
        tried: dict[str, list[TriedModel]] = {name: [] for name in self._names}
        runs: dict[str, list[Recording]] = {name: [] for name in self._names}
        for k, turn in enumerate(turns):
            try:
                compensated = recorded(turn.run, f"trial_{k + 1}.mcap")
                found = {name: turn.judged(name, without[name], compensated[name]) for name in self._names}
            except Exception as error:
                if not k:
                    raise  # later, the first models have been tried and are worth keeping
                why = error if isinstance(error, FrictionHilError) else internal_error(error)
                self._warnings.append(f"the models of trial {k + 1} could not be tried: {why}")
                break
            for name in self._names:
                runs[name].append(compensated[name])
                if k < len(chosen[name]):
                    tried[name].append(found[name])
        if again := self._scaled_turn(tried, without, runs):
            names = {
                name: f"{pair[1].label}{SCALED if name in again.scaled else ''}" for name, pair in again.fits.items()
            }
            self._confirm(once_more_text(first.run, bounds, names, first.duration_s))
            try:
                compensated = recorded(again.run, f"trial_{len(turns) + 1}.mcap")
                for name in again.scaled:
                    tried[name].append(again.judged(name, without[name], compensated[name]))
            except FrictionHilError as error:
                self._warnings.append(f"the scaled models could not be tried: {error}")
        self._try_gains(tried, without, recorded)
        return {name: self._with_torque_lag(each, without[name], runs[name]) for name, each in tried.items()}

    def _try_gains(
        self,
        tried: Mapping[str, Sequence[TriedModel]],
        without: Mapping[str, Recording],
        record: Callable[[Configuration, str], dict[str, Recording]],
    ) -> None:
        """Try other gains with the best model of each axis, as long as they are better."""
        best = {name: best_of(tuple(each)) for name, each in tried.items()}
        fits = {name: (each.identification, each.fit) for name, each in best.items()}
        files = {name: each.model for name, each in best.items()}
        for name, each in best.items():
            given, unknown = self._configuration.axes[name].compensation, self._experiments[name].unknown
            self._gains[name] = Gains(given, each.trial, unknown, each.clipping)
        for number in range(1, th.MOST_GAINS + 1):
            gains = {name: gain for name, each in self._gains.items() if (gain := each.next()) is not None}
            if not gains:
                return
            turn = Turn(fits, files, *self._run_with(files, gains))
            try:
                compensated = record(turn.run, f"trial_gain_{number}.mcap")
                for name, gain in gains.items():
                    found = turn.judged(name, without[name], compensated[name])
                    self._gains[name].tried.append(GainTrial(gain, found.trial, found.clipping))
            except FrictionHilError as error:
                said = ", ".join(f"{gain:g} ({name})" for name, gain in gains.items())
                self._warnings.append(f"gain {said} could not be tried: {error}")
                return

    def _scaled_turn(
        self,
        tried: Mapping[str, Sequence[TriedModel]],
        without: Mapping[str, Recording],
        compensated: Mapping[str, Sequence[Recording]],
    ) -> Turn | None:
        """Return the run with the best models, scaled to the commanded torque; None if all of them have its size."""
        best = {name: best_of(tuple(each)) for name, each in tried.items()}
        files = {name: each.model for name, each in best.items()}
        scaled = set()
        for name in best:
            try:
                found = find_torque_ratio(without[name], compensated[name], self._configuration.axes[name])
            except FrictionHilError:
                raise
            except Exception as error:  # noqa: BLE001  it costs the ratio, not the models
                self._warn(f"{name}: the torque ratio is not looked for, because of {internal_error(error)}")
                continue
            self._torque_ratios[name] = found
            if found.is_other and found.estimate is not None:
                files[name] = with_torque_ratio(files[name], found.estimate.ratio, found.estimate.error)
                scaled.add(name)
        if not scaled:
            return None
        fits = {name: (each.identification, each.fit) for name, each in best.items()}
        return Turn(fits, files, *self._run_with(files), scaled)

    def _warn(self, text: str) -> None:
        self._dialog.report(text)
        self._warnings.append(text)

    def _run_with(
        self, files: Mapping[str, dict[str, Any]], gains: Mapping[str, float] | None = None
    ) -> tuple[Configuration, float]:
        models = {name: ModelFile.model_validate(model) for name, model in files.items()}
        return trial_run(self._configuration, models, self._resolutions, gains)

    def _with_torque_lag(
        self, tried: Sequence[TriedModel], without: Recording, compensated: Sequence[Recording]
    ) -> tuple[TriedModel, ...]:
        """Return the tried models of an axis with the torque lag that the trial shows."""
        name = without.axis
        try:
            lag = find_torque_lag(without, compensated, self._configuration.axes[name], self._timings.get(name))
        except FrictionHilError:
            raise
        except Exception as error:  # noqa: BLE001  it costs the lag, not the models
            self._warn(f"{name}: the torque lag is not looked for, because of {internal_error(error)}")
            return tuple(tried)
        self._torque_lags[name] = lag
        return tuple(with_torque_lag(each, lag) for each in tried)

    def _turns(self, chosen: Mapping[str, Sequence[CandidateFit]]) -> list[Turn]:
        """Return the runs of the trial, each with one candidate of each axis."""
        turns: list[Turn] = []
        for k in range(max(map(len, chosen.values()))):
            fits = {name: each[min(k, len(each) - 1)] for name, each in chosen.items()}
            files = {name: self._content(name, each) for name, each in fits.items()}
            try:
                turns.append(Turn(fits, files, *self._run_with(files)))
            except FrictionHilError as error:
                if not k:
                    raise
                self._warnings.append(f"the models of trial {k + 1} could not be tried: {error}")
                break
        return turns

    def _file(self, name: str) -> Path:
        return self._settings.folder / f"{name}.yaml"
