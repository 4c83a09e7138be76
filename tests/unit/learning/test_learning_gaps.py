"""Missed periods and late feedback: filled in, marked, and left out of every comparison of errors."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from friction_hil.learning.gaps import Gaps
from friction_hil.learning.window import COLUMNS, RECORDED, errors_of

PERIOD_S, TICK = 2e-3, 125
RECOVERY = round(0.03 / PERIOD_S)


def rows_of(ticks, first=0):
    """A record of whole ticks of a motion to and fro with an error of its own, everything smooth."""
    cycle = np.arange(first, first + ticks * TICK, dtype=float)
    t = cycle * PERIOD_S
    demand = 0.2 * (1.0 - np.cos(math.tau * 0.5 * t))
    values = {
        "cycle": cycle,
        "position": demand - 1e-4 * np.sin(math.tau * 0.7 * t),
        "torque": 0.1 * np.sin(math.tau * 0.5 * t),
        "position_demand": demand,
        "velocity_demand": 0.2 * math.tau * 0.5 * np.sin(math.tau * 0.5 * t),
        "load_estimate": np.zeros(cycle.size),
        "temperature_estimate": np.full(cycle.size, math.nan),
        "compensation": 0.05 * np.cos(math.tau * 0.5 * t),
        "gain_factor": np.ones(cycle.size),
        "is_fresh": np.ones(cycle.size),
    }
    assert values.keys() == {*RECORDED, "is_fresh"}
    return values


def filled(values, is_there):
    """What becomes of each tick of a record of which rows are missing."""
    gaps, ticks = Gaps(TICK, PERIOD_S), []
    for k in range(len(is_there) // TICK):
        here = np.flatnonzero(is_there[k * TICK : (k + 1) * TICK]) + k * TICK
        after = np.flatnonzero(is_there[(k + 1) * TICK :])[:1] + (k + 1) * TICK
        parts = ({name: column[rows] for name, column in values.items()} for rows in (here, after))
        ticks.append(gaps.fill(*parts))
    return ticks


def test_a_whole_tick_stays_what_it_is():
    values = rows_of(2)
    for k, tick in enumerate(filled(values, np.ones(2 * TICK, dtype=bool))):
        assert tick.keys() == set(COLUMNS)
        for name in RECORDED:
            np.testing.assert_array_equal(tick[name], values[name][k * TICK : (k + 1) * TICK])
        assert not tick["is_disturbed"].any()


@given(first=st.integers(TICK + 1, 3 * TICK - 1), count=st.integers(1, 4))
@settings(deadline=None)
def test_missed_periods_are_filled_in_wherever_they_are_and_marked_until_the_axis_has_recovered(first, count):
    values, is_there = rows_of(4), np.ones(4 * TICK, dtype=bool)
    is_there[first : first + count] = False
    ticks = filled(values, is_there)
    found = {name: np.concatenate([tick[name] for tick in ticks]) for name in COLUMNS}
    np.testing.assert_array_equal(found["cycle"], values["cycle"])
    for name in RECORDED:
        np.testing.assert_array_equal(found[name][is_there], values[name][is_there])
    step = (count + 1) * PERIOD_S
    np.testing.assert_allclose(found["position_demand"], values["position_demand"], atol=0.25 * step**2)
    error, true = (each["position_demand"] - each["position"] for each in (found, values))
    np.testing.assert_allclose(error, true, atol=3e-4 * step**2)
    marked = np.flatnonzero(found["is_disturbed"])
    np.testing.assert_array_equal(marked, np.arange(first, first + count + RECOVERY + 5 * count))
    assert errors_of(found).size == 4 * TICK - marked.size


def test_a_position_that_did_not_arrive_is_not_taken_for_one():
    values = rows_of(2)
    late = slice(TICK + 40, TICK + 43)
    true = values["position"].copy()
    values["is_fresh"][late] = 0.0
    values["position"][late] = values["position"][TICK + 39]
    values["torque"][late] = math.nan
    _, tick = filled(values, np.ones(2 * TICK, dtype=bool))
    np.testing.assert_allclose(tick["position"], true[TICK:], atol=1e-7)
    assert np.isfinite(tick["torque"]).all()
    np.testing.assert_array_equal(np.flatnonzero(tick["is_disturbed"]), np.arange(40, 47))


@pytest.mark.parametrize(
    ("missing", "lost", "whole"),
    [
        pytest.param(slice(TICK, TICK + 13), 1, 3, id="too many"),
        pytest.param(slice(TICK, 2 * TICK, 20), 1, 3, id="disturbed throughout"),
        pytest.param(0, 0, 1, id="at the beginning"),
    ],
)
def test_of_a_tick_with_too_many_gaps_nothing_is_made_up_and_the_next_ones_are_whole(missing, lost, whole):
    is_there = np.ones(4 * TICK, dtype=bool)
    is_there[missing] = False
    ticks = filled(rows_of(4), is_there)
    assert ticks[lost] is None
    assert ticks[whole] is not None


def test_rows_that_nobody_has_read_are_no_missed_periods():
    """While code is compiled rows are overwritten: the loop did not miss them, and the axis was not disturbed."""
    gaps, empty = Gaps(TICK, PERIOD_S), {name: column[:0] for name, column in rows_of(1).items()}
    assert gaps.fill(rows_of(1), empty) is not None
    later = gaps.fill(rows_of(1, 20 * TICK), empty)
    assert not later["is_disturbed"].any()
