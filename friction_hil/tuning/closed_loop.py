"""Models fitted to the motion that the drive's loops make of them. Pure.

A fit to the torque takes the measured motion for granted. On a soft axis that motion is coarse where it matters: a
count of the encoder is as long as presliding, and the rest is stick-slip, which the torque hardly shows. Here the whole
loop is simulated: the drive's loops, identified from the recording, move the axis with the model's friction along the
recorded set-points. An observer keeps the simulation near the recorded motion: it corrects position and velocity by the
difference at each sample, and these differences are the errors to be made small. Without it, a simulation that sticks
and slips at another time than the axis would be no worse with a wrong height of the hump than with the right one. A
fast observer forgives much, so that the search finds its way; a slow one tells models apart.

Source: prediction errors of a predictor with a fixed gain, L. Ljung, System Identification, 1999, section 7.2; a
coupling that is loosened, H. Abarbanel, D. Creveling, R. Farsian, M. Kostuk, SIAM Journal on Applied Dynamical Systems
8(4), 2009.
"""

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from friction_hil.config import AxisConfig, Configuration
from friction_hil.daemon.safety import LoopState
from friction_hil.errors import FrictionHilError, RecordingError, UsageError
from friction_hil.identification import Fit, Identification
from friction_hil.identification.choice import by_likelihood
from friction_hil.identification.drive_loop import DriveLoops
from friction_hil.identification.inference import flags, infer
from friction_hil.identification.prediction_errors import prediction_error
from friction_hil.identification.regression import Estimate
from friction_hil.identification.structures import ModelStructure
from friction_hil.identification.thresholds import BLOCKS
from friction_hil.models.model_file import ModelFile
from friction_hil.numerics.jit import Array
from friction_hil.parallel import in_parallel
from friction_hil.recordings import Recording
from friction_hil.rehearsal import Rehearsal
from friction_hil.replay.verify import facts_of
from friction_hil.tuning import thresholds as th
from friction_hil.tuning.model_files import model_content
from friction_hil.tuning.motions import uncompensated
from friction_hil.tuning.settings import ShowStep
from friction_hil.tuning.simulated import SOFT_HZ, simulated_axis


@dataclass(frozen=True, slots=True, eq=False)
class Start:
    """Where a search begins."""

    identification: Identification  # that the fit belongs to
    fit: Fit  # to the torque: gives offset, gravity and curves
    structure: ModelStructure
    # Of all parameters of the structure, and the inertia, which is held: a model that is not quite that of the axis
    # would bend it.
    values: Mapping[str, float]


@dataclass(frozen=True, slots=True, eq=False)
class _Motion:
    """A recorded motion, on an even grid of cycles."""

    rehearsal: Rehearsal
    demand: Array  # (n, 7), as for `friction_hil.rehearsal.kernel.run`
    measured: Array  # (n,), middle of the count; NaN where no sample was recorded
    error: Array  # (n,), following error
    torque: float  # by which the drive holds the axis at the start, N m or N


def _recorded(recording: Recording, axis: AxisConfig, period_s: float) -> _Motion:
    """Return the motion of an uncompensated run of the daemon."""
    facts = facts_of(recording.metadata, recording)
    running = recording.at(recording["state"] == LoopState.RUNNING)
    cycle = np.asarray(running["cycle"], dtype=np.float64)
    grid = np.arange(cycle[0], cycle[-1] + 1.0)
    position, velocity, acceleration = (
        np.interp(grid, cycle, running[name])
        for name in ("position_demand", "velocity_demand", "acceleration_demand_ahead")
    )
    late = facts.setpoint_delay_s / period_s
    sent, sent_velocity = (np.interp(grid + late, grid, each) for each in (position, velocity))
    resolution = facts.position_resolution
    measured = np.full(len(grid), math.nan)
    is_fresh = running["is_fresh"] > 0.0 if "is_fresh" in running else np.ones(len(cycle), dtype=bool)
    measured[(cycle - cycle[0]).astype(int)[is_fresh]] = running["position"][is_fresh] + 0.5 * resolution
    columns = position, velocity, acceleration, velocity, acceleration
    demand = np.column_stack([*columns, np.round(sent / resolution) * resolution, sent_velocity])
    is_held = np.abs(running["position_demand"] - position[0]) < resolution
    held = running["torque"][np.logical_and.accumulate(is_held)]
    known = held[np.isfinite(held)]
    torque = float(np.mean(known)) if known.size else 0.0
    return _Motion(Rehearsal(axis, facts, period_s), demand, measured, position - measured, torque)


