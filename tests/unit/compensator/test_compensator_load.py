"""The load that the friction model is given: weight and inertia of the demanded motion, and nothing of the measured."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import friction_hil as fh
from tests.compensators import LUGRE, columns, compensator, resolution, row
from tests.two_masses import PERIOD_S, Side, TwoMasses, follow, sine

LOADED = fh.models.create("coulomb", coulomb=0.03, modifiers={"load": {"motoring": 0.3, "driven": 0.3}})
number = st.floats(-100.0, 100.0)


def one(**changes):
    given = {"position_resolution": resolution(20), "torque_limit": 1.0, "lead_s": 1.8e-3, "inertia": 5e-4}
    return compensator(LOADED, **given | {"fade_s": 0.1} | changes)


@given(number, number, number, st.tuples(*[st.floats(-2.0, 2.0)] * 3), st.one_of(st.none(), st.floats(0.0, 5e-4)))
def test_the_load_is_weight_and_inertia_of_the_demand_when_the_torque_acts(q, v, a, gravity, inertia):
    unit = one(gravity=gravity, load_inertia=inertia)
    unit.step(*row(0, position=7.0, position_demand=q, velocity_demand=v, velocity_demand_ahead=v)[:9], a)
    there = q + 1.8e-3 * v
    weight = gravity[0] + gravity[1] * math.sin(there) + gravity[2] * math.cos(there)
    expected = weight + (5e-4 if inertia is None else inertia) * a
    assert unit.load_estimate == pytest.approx(expected, rel=1e-12, abs=1e-12)


@given(st.lists(st.tuples(number, number, number), min_size=2, max_size=20))
def test_nothing_measured_enters_the_load_of_a_known_demand(measured):
    t = np.arange(len(measured)) * PERIOD_S
    demand = {"position_demand": 3.0 * t, "velocity_demand": 3.0, "velocity_demand_ahead": 3.0}
    demand["acceleration_demand_ahead"] = 5.0 * np.cos(40.0 * t)
    position, velocity, torque = np.array(measured).T
    still, moved = one(gravity=(0.1, 0.2, 0.3)), one(gravity=(0.1, 0.2, 0.3))
    expected = still.replay_all(columns(len(t), **demand))["load_estimate"]
    found = moved.replay_all(columns(len(t), position=position, velocity=velocity, torque=torque, **demand))
    np.testing.assert_array_equal(found["load_estimate"], expected)


def test_without_a_demand_the_load_is_the_weight_where_the_axis_is():
    unit = one(gravity=(0.0, 0.4, 0.0))
    unit.step(*row(0, position=0.5))
    assert unit.load_estimate == pytest.approx(0.4 * math.sin(0.5), abs=1e-4)


def test_the_load_does_not_touch_a_model_that_does_not_depend_on_it():
    t = np.arange(400) * PERIOD_S
    demand = {"position_demand": 0.1 * np.sin(9 * t), "velocity_demand": 0.9 * np.cos(9 * t)}
    demand |= {"velocity_demand_ahead": 0.9 * np.cos(9 * t), "position": 0.1 * np.sin(9 * t)}
    plain, loaded = compensator(LUGRE).replay(columns(400, **demand))
    plain2, loaded2 = compensator(LUGRE).replay(columns(400, **demand, acceleration_demand_ahead=1e4))
    np.testing.assert_array_equal([plain, loaded], [plain2, loaded2])


@pytest.mark.parametrize("weight", [0.0, 0.05])
def test_with_the_inertia_in_the_load_the_error_of_the_load_falls(weight):
    """Friction at the motor grows by 0.3 of the torque that the spring of the witness carries."""

    def error(load_inertia):
        axis = TwoMasses(Side(1e-4, 0.03), Side(4e-4), per_load=0.3, stiffness=2000.0, damping=0.05)
        axis.weight = lambda position: weight * math.sin(position)
        unit = one(load_inertia=load_inertia, gravity=(0.0, weight, 0.0))
        run = follow(axis, unit, sine(0.5, 2.0), 1.0)
        return np.abs(run["demand"] - run["load"])[500:]

    static, live = error(0.0), error(4e-4)
    assert live.max() < 0.5 * static.max()
    if weight == 0.0:  # a weight that nothing balances is part of the error
        assert live.max() < 0.1 * static.max()
        assert np.mean(live**2) < 0.01 * np.mean(static**2)
