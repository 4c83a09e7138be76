"""Training of a network: trials from several starts, a search from the best, and the best free run is kept."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import count

import numpy as np

from friction_hil.errors import UsageError
from friction_hil.friction import NetworkStructure, network
from friction_hil.numerics.jit import Array
from friction_hil.training import constraints, levenberg
from friction_hil.training import thresholds as th
from friction_hil.training.checks import Rest, at_rest
from friction_hil.training.constraints import Constraint
from friction_hil.training.first_weights import first_weights
from friction_hil.training.layout import Samples, empty
from friction_hil.training.objective import NetworkRun, Objective


@dataclass(frozen=True, slots=True)
class Progress:
    """State of a training after an iteration."""

    stage: str  # ``trial``, ``series-parallel`` or ``parallel``
    start: int  # its index, from 0
    starts: int  # their number
    iteration: int  # number of iterations so far, of all starts together
    most_iterations: int  # that there may be: a search ends earlier once it does not improve any more
    error: float  # NRMSE on the training set in the current stage
    validation_error: float  # NRMSE in free run on the validation set
    damping: float


@dataclass(frozen=True, slots=True)
class Errors:
    """NRMSE, root of the mean squared error over the standard deviation of the torque.

    In ``one_step`` (series-parallel) the network is fed the measured torques, in ``free_run`` its own.
    """

    one_step: float
    free_run: float


@dataclass(frozen=True, slots=True)
class Options:
    """Options of the search."""

    starts: int = 8  # that are tried
    survivors: int = 2  # starts that are continued
    trial_iterations: int = 25  # of each start
    iterations: int = 150  # further ones of each survivor

    def __post_init__(self) -> None:
        if not 1 <= self.survivors <= self.starts or min(self.trial_iterations, self.iterations) < 1:
            raise UsageError("a training needs one start or more, as many survivors at most, and one iteration of each")


@dataclass(frozen=True, slots=True)
class TrainingResult:
    """Result of one training: a network and its errors."""

    structure: NetworkStructure
    parameters: Array  # as `network.step` takes them
    train: Errors
    validation: Errors
    seed: int
    start: int  # index of the best one
    iterations: int  # of all starts together
    decay: float  # of the weights, in the best start
    # bound on the sum of slopes over the fed-back values; below 1 the network forgets its initial state
    feedback_gain: float
    rest: Rest  # behaviour in ten minutes at rest
    is_stopped: bool  # the callback ended the training
    history: tuple[Progress, ...] = field(repr=False)
    flags: tuple[str, ...] = ()  # warnings about the network


class _Start:
    """One start: its scales and first weights, and the best network found from them."""

    def __init__(self, number: int, training: "_Training") -> None:
        structure, samples = training.structure, training.samples
        random = np.random.default_rng((training.seed, number))
        self.number = number
        self.decay = th.DECAYS[number % len(th.DECAYS)]
        self.p = empty(structure, samples, th.SPEED_FACTORS[number // len(th.DECAYS) % len(th.SPEED_FACTORS)])
        if structure.kind == "gated":
            self.p[network.STROKE] *= random.uniform(1.2, 2.5)  # the stop explains the middle of several strokes
        self.constraint = Constraint(structure, constraints.CONTRACTIONS[structure.kind])
        self.at = first_weights(self.p, structure, samples, random)
        self.damping = 1e-2
        self.error = math.inf
        self.best = self.p.copy()
        self.best[network.HEADER :] = self.constraint.apply(self.at)[0]
        self.training_run = NetworkRun(self.p, samples)
        self.validation_run = NetworkRun(self.p, training.validation)


class _StoppedError(Exception):
    """The callback ended the training."""


class _Training:
    """Searches of one training and their history."""

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
        trials = 2 if structure.kind == "narx" else 1
        self._most_iterations = (
            options.starts * trials * options.trial_iterations + options.survivors * options.iterations
        )

    def search(self, start: _Start, stage: str, iterations: int, is_free: bool) -> None:
        """Continue the search of a start; keep the network with the best free run on validation."""
        objective = Objective(start.p, start.training_run, start.constraint, start.decay, is_free)
        stale = 0

        def judge(reached: levenberg.SearchStep) -> bool:
            nonlocal stale
            start.at, start.damping = reached.at, reached.damping
            p = objective.network_at(reached.at)
            error = start.validation_run.error(p, is_free=True)
            stale += 1
            if error < start.error:
                start.error, start.best, stale = error, p, 0
            train_error = math.sqrt(reached.cost)
            number = next(self._iterations)
            step = Progress(
                stage,
                start.number,
                self.options.starts,
                number,
                self._most_iterations,
                train_error,
                error,
                reached.damping,
            )
            self.history.append(step)
            if not self._goes_on(step):
                raise _StoppedError
            return stale < th.PATIENCE

        levenberg.minimise_unbounded(
            objective.cost,
            objective.normal_equations,
            start.at,
            iterations=iterations,
            damping=start.damping,
            goes_on=judge,
        )

    def run(self) -> tuple[_Start, bool]:
        """Return the best start, and True if the callback ended the training."""
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
) -> TrainingResult:
    """Train a network.

    Every start has its own scales of velocity, weight decay and random weights. After a few iterations of
    Levenberg-Marquardt the starts with the best free run on the validation samples are continued. The network with the
    best free run of all iterations is returned.

    ``samples`` and ``validation`` are different records, or the same motion with other weights (held-out blocks). The
    same seed gives the same bits. ``goes_on`` is called after every iteration; if it returns False, the training ends
    with the best network so far.

    Raises `UsageError`: all weights of one of the sets are zero, or its torque does not vary.
    """
    for name, each in (("training", samples), ("validation", validation)):
        if not np.any(each.weight > 0.0) or np.ptp(each.torque[each.weight > 0.0]) == 0.0:
            raise UsageError(f"the {name} samples need a torque that varies, and a weight above zero")
    training = _Training(structure, samples, validation, seed, options or Options(), goes_on)
    best, is_stopped = training.run()
    errors = [
        Errors(run.error(best.best, is_free=False), run.error(best.best, is_free=True))
        for run in (best.training_run, best.validation_run)
    ]
    rest = at_rest(structure, best.best, samples.dt)
    gain = best.constraint.feedback_gain(best.best[network.HEADER :])
    return TrainingResult(
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
    if validation.free_run > th.BAD:
        flags.append(f"free-run error on validation is {validation.free_run:.3g}: it has not learned this axis")
    if validation.free_run > max(3.0 * train.free_run, th.GOOD):
        flags.append(
            "free-run error on validation is above three times that on training: too many weights or too little data"
        )
    if not rest.is_steady:
        flags.append(
            f"the torque is not steady at rest: in ten minutes it rises by {max(rest.rise, rest.dither_growth):.3g}, "
            f"and then still moves by {rest.late_change:.3g}"
        )
    return flags