class ClosedLoop:
    """The loops of a drive with its recorded motions, to which friction models are fitted."""

    def __init__(
        self,
        recordings: Sequence[Recording],  # of an experiment, with torque
        configuration: Configuration,  # from which these runs were made
        loops: DriveLoops | None,  # None: the daemon's own, which are in the configuration
    ) -> None:
        self.name = name = recordings[0].axis
        self.axis = uncompensated(configuration).axes[name]  # neither was the weight fed forward
        self.period_s, self.loops = configuration.period_s, loops
        self.running = recordings[0].at(recordings[0]["state"] == LoopState.RUNNING)
        self.resolution = facts_of(recordings[0].metadata, recordings[0]).position_resolution
        self.motions = [_recorded(each, self.axis, self.period_s) for each in recordings]
        own = self.axis.controller
        self.gain = loops.position_gain if loops and loops.position_gain > 0.0 else own.position_gain if own else 0.0

    def errors(self, model: ModelFile, inertia: float) -> Array:
        """Return measured less predicted positions (n,) of all motions over a count.

        Positions that are unknown count as predicted.
        """
        # presliding that is too stiff for these rates moves the axis by less than the encoder shows
        servo = simulated_axis(model, inertia, self.loops, self.running, self.period_s, self.resolution, SOFT_HZ)
        if servo is None:
            raise UsageError(f"{model.friction.model}: its presliding is stiffer than the motion shows")
        pole = math.exp(-th.OBSERVER_RATE * self.gain * self.period_s)  # both poles of the observer
        correction = 1.0 - pole * pole, (1.0 - pole) ** 2 / self.period_s
        found = []
        for each in self.motions:
            ahead = each.rehearsal.ahead(servo, model, each.demand, each.measured, each.torque, correction)
            # a simulation that fails is no sample that is missing
            ahead = np.nan_to_num(
                ahead / self.resolution, nan=th.FAILED_ERROR, posinf=th.FAILED_ERROR, neginf=-th.FAILED_ERROR
            )
            found.append(np.where(np.isnan(each.measured), 0.0, ahead)[round(th.SETTLED_S / self.period_s) :])
        return np.concatenate(found)

    @cached_property
    def following(self) -> Array:
        """Following error of all motions over a count, (n,)."""
        begin = round(th.SETTLED_S / self.period_s)
        return np.nan_to_num(np.concatenate([each.error[begin:] for each in self.motions]) / self.resolution)


