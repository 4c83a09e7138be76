"""Training of a network: several starts, the most promising go on, and the best in free run on validation is kept."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import count
from typing import Any

import numpy as np

from friction_hil.errors import UsageError
from friction_hil.friction import NetworkStructure, network
from friction_hil.numerics.jit import Array
from friction_hil.training import constraints, levenberg
from friction_hil.training.checks import Rest, at_rest
from friction_hil.training.constraints import Constraint
from friction_hil.training.layout import Samples, empty
from friction_hil.training.objective import Objective, Record

DECAYS = (1e-9, 1e-8, 1e-6)  # of the squared weights, where a network that always says 0 has a mean squared error of 1
_SPEED_FACTORS = (0.3, 1.0, 0.1)
_PATIENCE = 40  # iterations without a better free run on validation before a start is given up
_ELEMENT_UNITS = 6  # for the first weights of several states
_SLIDING = 0.9  # of the stop's stroke
_BAD = 0.1  # NRMSE in free run above which a network has not learned
_GOOD = 0.02  # and below which it is of no interest how much better it is on the training set


@dataclass(frozen=True, slots=True)
class Progress:
    """Where a training stands after an iteration.

    Attributes
    ----------
    stage : {"trial", "series-parallel", "parallel"}
    start : int
        Number of the start, from 0.
    iteration : int
        Of all starts together.
    error, validation_error : float
        NRMSE on the training set as it is trained, and in free run on the validation set.
    damping : float
    """

    stage: str
    start: int
    iteration: int
    error: float
    validation_error: float
    damping: float


@dataclass(frozen=True, slots=True)
class Errors:
    """NRMSE, root of the mean squared error over the standard deviation of the torque.

    ``one_step`` is series-parallel: fed the measured torques; ``free_run`` is fed its own.
    """

    one_step: float
    free_run: float


@dataclass(frozen=True, slots=True)
class Options:
    """How a training searches.

    Attributes
    ----------
    starts, survivors : int
        How many starts are tried, and how many of them go on.
    trial_iterations, iterations : int
        Of each start, and in addition of each survivor.
    decays : tuple of float
        Weight decays; the starts take turns.
    contraction : float
        Bound on the slopes over what is fed back, see `constraints`; that of the structure when not given.
    """

    starts: int = 8
    survivors: int = 2
    trial_iterations: int = 25
    iterations: int = 150
    decays: tuple[float, ...] = DECAYS
    contraction: float | None = None

    def __post_init__(self) -> None:
        if not 1 <= self.survivors <= self.starts or min(self.trial_iterations, self.iterations) < 1:
            raise UsageError("a training needs one start or more, as many survivors at most, and one iteration of each")
        if not self.decays or not all(0.0 <= decay < math.inf for decay in self.decays):
            raise UsageError(f"decays are one or more finite numbers from 0 on, not {self.decays}")
        if self.contraction is not None and not self.contraction > 0.0:
            raise UsageError(f"contraction is above zero, not {self.contraction}")


@dataclass(frozen=True, slots=True)
class Trained:
    """A trained network.

    Attributes
    ----------
    structure : NetworkStructure
    parameters : array
        As `network.step` takes them.
    train, validation : Errors
    seed, start : int
        Of the training, and number of the start that won.
    iterations : int
        Of all starts together.
    decay : float
        Weight decay of the start that won.
    feedback_gain : float
        Bound on the slope of what the network does over what is fed back; below 1 it forgets how it began.
    rest : Rest
        What it does in ten minutes at rest.
    is_stopped : bool
        Whether the progress callback ended the training.
    history : tuple of Progress
    flags : tuple of str
        What is to be known before the network is used.
    """

    structure: NetworkStructure
    parameters: Array
    train: Errors
    validation: Errors
    seed: int
    start: int
    iterations: int
    decay: float
    feedback_gain: float
    rest: Rest
    is_stopped: bool
    history: tuple[Progress, ...] = field(repr=False)
    flags: tuple[str, ...] = ()


class _Start:
    """One start: its scales, its first weights, and the best that has come of them."""

    def __init__(self, number: int, training: "_Training") -> None:
        structure, samples, options = training.structure, training.samples, training.options
        random = np.random.default_rng((training.seed, number))
        self.number = number
        self.decay = options.decays[number % len(options.decays)]
        self.p = empty(structure, samples, _SPEED_FACTORS[number // len(options.decays) % len(_SPEED_FACTORS)])
        if structure.kind == "gated":
            self.p[network.STROKE] *= random.uniform(1.2, 2.5)  # elements of several strokes: one explains the middle
        self.constraint = Constraint(structure, options.contraction or constraints.CONTRACTIONS[structure.kind])
        self.at = first_weights(self.p, structure, samples, random)
        self.damping = 1e-2
        self.error = math.inf
        self.best = self.p.copy()
        self.best[network.HEADER :] = self.constraint.apply(self.at)[0]
        self.training_record, self.validation_record = (Record(self.p, each) for each in (samples, training.validation))


def first_weights(p: Array, structure: NetworkStructure, samples: Samples, random: np.random.Generator) -> Array:
    """Draw small random numbers to start from, with an output that is a static map of the inputs.

    A gated network so begins as Dahl's model with a curve for its level.
    """
    searched = 0.3 * random.standard_normal(structure.weights)
    begin, stride = structure.outputs_begin, structure.output_weights
    searched[begin:] *= 0.1
    record = Record(p, samples)
    p = p.copy()
    p[network.HEADER : network.HEADER + begin] = searched[:begin]
    record.run(p, is_free=True)
    last = record.trace[:, sum(structure.hidden) - structure.hidden[-1] : sum(structure.hidden)]
    columns = np.column_stack([np.ones(len(samples)), last, record.inputs]) * np.sqrt(record.weight)[:, None]
    ridge = 1e-3 * np.eye(columns.shape[1])
    fitted = np.linalg.solve(columns.T @ columns + ridge, columns.T @ (np.sqrt(record.weight) * record.target))
    if structure.kind == "gated" and structure.states > 1 and _has_room_for_elements(structure):
        _draw_elements(structure, record, searched, random)
    else:
        summed = max(structure.states - 1, 1) if structure.kind == "gated" else 1
        for place in range(begin, begin + summed * stride, stride):
            searched[place : place + fitted.size] += fitted / summed
    if structure.kind == "gated":
        gates = searched[structure.weights - structure.states * network.GATES * network.GATE_WEIGHTS :]
        _draw_gates(p, record, gates.reshape(structure.states, network.GATES, network.GATE_WEIGHTS), random)
    return searched


def _has_room_for_elements(structure: NetworkStructure) -> bool:
    return len(structure.hidden) == 1 and structure.hidden[0] >= _ELEMENT_UNITS


def _draw_elements(structure: NetworkStructure, record: Record, searched: Array, random: np.random.Generator) -> None:
    """Change the weights of the layers and outputs to those of equal elements whose level is the last state.

    Its aim is an even curve over the velocity, of two pairs of units, fitted to sliding. One more pair turns the level
    in the direction x of motion: tanh(x + g) + tanh(x - g) is odd in x and falls with g, which falls with the level.
    """
    width, inputs, states = structure.hidden[0], structure.inputs, structure.states
    bias, weights = searched[:width], searched[width : width * (1 + inputs)].reshape(inputs, width)
    fed = searched[slice(*structure.feedback_weights)].reshape(states, width)
    outs = searched[structure.outputs_begin :][: structure.outputs * structure.output_weights]
    outs = outs.reshape(structure.outputs, structure.output_weights)
    direct = searched[structure.outputs_begin + outs.size :]
    fed *= 0.1
    weights[:, :_ELEMENT_UNITS] *= 0.1
    x, direction = record.inputs, network.VELOCITY_FEATURES - 1
    bias[:_ELEMENT_UNITS] = (1.5, -1.5, 1.5, 1.5, 1.5, 1.5)
    weights[direction, :2], fed[-1, :2] = 1.0, (-0.8, 0.8)
    curves = [np.ones(len(x))]
    for pair, feature in ((2, 1), (4, 2)):
        slope = random.uniform(2.0, 8.0)
        weights[feature, pair : pair + 2] = slope, -slope
        curves.append(np.tanh(1.5 + slope * x[:, feature]) + np.tanh(1.5 - slope * x[:, feature]))
    sliding = np.sqrt(record.weight * (record.gate_features[network.VELOCITY_FEATURES] > _SLIDING))
    columns = np.column_stack([*curves, np.abs(x[:, 0])]) * sliding[:, None]
    ridge = 1e-6 * np.eye(columns.shape[1])
    fitted = np.linalg.solve(columns.T @ columns + ridge, columns.T @ (sliding * np.abs(record.target)))
    level = float(np.mean((np.column_stack(curves) @ fitted[:-1])[sliding > 0.0])) if np.any(sliding) else 1.0
    outs[-2, 0] += fitted[0] / level
    outs[-2, 3:5] += fitted[1] / level
    outs[-2, 5:7] += fitted[2] / level
    share = level / (states - 1)  # 2.3 (tanh(x + g) + tanh(x - g)) - 1.8 x is 1 for x = 1, and rises like the level
    outs[:-2, 1:3] += 2.3 * share
    outs[:-2, 1 + width + direction] -= 1.8 * share
    direct[1] += fitted[-1]


def _draw_gates(p: Array, record: Record, gates: Array, random: np.random.Generator) -> None:
    """Change ``gates`` (states, 2, `GATE_WEIGHTS`) to rates and knees from which a training may begin.

    Of several states, all but the last yield after strokes that are spread about that of the stop, like the elements of
    a Maxwell-slip model. The last lags behind its aim by a random time while the axis slides, and less while it sticks.
    """
    states, speed = len(gates), np.abs(record.samples.velocity)
    is_moving = speed > 0.0
    middle = float(np.median(record.path[is_moving])) if np.any(is_moving) else 1.0
    if states == 1:
        rates, near = 10.0 ** random.uniform(-0.5, 1.0, 1) / middle, 10.0 ** random.uniform(-1.0, 0.3, 1)
        knees = near if random.uniform() < 0.5 else np.full(1, 2.0 * p[network.BOUND])  # as LuGre's: none
    else:
        elements = states - 1
        ratio, centre = 10.0 ** random.uniform(0.2, 0.6), p[network.STROKE] * 10.0 ** random.uniform(-0.3, 0.1)
        knees = 10.0 ** random.uniform(-2.0, -0.5, states)
        strokes = centre * ratio ** (np.arange(states) - 0.5 * (elements - 1))
        rates = np.maximum(1.0, 1.0 / (elements * knees)) / strokes
    gates[:, 0, 0] = _bend(np.log(rates), p[network.RATE_MIDDLE], p[network.RATE_HALF])
    gates[:, 1, 0] = _bend(np.log(knees / p[network.BOUND]), network.KNEE_MIDDLE, network.KNEE_HALF)
    if states > 1 and np.any(is_moving):
        per_s = 10.0 ** random.uniform(1.0, 2.3)
        rate = per_s / np.maximum(speed[is_moving], 0.1 * p[network.SPEEDS + 1])
        seen = record.gate_features[:, is_moving].T
        slid = seen[:, network.VELOCITY_FEATURES] + seen[:, network.VELOCITY_FEATURES + 1] - 1.0
        stuck = random.uniform(1.0, 3.0) * (1.0 - np.tanh(4.0 * (slid - random.uniform(0.2, 0.9))))
        wanted = _bend(np.log(rate) + stuck, p[network.RATE_MIDDLE], p[network.RATE_HALF])
        columns = np.column_stack([np.ones(len(seen)), seen])
        ridge = 1e-9 * len(columns) * np.eye(columns.shape[1])
        gates[-1, 0] = np.linalg.solve(columns.T @ columns + ridge, columns.T @ wanted)
        gates[-1, 1, 0] = _bend(math.log(2.0), network.KNEE_MIDDLE, network.KNEE_HALF)


def _bend(logarithm: Any, middle: float, half: float) -> Any:
    """What goes into the tanh of a gate to give this logarithm."""
    return np.arctanh(np.clip((logarithm - middle) / half, -0.97, 0.97))


class _StoppedError(Exception):
    """The callback has had enough."""


class _Training:
    def __init__(
        self,
        structure: NetworkStructure,
        samples: Samples,
        validation: Samples,
        seed: int,
        options: Options,
        goes_on: Callable[[Progress], bool],
    ) -> None:
        self.structure, self.samples, self.validation = structure, samples, validation
        self.seed, self.options, self._goes_on = seed, options, goes_on
        self.history: list[Progress] = []
        self._iterations = count(1)

    def search(self, start: _Start, stage: str, iterations: int, is_free: bool) -> None:
        """Go on from where a start is; keep the best free run on validation."""
        objective = Objective(start.p, start.training_record, start.constraint, start.decay, is_free)
        stale = 0

        def judge(progress: levenberg.Progress) -> bool:
            nonlocal stale
            start.at, start.damping = progress.at, progress.damping
            p = objective.network_at(progress.at)
            error = start.validation_record.error(p, is_free=True)
            stale += 1
            if error < start.error:
                start.error, start.best, stale = error, p, 0
            train_error = math.sqrt(progress.cost)
            step = Progress(stage, start.number, next(self._iterations), train_error, error, progress.damping)
            self.history.append(step)
            if not self._goes_on(step):
                raise _StoppedError
            return stale < _PATIENCE

        levenberg.minimise(
            objective.cost, objective.linear, start.at, iterations=iterations, damping=start.damping, goes_on=judge
        )

    def run(self) -> tuple[_Start, bool]:
        """Return the best start, and whether the training was stopped."""
        options, is_narx = self.options, self.structure.kind == "narx"
        starts: list[_Start] = []
        try:
            for number in range(options.starts):
                starts.append(_Start(number, self))
                if is_narx:
                    self.search(starts[-1], "series-parallel", options.trial_iterations, is_free=False)
                    starts[-1].damping = 1e-2
                self.search(starts[-1], "trial", options.trial_iterations, is_free=True)
            starts.sort(key=lambda start: start.error)
            for start in starts[: options.survivors]:
                self.search(start, "parallel", options.iterations, is_free=True)
        except _StoppedError:
            return min(starts, key=lambda start: start.error), True
        return min(starts, key=lambda start: start.error), False


def train(
    structure: NetworkStructure,
    samples: Samples,
    validation: Samples,
    *,
    seed: int = 0,
    options: Options | None = None,
    goes_on: Callable[[Progress], bool] = lambda progress: True,
) -> Trained:
    """Train a network.

    Every start has its own scales of velocity, weight decay and random weights. After a few iterations of
    Levenberg-Marquardt the starts with the best free run on the validation samples go on; what is returned is the
    best network that was met on the way.

    Parameters
    ----------
    structure : NetworkStructure
    samples, validation : Samples
        The same motion with other weights, for held-out blocks, or different records.
    seed : int
        The same seed gives the same bits.
    options : Options, optional
    goes_on : callable
        Called after every iteration; when it returns False the training ends with the best network so far.

    Raises
    ------
    UsageError
        No sample of one of the sets counts, or the torque does not vary.
    """
    for name, each in (("training", samples), ("validation", validation)):
        if not np.any(each.weight > 0.0) or np.ptp(each.torque[each.weight > 0.0]) == 0.0:
            raise UsageError(f"the {name} samples need a torque that varies, and a weight above zero")
    training = _Training(structure, samples, validation, seed, options or Options(), goes_on)
    best, is_stopped = training.run()
    errors = [
        Errors(record.error(best.best, is_free=False), record.error(best.best, is_free=True))
        for record in (best.training_record, best.validation_record)
    ]
    rest = at_rest(structure, best.best, samples.dt)
    gain = best.constraint.feedback_gain(best.best[network.HEADER :])
    return Trained(
        structure=structure,
        parameters=best.best,
        train=errors[0],
        validation=errors[1],
        seed=seed,
        start=best.number,
        iterations=len(training.history),
        decay=best.decay,
        feedback_gain=gain,
        rest=rest,
        is_stopped=is_stopped,
        history=tuple(training.history),
        flags=tuple(_flags(errors, rest, is_stopped)),
    )


def _flags(errors: list[Errors], rest: Rest, is_stopped: bool) -> list[str]:
    train, validation = errors
    flags = ["stopped before the search was over"] if is_stopped else []
    if validation.free_run > _BAD:
        flags.append(f"free-run error on validation is {validation.free_run:.3g}: it has not learned this axis")
    if validation.free_run > max(3.0 * train.free_run, _GOOD):
        flags.append(
            "free-run error on validation is above three times that on training: too many weights or too little data"
        )
    if not rest.is_steady:
        flags.append(
            f"the torque is not steady at rest: in ten minutes it rises by {max(rest.rise, rest.dither_growth):.3g}, "
            f"and then still moves by {rest.late_change:.3g}"
        )
    return flags
