"""Offset of the motor across gap and twist: its bounds, and what it does to the load of two masses."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import friction_hil as fh
from friction_hil.errors import UsageError
from tests.compensators import columns, compensator, resolution
from tests.two_masses import PERIOD_S, Side, TwoMasses, follow, sine

GAP = 2e-3
COULOMB = fh.models.create("coulomb", coulomb=0.04)


def one(gap=GAP, model=COULOMB, **changes):
    given = {"position_resolution": resolution(20), "torque_limit": 1.0, "lead_s": 1.8e-3, "setpoint_delay_s": 1e-3}
    given |= {"gain": 0.9, "fade_s": 0.1, "load_inertia": 1e-4, "load_friction": 0.02, "backlash": gap}
    given |= {"offset_limit": max(0.5 * gap, 1e-9), "offset_acceleration": 300.0, "velocity_limit": 30.0}
    return compensator(model, **given | changes)


def offsets(unit, velocity, acceleration=0.0, position=0.0, **given):
    """Offset in each cycle of a demand."""
    velocity = np.asarray(velocity, dtype=float)
    demand = {"position_demand": position, "velocity_demand": velocity, "velocity_demand_ahead": velocity}
    demand |= {"acceleration_demand_ahead": acceleration}
    return unit.replay_all(columns(velocity.size, **demand, **given))["motor_offset"]


def load_errors(axis, unit, motion):
    run = follow(axis, unit, motion, 1.5)
    error = (run["demand"] - run["load"])[400:]
    return math.sqrt(np.mean(error**2)), np.abs(error).max()


@pytest.mark.parametrize("friction", [0.005, 0.02, 0.04])
@pytest.mark.parametrize("motion", [(0.02, 1.0), (0.2, 2.0)])
def test_the_error_of_the_load_falls_by_more_than_four(friction, motion):
    axes = [TwoMasses(Side(1e-4, 0.04 - friction), Side(1e-4, friction), gap=GAP) for _ in range(2)]
    without = load_errors(axes[0], one(0.0), sine(*motion))
    crossed = load_errors(axes[1], one(load_friction=friction), sine(*motion))
    assert crossed[0] < 0.25 * without[0]
    assert crossed[1] < 0.5 * without[1]


@pytest.mark.parametrize("weight", [0.01, 0.03, 0.06])
def test_a_weight_decides_whether_the_contact_changes_at_all(weight):
    sides = ({"motor": Side(1e-4, 0.02), "load": Side(1e-4, 0.02)} for _ in range(2))
    axes = [TwoMasses(**each, gap=GAP, weight=lambda position: weight) for each in sides]
    gravity = {"gravity": (weight, 0.0, 0.0)}
    without = load_errors(axes[0], one(0.0, **gravity), sine(0.2, 1.0))
    crossed = load_errors(axes[1], one(**gravity), sine(0.2, 1.0))
    assert crossed[0] < 0.4 * without[0]
    changes = np.ptp(offsets(one(**gravity), 0.3 * np.sin(np.arange(1500) * 6.0 * PERIOD_S))[600:])
    assert changes == pytest.approx(GAP if weight < 0.02 else 0.0, abs=1e-9)


@pytest.mark.parametrize(("rate", "side"), [(100.0, 1.0), (1000.0, -1.0)])
def test_a_load_that_is_braked_harder_than_its_friction_brakes_it_goes_over_before_it_stops(rate, side):
    """1e-4 kg m^2 times the rate is below or above the 0.02 N m of friction; the load stops in cycle 150."""
    speed = 0.3 * rate * np.cos(2.0 * np.pi * np.arange(600) / 600)
    found = offsets(one(velocity_limit=1e4, offset_acceleration=1e4), speed, -rate * np.sign(speed))
    np.testing.assert_allclose(found[115:145], side * 0.5 * GAP, rtol=1e-3)


@pytest.mark.parametrize("bound", [math.inf, 0.05])
def test_the_gap_is_crossed_in_the_shortest_time_within_the_bounds(bound):
    speed = np.r_[np.full(500, 0.1), np.full(300, -0.1)]
    found = offsets(one(offset_velocity=bound), speed)
    assert found[499] == pytest.approx(0.5 * GAP, rel=1e-6)
    crossing = np.flatnonzero((np.diff(found, append=found[-1]) != 0.0) & (np.arange(800) >= 500))
    by_acceleration = 2.0 * math.sqrt(GAP / 300.0)
    shortest = by_acceleration if bound * bound >= 300.0 * GAP else GAP / bound + bound / 300.0
    taken = (crossing[-1] - crossing[0] + 1) * PERIOD_S
    assert shortest - 2 * PERIOD_S <= taken <= shortest + 4 * PERIOD_S
    assert found[-1] == pytest.approx(-0.5 * GAP, rel=1e-6)


moves = st.lists(st.tuples(st.floats(-40.0, 40.0), st.floats(-1e4, 1e4), st.booleans(), st.integers(1, 12)), min_size=1)


@settings(max_examples=60, deadline=None)
@given(moves, st.floats(1e-6, 1.0), st.floats(1.0, 1e4), st.floats(1e-3, 10.0))
def test_the_offset_keeps_its_bounds_whatever_is_demanded(moves, gap, acceleration, velocity):
    unit = one(gap, offset_acceleration=acceleration, offset_velocity=velocity)
    cycle, before = 0, (0.0, 0.0)
    for speed, a, is_enabled, elapsed in moves:
        cycle += elapsed
        unit.step(float(cycle), 0.0, 0.0, 0.0, 0.0, speed, speed, True, is_enabled, a)
        (offset, rate), steps = unit.offset_sent, elapsed * PERIOD_S
        assert abs(offset) <= 0.5 * gap * (1.0 + 1e-12)
        assert abs(rate) <= velocity * (1.0 + 1e-12)
        assert abs(offset - before[0]) <= velocity * steps * (1.0 + 1e-9)
        assert abs(rate - before[1]) <= acceleration * steps * (1.0 + 1e-9)
        before = (offset, rate)


def test_it_fades_with_the_compensation_and_is_nothing_where_that_is_off_or_without_a_demand():
    speed, is_early = np.full(1000, 0.1), np.arange(1000) < 500
    assert not offsets(one(), speed, is_enabled=0.0).any()
    found = offsets(one(fade_s=0.2), speed, is_enabled=is_early.astype(float))
    assert found[600] == pytest.approx(0.25 * GAP, rel=0.05)
    for each in (found, offsets(one(), np.where(is_early, speed, math.nan))):
        assert each[499] == pytest.approx(0.5 * GAP, rel=1e-6)
        assert each[-1] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(
    ("wrong", "named"),
    [
        ({"offset_acceleration": math.nan}, "offset_acceleration"),
        ({"stiffness": 0.0}, "stiffness"),
        ({"offset_limit": math.nan}, "offset_limit"),
        ({"offset_velocity": 0.0}, "offset_velocity"),
        ({"load_friction": None}, "load_friction"),
        ({"load_friction": 0.0}, "load_friction"),
        ({"load_inertia": None}, "load_inertia"),
        ({"backlash": -1.0}, "width"),
        ({"backlash": math.nan}, "width"),
    ],
)
def test_settings_that_make_no_sense_are_refused(wrong, named):
    with pytest.raises(UsageError, match=named):
        one(**({"gap": wrong["backlash"]} if "backlash" in wrong else wrong))


@pytest.mark.deep
@pytest.mark.parametrize("friction", [(0.04, 0.04), (0.0, 0.08)])
@pytest.mark.parametrize("motion", [(0.02, 0.5), (0.2, 0.5), (0.2, 2.0)])
@pytest.mark.parametrize("gap", [0.0, GAP])
def test_the_twist_by_friction_at_the_load_is_taken_up(friction, motion, gap):
    """50 N m/rad: half of the friction at the load twists the transmission by 0.8 mrad."""

    def errors(**changes):
        axis = TwoMasses(Side(1e-4, friction[0]), Side(1e-4, friction[1]), 50.0, 5e-3, gap, velocity_gain=0.2)
        changes |= {"load_friction": friction[1], "offset_limit": 0.01}
        return load_errors(axis, one(gap, fh.models.create("coulomb", coulomb=0.08), **changes), sine(*motion))

    without, taken_up = errors(offset_acceleration=0.0), errors(stiffness=50.0)
    assert taken_up[0] < 0.25 * without[0]
    assert taken_up[1] < 0.6 * without[1]


def test_weight_and_inertia_twist_the_transmission_too():
    t = np.arange(2000) * PERIOD_S
    position, speed, acceleration = 0.3 * np.sin(2.0 * t), 0.6 * np.cos(2.0 * t), -1.2 * np.sin(2.0 * t)
    changes = {"load_friction": 0.0, "load_inertia": 0.02, "offset_limit": 1.0, "gain": 1.0}
    unit = one(0.0, stiffness=10.0, gravity=(0.05, 0.02, 0.01), **changes)
    found = offsets(unit, speed, acceleration, position)
    carried = 0.05 + 0.02 * np.sin(position) + 0.01 * np.cos(position) + 0.02 * acceleration
    np.testing.assert_allclose(found[500:], carried[500:] / 10.0, atol=2e-5)


def through_a_reversal(friction, stiffness):
    """Travel since a reversal, and the compensation, with a load that has half of the friction."""
    t = PERIOD_S * np.arange(1000)
    velocity = 6e-3 * np.sin(2.0 * math.pi * t)
    given = {"velocity_demand": velocity, "velocity_demand_ahead": velocity}
    travel = PERIOD_S * np.cumsum(velocity)
    settings = {"stiffness": stiffness, "lead_s": 0.0, "gain": 1.0, "source": "demand", "offset_acceleration": 0.0}
    unit = one(0.0, friction, **settings)
    torque = unit.replay_all(columns(t.size, position=travel, **given))["compensation"]
    return travel[500] - travel[500:750], torque[500:750]


def test_friction_of_the_load_is_felt_as_the_spring_is_wound_up():
    travel, torque = through_a_reversal(COULOMB, 50.0)
    felt = -0.02 + np.maximum(0.02 - 50.0 * travel, -0.02)
    slides = travel > 1e-4  # the static map itself has reversed
    np.testing.assert_allclose(torque[slides], felt[slides], atol=1e-3)


def test_a_spring_stiffer_than_the_bristles_changes_nothing():
    """The model holds the presliding as the motor feels it; to reverse the load's part sooner would push the axis."""
    soft = fh.models.create("dahl", sigma0=100.0, coulomb=0.04)
    np.testing.assert_allclose(through_a_reversal(soft, 1000.0)[1], through_a_reversal(soft, math.inf)[1], atol=1e-9)
