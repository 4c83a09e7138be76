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
    return {
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


def taken(one, tick, missing=(), *, is_busy=False, **given):
    """Give a tick to the learning of an axis, without some of its rows; return what it does then, and why."""
    rows, after = rows_of(tick, **given), {name: column[:1] for name, column in rows_of(tick + 1).items()}
    there = np.setdiff1d(np.arange(TICK), missing)
    one.take({name: column[there] for name, column in rows.items()}, after, is_in_force=True, is_busy=is_busy)
    return one.report()["doing"], one.report()["reason"]


WATCHING, MANY = ("watching", ""), range(50, 90)


@pytest.mark.parametrize(
    ("given", "doing", "after", "kept"),
    [
        ({"missing": [100, 101]}, WATCHING, {"missing": [TICK - 1]}, 3),
        ({"missing": MANY}, ("waiting", "too many rows are missing"), {}, 1),
        ({"missing": MANY, "state": LoopState.IDLE}, ("waiting", "the axis is not in compensated motion"), {}, 1),
        ({"is_busy": True}, ("waiting", "this process has used its share of the processor"), {}, 3),
    ],
    ids=["missed periods", "too many gaps", "at rest, whatever is missing", "busy"],
)
def test_what_interrupts_learning_is_said_and_only_gaps_and_rest_begin_the_record_anew(given, doing, after, kept):
    one = AxisLearning("x", CONFIG, FACTS, PERIOD_S, None)
    assert taken(one, 0) == WATCHING
    assert taken(one, 1, **given) == doing
    assert taken(one, 2, **after)[0] == "watching"
    assert len(one.learner.record.ticks) == kept
