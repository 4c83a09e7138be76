"""An experiment in parts, which ends when the friction is known well enough. Pure.

The parameters of LuGre's model and their covariance are estimated from each part by itself
(`friction_hil.learning.estimate`), and combined with those of the parts before; without presliding, those of Stribeck's
model are identified from where the axis slides. The covariance gives the standard deviation of the compensation along a
motion. It does not contain what an axis changes by from part to part, e.g. because it warms up; by how much the last
part differs from those before does. The larger of both is what is unknown. It is judged along the axis's own motion,
and along slow and tiny ones as in the trial: fast motion passes the hump of Stribeck's curve in milliseconds.

It is compared with what the following error has left anyway: the part of the friction that the gain leaves, and the
counts of the encoder. Errors add up as squares, so that what is a seventh of that makes a difference of 1 %.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from friction_hil import friction
from friction_hil.config import Configuration
from friction_hil.config.trajectories import Circle, Sine, Strokes, Triangle
from friction_hil.daemon.assembly import experiment_sweeps, periodic_path
from friction_hil.errors import FrictionHilError, internal_error
from friction_hil.friction import FrictionModel
from friction_hil.identification import Fit, IdentificationSettings, identify
from friction_hil.identification.data import RegressionSegment, prepare
from friction_hil.identification.inference import experiment as motion_that_shows
from friction_hil.identification.least_squares import NUMERICAL
from friction_hil.learning.coordinates import Coordinates, coordinates_of, value_of
from friction_hil.learning.estimate import MECHANICS, Belief, Mechanics, estimate, first_belief
from friction_hil.learning.window import Window
from friction_hil.motion.experiment import LEAST_S, sliding_s
from friction_hil.motion.trajectory import Path, sweeps_path
from friction_hil.numerics.jit import Array
from friction_hil.recordings import Recording
from friction_hil.tuning import thresholds as th
from friction_hil.tuning.candidates import ExperimentPart, shows_presliding, sliding_settings
from friction_hil.tuning.motions import experiment_of, part_bounds, sliding_part
from friction_hil.tuning.trial_motions import OWN, SLOW, TINY, trial_motions

_PERIODS = 2  # of a periodic motion; the last one counts


def part_durations(duration_s: float) -> tuple[float, ...]:
    """Return the lengths of the parts of an experiment, s: 15 s, 15 s, then each as long as all before.

    An experiment that two parts would fill is not divided. What would be left for a part that is too short for an
    experiment belongs to the one before.
    """
    if duration_s < 2.0 * th.FIRST_S + LEAST_S:
        return (duration_s,)
    ends = [0.0, th.FIRST_S]
    while duration_s - 2.0 * ends[-1] >= LEAST_S:
        ends.append(2.0 * ends[-1])
    return tuple(end - begin for begin, end in pairwise([*ends, duration_s]))


@dataclass(frozen=True, slots=True)
class Unknown:
    """What is unknown of the friction along a motion of the axis. Shares of the friction level."""

    # on which it is most: ``own``, ``slow`` or ``tiny`` of `friction_hil.tuning.trial_motions`, or ``slow sweeps`` of
    # the experiment where the axis has no periodic motion
    motion: str
    # standard deviation of the torque by the errors of the parameters, root mean square along the motion
    deviation: float
    # by how much the torque that the last part shows differs from that of the parts before, root mean square; NaN after
    # the first part
    change: float
    negligible: float  # share that does not matter: it adds 1 % to the following error that is left anyway
    # Share of each uncertain parameter in the variance, largest first. Those of parameters that make up for each other
    # add up to more than 1.
    parameters: dict[str, float]

    @property
    def share(self) -> float:
        """The larger one of deviation and change; infinity after the first part, which nothing confirms."""
        return math.inf if math.isnan(self.change) else self.known_to

    @property
    def known_to(self) -> float:
        """Share to which the friction is known, after the first part too."""
        return self.deviation if math.isnan(self.change) else max(self.deviation, self.change)

    @property
    def is_negligible(self) -> bool:
        """True if a further part would not matter."""
        return self.share <= self.negligible

    @property
    def text(self) -> str:
        """Figures for the user."""
        changed = "" if math.isnan(self.change) else f", the last part differs by {_percent(self.change)}"
        where = self.motion if self.motion == "slow sweeps" else f"{self.motion} motion"
        return f"standard deviation {_percent(self.deviation)} of the friction along the {where}{changed}"


@dataclass(frozen=True, slots=True)
class ExperimentResult:
    """How long the experiment of an axis took, and why it ended."""

    parts_s: tuple[float, ...]  # lengths of the parts that were made
    longest_s: float  # configured duration
    unknown: Unknown | None  # after the last part; None if there is no estimate
    problem: str = ""  # why there is none

    @property
    def duration_s(self) -> float:
        """Length of all parts, s."""
        return math.fsum(self.parts_s)

    @property
    def is_ended_early(self) -> bool:
        """True if it ended before the configured duration."""
        return self.duration_s < self.longest_s

    @property
    def reason(self) -> str:
        """Why the experiment ended, in words."""
        found = self.unknown
        if found is None:
            return f"the configured duration is over; what is unknown is not estimated: {self.problem}"
        known = f"friction is known to {_percent(found.known_to)}, and {_percent(found.negligible)} suffices"
        if self.is_ended_early:
            return f"stopped early: {known} ({found.text})"
        said = f"the configured duration is over: {known} ({found.text})"
        if found.known_to > found.negligible:
            said = said.replace(" suffices", " would suffice")
        if found.deviation <= found.negligible:
            return said
        named = "; ".join(f"{name}: {motion_that_shows(name)}" for name in found.parameters)
        return f"{said}. Still uncertain: {named}"

    @property
    def text(self) -> str:
        """One sentence for the user."""
        of = f" of {self.longest_s:g} s" if self.is_ended_early else ""
        parts = f" in {len(self.parts_s)} parts" if len(self.parts_s) > 1 else ""
        return f"the experiment took {self.duration_s:g} s{of}{parts}: {self.reason}"

    @property
    def figures(self) -> dict[str, Any]:
        """Plain values."""
        found = self.unknown
        return {
            "duration_s": self.duration_s,
            "longest_s": self.longest_s,
            "parts_s": list(self.parts_s),
            "reason": self.reason,
            "motion": None if found is None else found.motion,
            "deviation": None if found is None else found.deviation,
            "change": None if found is None else found.change,
            "negligible": None if found is None else found.negligible,
            "uncertain": []
            if found is None
            else [
                {"parameter": name, "share": share, "motion": motion_that_shows(name)}
                for name, share in found.parameters.items()
            ],
        }


class Observer:
    """Estimates the friction of an axis from one part of its experiment after the other."""

    def __init__(self, configuration: Configuration, name: str) -> None:
        self._configuration, self._name = configuration, name
        self._has_presliding = False
        self._left = 0.0
        self._belief: Belief | None = None
        self._slow: list[Recording] = []  # sweeps of all parts
        self.model: FrictionModel | None = None  # of the parts so far

    def take(self, part: ExperimentPart) -> Unknown:
        """Return what is unknown after a further part.

        Raises `FrictionHilError`: there is no estimate, e.g. because the axis hardly moves.
        """
        recording = part.recording
        [facts] = (each for each in recording.metadata["facts"] if each["name"] == recording.axis)
        resolution = facts["position_resolution"]
        try:
            return self._taken(part, resolution)
        except NUMERICAL as error:
            raise FrictionHilError(f"the estimate fails: {error}") from None
        except FrictionHilError:
            raise
        except Exception as error:  # it costs the estimate, not the experiment
            raise FrictionHilError(f"the estimate fails: {internal_error(error)}") from error

    def _taken(self, part: ExperimentPart, resolution: float) -> Unknown:
        slow = sliding_part(part.recording, self._configuration, part.duration_s)
        if self.model is None:
            self._has_presliding = shows_presliding([part.recording])
            self._left = self._left_anyway(slow, resolution)
        former = self.model
        take = self._take_dynamic if self._has_presliding else self._take_static
        alone, known, covariance = take(part.recording if self._has_presliding else slow, resolution)
        self.model = known.model
        return self._unknown(None if former is None else (former, alone), known, covariance, resolution)

    def _take_dynamic(self, recording: Recording, resolution: float) -> tuple[FrictionModel, Coordinates, Array]:
        """Return the model that a part shows by itself, the one of all parts, and the covariance of its parameters."""
        former = self._belief
        if former is None:
            kind = self._configuration.axes[self._name].model.axis
            former = _belief(plain_fit([recording], IdentificationSettings(families=("lugre",), axis=kind)))
        segment = max(prepare(recording), key=lambda each: len(each.torque))
        # what is known already would make a part that contradicts it look like a disturbance
        vague = replace(former, covariance=np.diag(former.first**2))
        alone = estimate(_window(segment), vague, resolution).belief
        self._belief = alone if self._belief is None else _combined(former, alone)
        covariance = self._belief.covariance[:-MECHANICS, :-MECHANICS]
        return alone.model, coordinates_of(self._belief.model, {}), covariance

    def _take_static(self, slow: Recording, _: float) -> tuple[FrictionModel, Coordinates, Array]:
        """As `_take_dynamic`, from where the axis slides."""
        self._slow.append(slow)
        settings = sliding_settings(slow, self._configuration, ("stribeck",))
        fit = plain_fit(self._slow, settings)
        alone = fit if len(self._slow) == 1 else plain_fit([slow], settings)
        coordinates = coordinates_of(_model_of(fit), {})
        found, count = fit.inference, len(coordinates.names)
        errors, correlations = np.zeros(count), np.eye(count)
        at = [found.names.index(name) if name in found.names else -1 for name in coordinates.names]
        for k, i in enumerate(at):
            if i >= 0:
                errors[k] = min(found.standard_errors[found.names[i]] / abs(coordinates.values[k]), 1.0)
                correlations[k] = [found.correlations[i, j] if j >= 0 else 0.0 for j in at]
        return _model_of(alone), coordinates, correlations * np.outer(errors, errors)

    def _left_anyway(self, slow: Recording, resolution: float) -> float:
        """Return the share of the following error that compensation by the true model leaves."""
        gain = self._configuration.axes[self._name].compensation.gain
        is_moving = slow["velocity_demand"] != 0.0
        error = (slow["position_demand"] - slow["position"])[is_moving]
        rms = float(np.sqrt(np.nanmean(error**2)))
        counts = min(resolution / math.sqrt(12.0) / rms, 1.0) if rms > 0.0 else 1.0
        return math.hypot(max(1.0 - gain, th.LEAST_LEFT), counts)

    def _unknown(
        self,
        compared: tuple[FrictionModel, FrictionModel] | None,
        known: Coordinates,
        covariance: Array,
        resolution: float,
    ) -> Unknown:
        """Return what is unknown along the motion on which it is most."""
        level, dt = known.model.level, self._configuration.period_s
        negligible = self._left * math.sqrt((1.0 + th.DIFFERENCE) ** 2 - 1.0)
        found = []
        for motion, (velocity, skipped) in self._motions(resolution).items():
            slopes = known.simulate(np.zeros(len(known.names)), velocity, dt)[1][skipped:]
            shares = np.mean((slopes @ covariance) * slopes, axis=0)  # of each parameter in the mean variance
            variance = max(float(np.sum(shares)), 0.0)
            change = math.nan
            if compared is not None:
                before, last = (each.simulate(velocity, dt)[skipped:] for each in compared)
                change = float(np.sqrt(np.mean((last - before) ** 2))) / level
            named = {
                name: share / variance
                for name, share in sorted(zip(known.names, shares.tolist(), strict=True), key=lambda each: -each[1])
                if share > th.NAMED * variance
            }
            found.append(Unknown(motion, math.sqrt(variance) / level, change, negligible, named))
        return max(found, key=lambda each: each.known_to)

    def _motions(self, resolution: float) -> dict[str, tuple[Array, int]]:
        """Return the velocity (n,) of each motion that counts, by its name, and the rows before it."""
        period_s, config = self._configuration.period_s, self._configuration.axes[self._name]
        own = config.trajectory
        if isinstance(own, Circle | Sine | Triangle | Strokes):
            tried = trial_motions(own, experiment_of(self._name, config), resolution)
            names = (OWN, SLOW, TINY) if self._has_presliding else (OWN, SLOW)  # tiny motion is presliding
            return {
                name: (
                    _velocity(periodic_path(tried[name]), _PERIODS / tried[name].frequency, period_s),
                    round((_PERIODS - 1) / tried[name].frequency / period_s),
                )
                for name in names
                if name in tried
            }
        bounds = part_bounds(self._configuration, self._name, part_durations(self._longest_s)[0])
        sweeps = experiment_sweeps(bounds, resolution, period_s)
        return {"slow sweeps": (_velocity(sweeps_path(sweeps), sliding_s(sweeps), period_s), 0)}

    @property
    def _longest_s(self) -> float:
        return experiment_of(self._name, self._configuration.axes[self._name]).duration_s


def _velocity(path: Path, length_s: float, period_s: float) -> Array:
    """Return the velocity (n,) of a path over its first seconds."""
    position = np.array([path(k * period_s)[0] for k in range(round(length_s / period_s) + 1)])
    return np.diff(position) / period_s


def plain_fit(recordings: Sequence[Recording], settings: IdentificationSettings) -> Fit:
    """Return the best model without modifiers, by regression alone."""
    return identify(recordings, replace(settings, has_modifiers=False, refine=False)).best


def _model_of(fit: Fit) -> FrictionModel:
    parameters, modifiers = fit.friction
    return friction.create(fit.structure.family, modifiers=modifiers, axis=fit.structure.axis, **parameters)


def _belief(fit: Fit) -> Belief:
    """Return the parameters of a fit, with errors as large as they are."""
    model, found = _model_of(fit), fit.mechanics
    static = (
        found.get("offset", 0.0) + found.get("gravity.constant", 0.0),
        found.get("gravity.sine", 0.0),
        found.get("gravity.cosine", 0.0),
    )
    return first_belief(
        model, Mechanics(found["inertia"], static), {name: value_of(model, name) for name in model.free}
    )


def _combined(known: Belief, alone: Belief) -> Belief:
    """Return what is known with a further part; ``alone`` is what it shows to one that knows no more than at first."""
    first = np.diag(known.first**-2)
    before, added = np.linalg.inv(known.covariance), np.linalg.inv(alone.covariance) - first
    covariance = np.linalg.inv(before + added)
    x = known.x + covariance @ np.linalg.inv(alone.covariance) @ (alone.x - known.x)
    return replace(known, x=x, covariance=0.5 * (covariance + covariance.T))


def _window(segment: RegressionSegment) -> Window:
    unknown = np.full(len(segment.torque), math.nan)
    return Window(
        1.0 / segment.rate_hz,
        segment.encoder,
        segment.torque,
        unknown if segment.demand is None else segment.demand,
        np.zeros(len(segment.torque)),
        unknown,
    )


def _percent(share: float) -> str:
    return f"{100.0 * share:.2g} %"
