"""One simulated axis that is followed for a while, with learning or without."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from time import process_time
from typing import Any

import numpy as np

from friction_hil.compensator import Compensator, CompensatorSettings
from friction_hil.friction import FrictionModel
from friction_hil.learning.estimate import Mechanics
from friction_hil.learning.gaps import Gaps
from friction_hil.learning.learner import Learner
from friction_hil.learning.proposal import Proposal
from friction_hil.learning.states import LearnerSettings
from friction_hil.learning.thresholds import TICK_S
from friction_hil.learning.window import RECORDED
from friction_hil.numerics.jit import Array
from tools.benchmarks.compensation.grid import DriveLoops, Grid, Plant
from tools.benchmarks.compensation.motions import GridMotion
from tools.benchmarks.compensation.simulation import Error
from tools.benchmarks.learning.axis import Axis, Sensors

FADE_S = 0.5
_NOTHING = {name: np.empty(0) for name in (*RECORDED, "is_fresh")}  # no row of a later tick is known
_MOST_MISSED = 4  # periods in a row
Event = Callable[[Axis], None]


@dataclass(frozen=True, slots=True)
class Setup:
    """What is simulated.

    Attributes
    ----------
    plant, drive
        Of a grid file.
    believed : FrictionModel
        Of the model file.
    settings : CompensatorSettings
    motions : sequence of (float, GridMotion)
        Each with its duration, s, after which it stands at zero again.
    sensors : Sensors
    lead_s : float
    seed : int
    missed_until_s : float
        Until then the computer misses up to `_MOST_MISSED` periods about once a second.
    """

    plant: Plant
    drive: DriveLoops
    believed: FrictionModel
    settings: CompensatorSettings
    motions: Sequence[tuple[float, GridMotion]]
    sensors: Sensors
    lead_s: float
    seed: int = 1
    missed_until_s: float = 0.0


@dataclass(slots=True)
class Followed:
    """Errors of every cycle and what the learner did.

    Attributes
    ----------
    errors : (2, n) array
        Root mean square and peak of the true following error within each cycle, rad.
    compensation : (n,) array
    hand_overs : list of (float, Proposal)
        With their time, s.
    notes : list of (float, str)
    learner : Learner or None
    busy_s : float
        Processor time of learning.
    """

    errors: Array
    compensation: Array
    hand_overs: list[tuple[float, Proposal]] = field(default_factory=list)
    notes: list[tuple[float, str]] = field(default_factory=list)
    learner: Learner | None = None
    busy_s: float = 0.0

    def error(self, begin_s: float, end_s: float, period_s: float) -> Error:
        """Return root mean square and peak between two times, rad."""
        part = self.errors[:, round(begin_s / period_s) : round(end_s / period_s)]
        return Error(float(np.sqrt(np.mean(part[0] ** 2))), float(part[1].max()))


def setup(grid: Grid, plant: str, drive: str, motion: int, condition: str, seconds: float) -> Setup:
    """Return the setup of a case of a grid."""
    given = grid.conditions[condition]
    return Setup(
        grid.plants[plant],
        grid.drives[drive],
        grid.believed(plant, condition),
        replace(grid.settings(plant, drive, condition), fade_s=FADE_S),
        [(seconds, grid.motions[motion])],
        Sensors(bits=given.encoder_bits, delay_cycles=given.delay_cycles),
        grid.lead_s(drive, condition),
    )


def follow(
    of: Setup,
    seconds: float,
    *,
    is_learning: bool,
    has_layer: bool = True,
    has_families: bool = True,
    events: Mapping[float, Event] | None = None,
    retuned: Callable[[float], FrictionModel | None] | None = None,
) -> Followed:
    """Simulate an axis.

    Parameters
    ----------
    of : Setup
    seconds : float
    is_learning : bool
    has_layer : bool
        A residual layer is looked for, too.
    has_families : bool
        Other families of models are considered, too.
    events : mapping of float to callable
        What happens to the axis at a tick of this time, s.
    retuned : callable, optional
        Returns the model to go on with from a time on, None for the present one: a model tuned by hand.
    """
    period_s, settings, model = of.settings.period_s, of.settings, of.believed
    weight = settings.gravity[1]
    axis = Axis(of.plant, of.drive, Compensator(model, settings), replace(of.sensors), period_s, of.seed, weight)
    learner = None
    if is_learning:
        learner = Learner(
            model,
            Mechanics(settings.inertia, settings.gravity),
            {},
            LearnerSettings(
                period_s,
                settings.position_resolution,
                settings.gain,
                settings.fade_s,
                has_layer=has_layer,
                has_families=has_families,
            ),
        )
    cycles = round(TICK_S / period_s)
    gaps = Gaps(cycles, period_s)
    found = Followed(np.empty((2, 0)), np.empty(0), learner=learner)
    errors, compensation = [], []
    for tick in range(round(seconds / TICK_S)):
        at = tick * TICK_S
        for time_s, event in (events or {}).items():
            if abs(time_s - at) < 0.5 * TICK_S:
                event(axis)
        if retuned is not None and (better := retuned(at)) is not None:
            other = Compensator(better, settings)
            axis.compensator.adopt(other.record, axis.state_of(other) if tick else other.friction_state)
        is_late = learner is not None and at < of.missed_until_s
        rows, error = axis.move(*_demands(of, at, cycles), _missed(of.seed, tick, cycles) if is_late else ())
        errors.append(error)
        compensation.append(rows["compensation"])
        if learner is None:
            continue
        began = process_time()
        whole = gaps.fill({**rows, "is_fresh": np.ones_like(rows["cycle"])}, _NOTHING)
        proposal = learner.pause("too many rows are missing") if whole is None else learner.take(whole)
        found.busy_s += process_time() - began
        found.notes += [(at + TICK_S, note) for note in learner.notes]
        learner.notes.clear()
        if proposal is not None:
            found.hand_overs.append((at + TICK_S, proposal))
            model = proposal.model or model
            settings = replace(settings, gain=proposal.gain)
            other = Compensator(model, settings)
            axis.compensator.adopt(other.record, None if proposal.model is None else axis.state_of(other))
    found.errors, found.compensation = np.concatenate(errors, axis=1), np.concatenate(compensation)
    return found


def without(of: Setup, seconds: float, events: Mapping[float, Event] | None = None) -> Followed:
    """Simulate the axis without compensation."""
    return follow(replace(of, settings=replace(of.settings, gain=0.0)), seconds, is_learning=False, events=events)


def _missed(seed: int, tick: int, cycles: int) -> range:
    """Return the cycles of a tick that are missed, neither its first nor its last one."""
    random = np.random.default_rng((seed, tick))
    count = int(random.integers(1, _MOST_MISSED + 1)) if random.random() < TICK_S else 0
    first = int(random.integers(1, cycles - _MOST_MISSED))
    return range(first, first + count)


def _demands(of: Setup, begin_s: float, cycles: int) -> tuple[tuple[Array, Array, Array], tuple[Array, Array]]:
    """Return the demands at the samples of the drive, and those of each cycle when its torque acts."""
    samples = cycles * round(of.drive.rate_hz * of.settings.period_s)
    now = _at(of, begin_s + np.arange(samples) / of.drive.rate_hz)
    ahead = _at(of, begin_s + np.arange(cycles) * of.settings.period_s + of.lead_s)
    return now, (ahead[1], ahead[2])


def _at(of: Setup, t: Any) -> tuple[Array, Array, Array]:
    found = np.zeros((3, t.size))
    begin = 0.0
    for number, (seconds, motion) in enumerate(of.motions):
        is_last = number == len(of.motions) - 1
        part = (t >= begin - 1e-9) & ((t < begin + seconds - 1e-9) | is_last)
        if part.any():
            found[:, part] = motion.at(np.maximum(t[part] - begin, 0.0), of.seed)
        begin += seconds
    return found[0], found[1], found[2]
