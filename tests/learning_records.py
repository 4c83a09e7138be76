"""Records of axes for tests of learning, and a learner that is given them tick by tick."""

import math

import numpy as np

import friction_hil as fh
from friction_hil.learning.coordinates import with_values
from friction_hil.learning.estimate import Mechanics
from friction_hil.learning.learner import Learner
from friction_hil.learning.states import LearnerSettings
from friction_hil.learning.thresholds import TICK_S
from friction_hil.learning.window import COLUMNS, Window
from tests.compensators import INERTIA, LUGRE, PERIOD_S, quantised, resolution

COUNT = resolution(20)
WRONG = with_values(LUGRE, {"coulomb": 0.85 * 0.08, "static": 1.1 * 0.12, "sigma2": 1.6e-3, "sigma0": 2400.0})
DIRECTED = fh.models.create(
    "lugre",
    **LUGRE.given,
    modifiers={"direction": {"positive": {"coulomb": 0.09}}, "ripple": [{"order": 4.0, "cosine": 0.01, "sine": 0.0}]},
)


def motion(t, amplitude=0.2, frequency=0.5):
    """Position and velocity of a sine that begins at rest."""
    w = math.tau * frequency
    return amplitude * (1.0 - np.cos(w * t)), amplitude * w * np.sin(w * t)


def record(seconds, true=LUGRE, begin_s=0.0, count=COUNT, error=0.0, seed=None, inertia=INERTIA, **course):
    """Rows of an axis that follows a sine with a sine of an error; its torque is that of friction and inertia."""
    t = np.arange(round(seconds / PERIOD_S)) * PERIOD_S + begin_s
    demand, velocity = motion(t, **course)
    before = np.arange(-round(2.0 / PERIOD_S), t.size) * PERIOD_S + begin_s  # so that the state is that of the motion
    past = np.diff(motion(before, **course)[0], prepend=motion(before[:1] - PERIOD_S, **course)[0]) / PERIOD_S
    friction = true.simulate(past, PERIOD_S, position=motion(before, **course)[0])[-t.size :]
    torque = friction + inertia * np.gradient(velocity, PERIOD_S)
    if seed is not None:
        torque = torque + 0.001 * np.random.default_rng(seed).standard_normal(t.size)
    values = {
        "cycle": np.round(t / PERIOD_S),
        "position": quantised(demand - error * np.sin(math.tau * 3.0 * t), count),
        "torque": torque,
        "position_demand": demand,
        "velocity_demand": velocity,
        "load_estimate": np.zeros(t.size),
        "temperature_estimate": np.full(t.size, math.nan),
        "compensation": 0.9 * friction,
        "gain_factor": np.ones(t.size),
        "is_disturbed": np.zeros(t.size),
    }
    return {name: values[name] for name in COLUMNS}


def levels(factor):
    """The true model with levels that are so many times as high."""
    return with_values(LUGRE, {name: factor * LUGRE.given[name] for name in ("coulomb", "static", "sigma2")})


def window(rows):
    names = ("position", "torque", "position_demand", "load_estimate", "temperature_estimate")
    return Window(PERIOD_S, *(rows[name] for name in names))


class Driven:
    """A learner that is given rows tick by tick."""

    def __init__(self, model=WRONG, gain=0.9, **options):
        self.learner = Learner(
            model, Mechanics(INERTIA), {}, LearnerSettings(PERIOD_S, COUNT, gain, fade_s=0.5, **options)
        )
        self.ticks, self.proposals, self.notes = 0, [], []

    def take(self, ticks, until=None, change=None, is_in_force=True, may_estimate=True, **given):
        for _ in range(ticks):
            rows = record(TICK_S, begin_s=self.ticks * TICK_S, **given)
            if change is not None:
                change(rows)
            proposal = self.learner.take(rows, is_in_force=is_in_force, may_estimate=may_estimate)
            self.ticks += 1
            self.notes += self.learner.notes
            self.learner.notes.clear()
            if proposal is not None:
                self.proposals.append((self.ticks, proposal))
                if until is not None and proposal.step is until:
                    break
        return self