class _Search:
    """Search for the parameters of one structure from one start; its coordinates are of the order of 1."""

    def __init__(self, loop: ClosedLoop, start: Start) -> None:
        self._loop, self._start = loop, start
        structure, values = start.structure, start.values
        level, speed = _scales(loop)
        lower, upper, at, scales = [], [], [], []
        for each in structure.coordinates:
            low, high = each.bounds
            value = each.inner(values[each.name])
            scale = 1.0 if each.is_log else max(abs(value), th.LEAST_SCALE * (high - low))
            scales.append(scale)
            lower.append(low / scale)
            upper.append(high / scale)
            at.append(value / scale)
        for name, key in structure.linear.items():
            is_viscous = key.partition(".")[0] == "viscous"
            scales.append(level / speed if is_viscous else level)
            lower.append(0.0 if is_viscous else -math.inf)
            upper.append(math.inf)
            at.append(values[name] / scales[-1])
        self._scales, self._lower, self._upper = np.array(scales), np.array(lower), np.array(upper)
        inside = 1e-3 * np.minimum(1.0, self._upper - self._lower)
        self._at = np.clip(at, self._lower + inside, self._upper - inside)

    def _fit_of(self, at: Array) -> Fit:
        """Return the fit of the start with other parameters."""
        structure, fit = self._start.structure, self._start.fit
        count = len(structure.coordinates)
        outer = at * self._scales
        values = structure.values(outer[:count])
        values |= dict(zip(structure.linear, outer[count:].tolist(), strict=True))
        mechanics = {**fit.mechanics, "inertia": self._start.values["inertia"]}
        values |= {name: value for name, value in mechanics.items() if name in fit.values or name == "inertia"}
        return replace(fit, structure=structure, values=values, mechanics=mechanics)

    def _errors(self, at: Array) -> Array:
        """Return `ClosedLoop.errors`; very large ones where the model is inconsistent, or too stiff."""
        try:
            return self._errors_of(self._fit_of(at))
        except (UsageError, ValueError):
            return np.full(len(self._loop.following), th.FAILED_ERROR)

    def _errors_of(self, fit: Fit) -> Array:
        model = ModelFile.model_validate(model_content(self._start.identification, fit, self._loop.axis))
        return self._loop.errors(model, fit.mechanics["inertia"])

    def _jacobian(self, at: Array, step: float) -> Array:
        """Return the derivatives (n, m) of the errors, by differences."""
        steps = np.where(at + step > self._upper, -step, step)
        jobs = [partial(self._errors, at + one * unit) for one, unit in zip(steps, np.eye(len(at)), strict=True)]
        first = self._errors(at)
        return np.column_stack([(each - first) / one for each, one in zip(in_parallel(jobs), steps, strict=True)])

    def _cost(self, at: Array, usual: float) -> float:
        """Return what a search makes small where errors are usually that large."""
        scale = th.LARGE_ERROR * usual
        return scale**2 * float(np.sum(np.hypot(1.0, self._errors(at) / scale) - 1.0))

    def _usual(self, at: Array) -> float:
        return max(float(np.median(np.abs(self._errors(at)))), th.LEAST_ERROR)

    def _searched(self, at: Array, steps: Sequence[float]) -> tuple[Array, Array, bool]:
        """Return where searches end that differ by the steps of their derivatives, the errors, and if they converge."""
        from scipy.optimize import least_squares  # imported here: start-up time

        for step in steps:
            found = least_squares(
                self._errors,
                at,
                partial(self._jacobian, step=step),
                (self._lower, self._upper),
                loss="soft_l1",
                f_scale=th.LARGE_ERROR * self._usual(at),
                ftol=th.TOLERANCE,
                xtol=th.TOLERANCE,
                max_nfev=th.EVALUATIONS,
            )
            at = found.x
        return at, found.fun, bool(found.status > 0)

    def _beyond_a_step(self, at: Array) -> Array | None:
        """Return coordinates that are better than these, changed one by one by more than a search looks; None: none."""
        usual, start = self._usual(at), at
        lowest = self._cost(at, usual)
        for i in range(len(self._start.structure.coordinates)):
            points = np.clip(at + np.outer(th.PROBES, np.eye(len(at))[i]), self._lower, self._upper)
            costs = in_parallel([partial(self._cost, each, usual) for each in points])
            if min(costs) < th.BETTER * lowest:
                lowest = min(costs)
                at = points[costs.index(lowest)]
        return None if at is start else at

    def run(self) -> Fit:
        """Search, and return the fit where the search has ended.

        Raises `UsageError`: where it begins, there is nothing to simulate.
        """
        self._errors_of(self._fit_of(self._at))
        at, errors, is_converged = self._searched(self._at, th.SEARCH_STEPS)
        if (other := self._beyond_a_step(at)) is not None:
            found = self._searched(other, th.LAST_STEPS)
            usual = self._usual(at)
            if self._cost(found[0], usual) < self._cost(at, usual):
                at, errors, is_converged = found
        derivatives = self._jacobian(at, th.SEARCH_STEPS[-1])
        return self._fit(at, errors, derivatives, is_converged=is_converged)

    def _fit(self, at: Array, errors: Array, derivatives: Array, *, is_converged: bool) -> Fit:
        """Return the fit at coordinates, with the errors of the motion that it predicts and their derivatives."""
        fit, structure = self._fit_of(at), self._start.structure
        every = max(1, round(1.0 / (th.CLOSED_LOOP_ROWS_HZ * self._loop.period_s)))
        residual = errors[::every]
        # of errors with respect to coordinates; an estimate has those of the prediction with respect to parameters
        jacobian = -derivatives[::every]
        following = self._loop.following[::every]
        slopes = self._scales.copy()
        for i, each in enumerate(structure.coordinates):
            slopes[i] *= each.outer(float(at[i])) if each.is_log else 1.0
        names = (*(each.name for each in structure.coordinates), *structure.linear)
        is_free = (at > self._lower + 1e-6) & (at < self._upper - 1e-6)
        free = tuple(name for name, is_one in zip(names, is_free, strict=True) if is_one)
        estimate = Estimate(
            values=fit.values,
            coordinates=(at * self._scales)[: len(structure.coordinates)],
            at_bound=tuple(name for name in names if name not in free),
            dependent=(),
            residual=residual,
            jacobian=(jacobian / slopes)[:, is_free],
            names=free,
            weights=np.ones(len(residual)),
            is_converged=is_converged,
        )
        inference = infer(estimate, [slice(0, len(residual))])
        unit = self._loop.resolution
        return replace(
            fit,
            inference=inference,
            train=prediction_error(unit * following, unit * (following - residual)),
            cross_validation=prediction_error(
                unit * following, unit * (following - _held_out(residual, jacobian[:, is_free]))
            ),
            across_speeds=None,
            validation=None,
            flags=tuple(flags(estimate, inference)),
            coordinates=estimate.coordinates,
            estimate=estimate,
            is_closed_loop=True,
        )


