"""What the process that learns makes of the rows of a daemon: those of a busy computer, and of an axis at rest."""

import math
from pathlib import Path

import numpy as np
import pytest

from friction_hil.config import load
from friction_hil.daemon.safety import LoopState
from friction_hil.drive import AxisFacts
from friction_hil.learning.process import AxisLearning

PERIOD_S, TICK = 1e-3, 250
AXIS = load(Path(__file__).parents[3] / "config/demo.yaml").axes["x"]
CONFIG = AXIS.model_copy(update={"compensation": AXIS.compensation.model_copy(update={"learning": "on"})})
FACTS = AxisFacts("x", "servo", 6e-6, 1e-4, 2.5e-3, 1.5e-3)


def rows_of(tick, state=LoopState.RUNNING):
    cycle = np.arange(tick * TICK, (tick + 1) * TICK, dtype=float)
    angle = math.tau * 0.5 * cycle * PERIOD_S
    rows = {
        "cycle": cycle,
        "position": 1.0 - np.cos(angle),
        "torque": 0.08 * np.sign(np.sin(angle)) + 1e-4 * np.sin(7.0 * angle),
        "position_demand": 1.0 - np.cos(angle),
        "velocity_demand": math.tau * 0.5 * np.sin(angle),
        "load_estimate": np.zeros(TICK),
        "temperature_estimate": np.full(TICK, math.nan),
        "compensation": 0.07 * np.sign(np.sin(angle)),
        "gain_factor": np.ones(TICK),
        "state": np.full(TICK, float(state)),
        "is_enabled": np.ones(TICK),
        "is_fresh": np.ones(TICK),
    }
    return rows


def taken(one, tick, missing=(), *, is_busy=False, **given):
    """Give a tick to the learning of an axis, without some of its rows; return what it does then, and why."""
    rows, after = rows_of(tick, **given), {name: column[:1] for name, column in rows_of(tick + 1).items()}
    there = np.setdiff1d(np.arange(TICK), missing)
    one.take({name: column[there] for name, column in rows.items()}, after, is_in_force=True, is_busy=is_busy)
    return one.report()["doing"], one.report()["reason"]


@pytest.fixture
def one():
    return AxisLearning("x", CONFIG, FACTS, PERIOD_S, None)


def test_missed_periods_do_not_end_the_record(one):
    assert taken(one, 0) == ("watching", "")
    assert taken(one, 1, missing=[100, 101]) == ("watching", "")
    assert taken(one, 2, missing=[TICK - 1]) == ("watching", "")
    assert len(one.learner.record.ticks) == 3


def test_a_record_with_too_many_gaps_begins_anew(one):
    taken(one, 0)
    assert taken(one, 1, missing=range(50, 90)) == ("waiting", "too many rows are missing")
    assert taken(one, 2)[0] == "watching"
    assert len(one.learner.record.ticks) == 1


def test_an_axis_at_rest_is_not_in_compensated_motion_whatever_is_missing(one):
    taken(one, 0)
    doing = taken(one, 1, missing=range(50, 90), state=LoopState.IDLE)
    assert doing == ("waiting", "the axis is not in compensated motion")


def test_a_process_that_is_too_busy_says_so_and_goes_on_with_its_record(one):
    taken(one, 0)
    assert taken(one, 1, is_busy=True) == ("waiting", "this process has used its share of the processor")
    assert taken(one, 2) == ("watching", "")
    assert len(one.learner.record.ticks) == 3
