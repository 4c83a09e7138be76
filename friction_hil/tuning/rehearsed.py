"""Rehearsal of the candidates before any of them is tried on the drive. Pure.

Each candidate compensates each plausible axis in simulation: the identified loops and mechanics with the friction of
each dynamic fit, weighted by how well that fit predicts what it was not fitted to. So a candidate that only fits,
and swings in the loop, is found out before it moves anything, and one that helps whatever the friction really is comes
first.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial

from friction_hil.config import Configuration
from friction_hil.daemon.safety import LoopState
from friction_hil.errors import RecordingError, UsageError
from friction_hil.identification import Fit, Identification, plausible_fits
from friction_hil.identification.choice import log_likelihood_gain
from friction_hil.identification.fits import ENDED_EARLY
from friction_hil.identification.refine import is_dynamic
from friction_hil.models.model_file import ModelFile
from friction_hil.parallel import in_parallel
from friction_hil.recordings import Recording
from friction_hil.rehearsal import Motion, Outcome, Rehearsal
from friction_hil.replay.verify import facts_of
from friction_hil.servo.config import ServoConfig
from friction_hil.tuning import thresholds as th
from friction_hil.tuning.candidates import CandidateFit
from friction_hil.tuning.model_files import model_content
from friction_hil.tuning.motions import experiment_of, own_motion
from friction_hil.tuning.rehearsal_motions import rehearsal_motions
from friction_hil.tuning.settings import ShowStep
from friction_hil.tuning.simulated import drive_loops, simulated_axis


@dataclass(frozen=True, slots=True, eq=False)
class RehearsedFit:
    """A fit and what it does in simulation."""

    identification: Identification
    fit: Fit
    # predicted factors by which RMS and peak of the following error fall, by motion; geometric means over the plausible
    # axes
    reductions: dict[str, tuple[float, float]]
    swings: tuple[str, ...]  # motions in which it swings, or makes the following error larger, on some plausible axis

    @property
    def label(self) -> str:
        """Name of the model, with the way in which it was fitted."""
        return self.fit.label

    @property
    def worst(self) -> str:
        """Motion with the smallest reduction of the RMS."""
        return min(self.reductions, key=lambda name: self.reductions[name][0])

    @property
    def score(self) -> float:
        """Geometric mean of all reductions."""
        logs = [math.log(each) for pair in self.reductions.values() for each in pair]
        return math.exp(sum(logs) / len(logs))


def rehearse(
    recording: Recording, configuration: Configuration, found: Sequence[Identification], show: ShowStep | None = None
) -> tuple[RehearsedFit, ...]:
    """Return the fits of an axis with what they do in simulation: those that do not swing first, best first.

    ``recording``: of the experiment, with a torque. ``configuration``: from which that run was made. ``found``: of that
    recording. ``show``: called before each simulation.

    Raises `RecordingError`: the loops of the drive, or any friction that can be simulated, are not known.
    """
    axis = configuration.axes[recording.axis]
    facts = facts_of(recording.metadata, recording)
    running = recording.at(recording["state"] == LoopState.RUNNING)
    period_s, resolution = configuration.period_s, facts.position_resolution
    loops = drive_loops(running, axis, resolution)
    fits = [pair for each in found for pair in _worth_a_rehearsal(each)]
    models = [ModelFile.model_validate(model_content(*pair, axis)) for pair in fits]
    servos = {
        k: servo
        for k, model in enumerate(models)
        if (servo := simulated_axis(model, fits[k][1].mechanics["inertia"], loops, running, period_s, resolution))
        is not None
    }
    weights = _weights({k: fits[k][1] for k in servos})
    if not weights:
        raise RecordingError(f"{recording.axis}: no friction that was identified can be simulated")
    simulations = _Simulations(
        Rehearsal(axis, facts, period_s),
        rehearsal_motions(own_motion(recording.axis, axis), experiment_of(recording.axis, axis), resolution),
        models,
        servos,
        (lambda *_: None) if show is None else show,
    )
    likeliest = max(weights, key=lambda k: weights[k])
    everyone = range(len(fits))
    simulations.run([likeliest], everyone)
    first = {k: _judged(*fits[k], {likeliest: 1.0}, simulations.outcomes([likeliest], k)) for k in everyone}
    order = sorted(everyone, key=lambda k: _rank(first[k]))
    finalists = order[: th.FINALISTS]
    simulations.run(list(weights), finalists)
    last = {k: _judged(*fits[k], weights, simulations.outcomes(list(weights), k)) for k in finalists}
    return (*sorted(last.values(), key=_rank), *(first[k] for k in order[th.FINALISTS :]))


class _Simulations:
    """Outcomes of motions with the friction of one fit, by index, and compensation by another, or by none."""

    def __init__(
        self,
        rehearsal: Rehearsal,
        motions: Mapping[str, Motion],
        models: Sequence[ModelFile],
        servos: Mapping[int, ServoConfig],
        show: ShowStep,
    ) -> None:
        self._rehearsal, self._motions, self._models, self._servos = rehearsal, motions, models, servos
        self._show = show
        self._found: dict[tuple[int, int | None, str], Outcome] = {}

    def run(self, frictions: Sequence[int], assumed: Sequence[int]) -> None:
        """Simulate all combinations, on all cores."""
        jobs = [(k, other, name) for k in frictions for other in (None, *assumed) for name in self._motions]
        jobs = [job for job in jobs if job not in self._found]
        found = in_parallel(
            [partial(self._simulate, job) for job in jobs],
            lambda number: self._show(f"rehearsal in simulation: {jobs[number][2]}", number + 1, len(jobs)),
        )
        self._found.update(zip(jobs, found, strict=True))

    def _simulate(self, job: tuple[int, int | None, str]) -> Outcome:
        friction, assumed, name = job
        model = self._models[friction if assumed is None else assumed]
        motion = self._motions[name]
        try:
            return self._rehearsal.run(self._servos[friction], model, motion, is_compensated=assumed is not None)
        except UsageError:  # e.g. velocity: kalman, and this fit has no inertia: it cannot be tried either
            return Outcome(math.inf, math.inf, 0.0)

    def outcomes(self, frictions: Sequence[int], assumed: int) -> dict[str, dict[int, tuple[Outcome, Outcome]]]:
        """Return the outcomes without and with compensation, by motion and friction."""
        return {
            name: {k: (self._found[k, None, name], self._found[k, assumed, name]) for k in frictions}
            for name in self._motions
        }


def _rank(rehearsed: RehearsedFit) -> tuple[bool, float]:
    return bool(rehearsed.swings), -rehearsed.score


def to_try(rehearsed: Sequence[RehearsedFit]) -> list[CandidateFit]:
    """Return the fits to try on the drive, of those that swing nowhere: the best one, and others close to it.

    Each is the best one of its family and of its origin: in closed loop, from the torque, or where the axis slides. All
    fits of one origin share its errors, because the same data have bent their curves. So the second one, if any is
    close, has another origin than the best one. If none is close, it is the next one all the same, in case the best one
    does not do on the drive what it did in simulation.
    """
    steady = [each for each in rehearsed if not each.swings] or list(rehearsed[:1])
    best = steady[0]
    kinds: dict[tuple[str, tuple[bool, bool]], RehearsedFit] = {}
    for each in steady:
        kinds.setdefault((each.fit.structure.family, _origin(each)), each)
    others = [each for each in kinds.values() if each is not best]
    close = [each for each in others if each.score * th.TOLD_APART >= best.score] or others[:1]
    second = [each for each in close if _origin(each) != _origin(best)][:1]
    tried = [best, *second, *(each for each in close if each not in second)][: th.MOST_TRIED]
    return [(each.identification, each.fit) for each in tried]


def _origin(rehearsed: RehearsedFit) -> tuple[bool, bool]:
    """Return whether a fit was made in closed loop, and whether it has presliding."""
    return rehearsed.fit.is_closed_loop, is_dynamic(rehearsed.fit.structure)


def rehearsal_text(rehearsed: RehearsedFit) -> str:
    """Return a sentence on what a fit does in simulation."""
    text = (
        f"{rehearsed.label}: following error {rehearsed.score:.1f} times lower in "
        f"simulation, {rehearsed.reductions[rehearsed.worst][0]:.1f} times at worst ({rehearsed.worst})"
    )
    if not rehearsed.swings:
        return text
    return f"{text}; the axis oscillates or follows worse: {', '.join(rehearsed.swings)}"


def _worth_a_rehearsal(identification: Identification) -> list[tuple[Identification, Fit]]:
    """Return the plausible fits whose errors compare with that of the chosen one; those that ended early are rough."""
    if identification.best.is_closed_loop:
        return [(identification, each) for each in identification.fits]
    compared = identification.groups[0][1]
    fits = [each for each in plausible_fits(identification) if each in compared and ENDED_EARLY not in each.flags]
    return [(identification, each) for each in fits[: th.MOST_CANDIDATES]]


def _weights(fits: Mapping[int, Fit]) -> dict[int, float]:
    """Return the weights of plausible frictions by index: how likely each fit is, by the data held out from it.

    A fit that is worse than the best one by z standard errors of their difference weighs exp(-z^2 / 2). Only fits whose
    errors refer to the same rows are compared: those in closed loop, which tell models apart best, else dynamic ones.
    """
    closed = {k: fit for k, fit in fits.items() if fit.is_closed_loop}
    dynamic = {k: fit for k, fit in fits.items() if is_dynamic(fit.structure)}
    errors = {k: fit.held_out for k, fit in (closed or dynamic or fits).items()}
    if not errors:
        return {}
    first = next(iter(errors.values()))
    best = max(errors.values(), key=lambda each: log_likelihood_gain(each, first)[0])
    weights: dict[int, float] = {}
    for k, error in errors.items():
        gain, doubt = log_likelihood_gain(best, error)
        weights[k] = math.exp(-0.5 * (gain / doubt) ** 2) if gain > 0.0 < doubt else float(gain <= 0.0)
    likely = sorted(weights, key=lambda k: -weights[k])[: th.MOST_AXES]
    kept = {k: weights[k] for k in likely if weights[k] >= th.LEAST_WEIGHT * weights[likely[0]] > 0.0}
    return {k: weight / sum(kept.values()) for k, weight in kept.items()}


def _judged(
    identification: Identification,
    fit: Fit,
    weights: Mapping[int, float],
    outcomes: Mapping[str, Mapping[int, tuple[Outcome, Outcome]]],
) -> RehearsedFit:
    reductions: dict[str, tuple[float, float]] = {}
    swings = []
    for name, each in outcomes.items():
        swinging = {
            k for k, (without, with_) in each.items() if with_.gain_factor < th.SWING or with_.rms > without.rms
        }
        ratios = {
            k: (th.SWINGING_REDUCTION, th.SWINGING_REDUCTION)
            if k in swinging
            else (_ratio(without.rms, with_.rms), _ratio(without.peak, with_.peak))
            for k, (without, with_) in each.items()
        }
        rms, peak = (_mean({k: pair[i] for k, pair in ratios.items()}, weights) for i in range(2))
        reductions[name] = (rms, peak)
        if sum(weights[k] for k in swinging) > th.DOUBTFUL_WEIGHT:
            swings.append(name)
    return RehearsedFit(identification, fit, reductions, tuple(swings))


def _ratio(without: float, with_: float) -> float:
    return min(max(without / with_, 1.0 / th.LARGEST_REDUCTION), th.LARGEST_REDUCTION) if with_ > 0.0 else 1.0


def _mean(ratios: Mapping[int, float], weights: Mapping[int, float]) -> float:
    """Return the weighted geometric mean."""
    return math.exp(sum(weights[k] * math.log(ratio) for k, ratio in ratios.items()))
