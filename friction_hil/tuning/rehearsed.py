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
from typing import Any

import numpy as np
from pydantic import ValidationError

from friction_hil.config import AxisConfig, Configuration, from_dict
from friction_hil.daemon.safety import LoopState
from friction_hil.errors import FrictionHilError, RecordingError, UsageError
from friction_hil.identification import Fit, Identification, plausible_fits
from friction_hil.identification.choice import log_likelihood_gain
from friction_hil.identification.drive_loop import DriveLoops, identify_loops
from friction_hil.identification.fits import ENDED_EARLY
from friction_hil.identification.refine import is_dynamic
from friction_hil.identification.workers import in_parallel
from friction_hil.models.model_file import NETWORK, ModelFile
from friction_hil.recordings import Recording
from friction_hil.rehearsal import Motion, Outcome, Rehearsal
from friction_hil.replay.verify import facts_of
from friction_hil.servo.config import Encoder, Loops, Motor, ServoConfig, ServoMechanics, TrueFriction
from friction_hil.servo.parts import Gravity
from friction_hil.tuning.candidates import CandidateFit
from friction_hil.tuning.choice import model_content
from friction_hil.tuning.motions import experiment_of, own_motion
from friction_hil.tuning.rehearsal_motions import rehearsal_motions
from friction_hil.tuning.settings import ShowStep
from friction_hil.tuning.two_steps import label, steady_weights