def _scales(loop: ClosedLoop) -> tuple[float, float]:
    """Return a torque and a speed of the motions, for coordinates of the order of 1."""
    speed = max(float(np.max(np.abs(each.demand[:, 1]))) for each in loop.motions)
    return float(np.std(loop.running["torque"])), speed


def _held_out(residual: Array, jacobian: Array) -> Array:
    """Return the errors (n,) of blocks held out in turn, extrapolated with the gradient at the fit to all rows.

    ``jacobian``: (n, p), of the prediction.
    """
    norms = np.linalg.norm(jacobian, axis=0)
    columns = jacobian / np.where(norms > 0.0, norms, 1.0)
    whole = columns.T @ columns + th.DAMPING * np.eye(columns.shape[1])
    found = residual.copy()
    edges = np.linspace(0, len(residual), BLOCKS + 1).round().astype(int)
    for begin, end in itertools.pairwise(edges):
        own, error = columns[begin:end], residual[begin:end]
        found[begin:end] = error + own @ np.linalg.solve(whole - own.T @ own, own.T @ error)
    return found


def closed_loop_fits(loop: ClosedLoop, starts: Sequence[Start], show: ShowStep) -> Identification:
    """Fit models to the motion of an experiment; return them, the likeliest first.

    Raises `RecordingError`: the gain of the position loop, which sets the observer, is not known; or no search ends.
    """
    if not loop.gain > 0.0:
        raise RecordingError(f"{loop.name}: there is no position loop")
    fits, failures = [], []
    for number, start in enumerate(starts, start=1):
        show(f"closed loop: {start.structure.label}", number, len(starts))
        try:
            fits.append(_Search(loop, start).run())
        except FrictionHilError as error:
            failures.append(f"{start.structure.label} in closed loop: {error}")
    fits = by_likelihood(fits)
    if not fits:
        raise RecordingError("; ".join(failures) or f"{loop.name}: no model predicts the motion")
    best = fits[0]
    reason = (
        f"of {len(starts)} searches in closed loop it predicts the motion best, with an error of "
        f"{100.0 * best.held_out.relative_error:.2g} % of the following error"
    )
    return replace(starts[0].identification, fits=tuple(fits), reason=reason, failures=tuple(failures))