SWING = 0.999  # factor left on the gain by the guard against limit cycles: below, the model swings
_MOST_CANDIDATES = 10  # of an identification
_FINALISTS = 5  # that are simulated on all plausible frictions; the others on the likeliest one
_MOST_AXES = 4  # plausible frictions
_LEAST_WEIGHT = 0.02  # of the likeliest: a less likely friction is not simulated
_DOUBTFUL_WEIGHT = 0.2  # of the frictions on which a candidate swings
_SWINGING_REDUCTION = 0.5  # for which a motion counts in which it swings
_LARGEST_REDUCTION = 20.0  # more is beyond what a simulation can tell
_MOST_TRIED = 3  # on the drive
_TOLD_APART = 1.3  # ratio of scores: smaller ones say nothing
_INTEGRATION_HZ = (40_000.0, 80_000.0, 160_000.0, 320_000.0, 640_000.0)  # tried in turn, for stiff friction
_WHOLE = 1e-6  # of an integration step
_PEAK_RATIO = 3.0  # torque of the drive over the largest that was recorded


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
        return label(self.identification, self.fit)

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
    weights = _weights({k: fits[k][1] for k in servos}, found)
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
    finalists = order[:_FINALISTS]
    simulations.run(list(weights), finalists)
    last = {k: _judged(*fits[k], weights, simulations.outcomes(list(weights), k)) for k in finalists}
    return (*sorted(last.values(), key=_rank), *(first[k] for k in order[_FINALISTS:]))


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

    Each is the best one of its family and of its origin: free, in two steps, or where the axis slides. All fits of one
    origin share its errors, because the same data have bent their steady curves. So the second one, if any is close,
    has another origin than the best one. If none is close, it is the next one all the same, in case the best one does
    not do on the drive what it did in simulation.
    """
    steady = [each for each in rehearsed if not each.swings] or list(rehearsed[:1])
    best = steady[0]
    kinds: dict[tuple[str, tuple[bool, bool]], RehearsedFit] = {}
    for each in steady:
        kinds.setdefault((each.fit.structure.family, _origin(each)), each)
    others = [each for each in kinds.values() if each is not best]
    close = [each for each in others if each.score * _TOLD_APART >= best.score] or others[:1]
    second = [each for each in close if _origin(each) != _origin(best)][:1]
    tried = [best, *second, *(each for each in close if each not in second)][:_MOST_TRIED]
    return [(each.identification, each.fit) for each in tried]


def _origin(rehearsed: RehearsedFit) -> tuple[bool, bool]:
    """Return whether the steady curve of a fit was held, and whether the fit has presliding."""
    return bool(rehearsed.identification.settings.held), is_dynamic(rehearsed.fit.structure)


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
    compared = identification.groups[0][1]
    fits = [each for each in plausible_fits(identification) if each in compared and ENDED_EARLY not in each.flags]
    return [(identification, each) for each in fits[:_MOST_CANDIDATES]]


def _weights(fits: Mapping[int, Fit], found: Sequence[Identification]) -> dict[int, float]:
    """Return the weights of plausible frictions by index: how likely each fit is, by the data held out from it.

    A fit that is worse than the best one by z standard errors of their difference weighs exp(-z^2 / 2). Only fits whose
    errors refer to the same rows are compared: dynamic ones, if there are any. These also have to predict the friction
    where the axis slides.
    """
    dynamic = {k: fit for k, fit in fits.items() if is_dynamic(fit.structure)}
    compared = dynamic or fits
    if not compared:
        return {}
    errors = {k: fit.held_out for k, fit in compared.items()}
    first = next(iter(errors.values()))
    best = max(errors.values(), key=lambda each: log_likelihood_gain(each, first)[0])
    steady = steady_weights(dynamic, found) if dynamic else dict.fromkeys(fits, 1.0)
    weights: dict[int, float] = {}
    for k, error in errors.items():
        gain, doubt = log_likelihood_gain(best, error)
        weights[k] = (
            steady[k] * math.exp(-0.5 * (gain / doubt) ** 2) if gain > 0.0 < doubt else steady[k] * (gain <= 0.0)
        )
    likely = sorted(weights, key=lambda k: -weights[k])[:_MOST_AXES]
    kept = {k: weights[k] for k in likely if weights[k] >= _LEAST_WEIGHT * weights[likely[0]] > 0.0}
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
        swinging = {k for k, (without, with_) in each.items() if with_.gain_factor < SWING or with_.rms > without.rms}
        ratios = {
            k: (_SWINGING_REDUCTION, _SWINGING_REDUCTION)
            if k in swinging
            else (_ratio(without.rms, with_.rms), _ratio(without.peak, with_.peak))
            for k, (without, with_) in each.items()
        }
        rms, peak = (_mean({k: pair[i] for k, pair in ratios.items()}, weights) for i in range(2))
        reductions[name] = (rms, peak)
        if sum(weights[k] for k in swinging) > _DOUBTFUL_WEIGHT:
            swings.append(name)
    return RehearsedFit(identification, fit, reductions, tuple(swings))


def _ratio(without: float, with_: float) -> float:
    return min(max(without / with_, 1.0 / _LARGEST_REDUCTION), _LARGEST_REDUCTION) if with_ > 0.0 else 1.0


def _mean(ratios: Mapping[int, float], weights: Mapping[int, float]) -> float:
    """Return the weighted geometric mean."""
    return math.exp(sum(weights[k] * math.log(ratio) for k, ratio in ratios.items()))


def drive_loops(recording: Recording, axis: AxisConfig, resolution: float) -> DriveLoops | None:
    """Return the identified loops of the drive, or None in CST, where the loops are those of the daemon.

    Raises `RecordingError`: the torque of the drive does not follow the usual loops.
    """
    if axis.mode == "cst":
        return None
    gain = axis.controller.position_gain if axis.controller is not None else 0.0
    return identify_loops(recording, axis.mode, resolution, gain)


def recorded_loops(recordings: Sequence[Recording]) -> tuple[DriveLoops | None, str]:
    """Return the loops of the drive from the first recording of the daemon whose uncompensated motion shows them.

    Returns also why none does; that is empty if no recording has such a motion.
    """
    why = ""
    for each in recordings:
        if "configuration" not in each.metadata or "facts" not in each.metadata or "is_enabled" not in each:
            continue
        own = (each["state"] == LoopState.RUNNING) & (each["is_enabled"] == 0.0) & (each["compensation"] == 0.0)
        bounds = np.flatnonzero(np.diff(np.concatenate([[False], own, [False]]).astype(np.int8)))
        if not bounds.size:
            continue
        begin, end = max(bounds.reshape(-1, 2).tolist(), key=lambda pair: pair[1] - pair[0])
        rows = np.arange(len(own))
        try:
            axis = from_dict(each.metadata["configuration"], each.path, reads_files=False).axes[each.axis]
            resolution = facts_of(each.metadata, each).position_resolution
            return drive_loops(each.at((rows >= begin) & (rows < end)), axis, resolution), ""
        except FrictionHilError as error:  # another version's, or a motion that does not show them
            why = why or str(error)
    return None, why


def simulated_axis(
    model: ModelFile,
    # Identified, kg m^2 or kg; that of the model file may be a former one. If it is zero, the recording does not show
    # it, and that of the drive's feed-forward is taken.
    inertia: float,
    loops: DriveLoops | None,  # from `drive_loops`
    recording: Recording,  # of the experiment; its largest torque sets what the drive can give
    period_s: float,  # of the loop: a whole number of integration steps
    resolution: float,  # step of the position, SI
) -> ServoConfig | None:
    """Return a servo with the friction of a model; None if no simulation has such a friction."""
    mechanics = model.mechanics
    if not inertia > 0.0 and loops is not None:
        inertia = loops.inertia
    if model.friction.model == NETWORK or not inertia > 0.0:
        return None
    turn = math.tau if model.axis == "rotary" else 1.0
    lag_s = mechanics.torque_lag_s if loops is None else loops.torque_lag_s
    parts: dict[str, Any] = {
        "mechanics": _mechanics(model, inertia, has_gravity=loops is None),
        "encoder": Encoder(counts=turn / resolution),
        "motor": Motor(torque_lag_s=lag_s, peak_torque=_PEAK_RATIO * _largest_torque(recording)),
        "loops": Loops() if loops is None else _loops(loops, inertia),
    }
    for rate_hz in _INTEGRATION_HZ:
        if abs(period_s * rate_hz - round(period_s * rate_hz)) > _WHOLE:
            continue
        try:
            friction = TrueFriction(
                model=model.friction.model, parameters=model.friction.parameters, modifiers=model.friction.modifiers
            )
            return ServoConfig(friction=friction, integration_hz=rate_hz, **parts)
        except ValidationError:
            continue  # stiffer than this rate can integrate
    return None


def _mechanics(model: ModelFile, inertia: float, *, has_gravity: bool) -> ServoMechanics:
    """Return the rigid axis; with gravity where the daemon's loops carry it, and not those of the drive."""
    offset, gravity = model.mechanics.offset, model.mechanics.gravity
    if not has_gravity or gravity == type(gravity)():
        return ServoMechanics(axis=model.axis, inertia=inertia, load_torque=offset)
    has_swing = model.axis == "rotary" and (gravity.sine or gravity.cosine)
    swing = Gravity(sine=gravity.sine, cosine=gravity.cosine) if has_swing else None
    return ServoMechanics(axis=model.axis, inertia=inertia, load_torque=offset + gravity.constant, gravity=swing)


def _loops(loops: DriveLoops, inertia: float) -> Loops:
    return Loops(
        position_gain=loops.position_gain,
        velocity_gain=loops.velocity_gain,
        integral_hz=max(loops.integral_hz, 0.0),
        velocity_feedforward=max(loops.velocity_feedforward, 0.0),
        inertia_feedforward=max(loops.inertia / inertia, 0.0),
    )


def _largest_torque(recording: Recording) -> float:
    largest = float(np.nanmax(np.abs(recording["torque"])))
    if not 0.0 < largest < math.inf:
        raise RecordingError(f"{recording.path}: {recording.axis}: no torque was recorded")
    return largest
