"""Demand of another controller, from its set-points: exact for constant acceleration, robust to gaps and rounding."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from friction_hil.daemon.demand import SPAN, DemandEstimator

T, DELAY, LEAD = 1e-3, 1.5e-3, 1.1e-3


def motion(t):
    return 0.3 - 2.0 * t + 5.0 * t * t


def estimator():
    return DemandEstimator(T, DELAY, LEAD)


def test_constant_acceleration_is_exact():
    demand = estimator()
    for k in range(20):
        heard = demand.take(k, motion(k * T + DELAY))
        if k < SPAN - 1:
            assert all(map(math.isnan, heard))
            continue
        ahead = -2.0 + 10.0 * (k * T + LEAD)
        assert heard[:3] == pytest.approx((motion(k * T), -2.0 + 10.0 * k * T, ahead), abs=1e-9)
        assert heard[3] == pytest.approx(10.0 * (1.0 - 0.8 ** (k - SPAN + 2)), abs=1e-6)


@pytest.mark.parametrize("lost", [{30}, {30, 31}, {30, 32, 34}])
@pytest.mark.parametrize("is_missed", [False, True], ids=["repeated", "cycle missed"])
def test_lost_setpoints_leave_a_small_error_and_then_none(lost, is_missed):
    demand, heard = estimator(), None
    last = math.nan
    for k in range(60):
        if k in lost and is_missed:
            continue
        last = last if k in lost else 2.0 * (k * T + DELAY)
        heard = demand.take(k, last)
        if k >= SPAN:
            assert -1.0 < heard[2] < 3.0
        if k > 36 or SPAN <= k < 30:
            assert heard[:3] == pytest.approx((2.0 * k * T, 2.0, 2.0), abs=1e-9)


def test_setpoints_rounded_to_counts_give_a_quieter_velocity_than_their_difference():
    count = 2.0 * math.pi / 65536
    demand, errors, plain = estimator(), [], []
    before = 0.0
    for k in range(2000):
        setpoint = round(0.777 * (k * T + DELAY) / count) * count
        heard = demand.take(k, setpoint)
        if k > 10:
            errors.append(heard[2] - 0.777)
            plain.append((setpoint - before) / T - 0.777)
        before = setpoint
    assert math.hypot(*errors) < 0.9 * math.hypot(*plain)


def test_a_rest_is_a_rest_and_a_long_gap_is_not_bridged():
    demand, other = estimator(), estimator()
    for k in range(50):
        heard = demand.take(k, 1000.0 + motion(min(k, 20) * T))
    assert heard[:3] == (1000.0 + motion(20 * T), 0.0, 0.0)
    assert abs(heard[3]) < 1.0  # of 300 when it stopped
    for k in range(30):
        heard = other.take(k, motion(k * T + DELAY) if k < 20 else math.nan)
        if 20 <= k < 23:
            assert heard[0] == pytest.approx(motion(k * T), abs=1e-5)
        assert k < 23 or all(map(math.isnan, heard))


def test_without_a_demand_it_begins_anew():
    demand = estimator()
    for k in range(10):
        demand.take(k, motion(k * T))
    demand.forget()
    assert all(map(math.isnan, demand.take(10, math.nan)))
    for k in range(11, 11 + SPAN - 1):
        assert all(map(math.isnan, demand.take(k, 7.0)))
    assert demand.take(11 + SPAN, 7.0) == (7.0, 0.0, 0.0, 0.0)


@given(st.lists(st.booleans(), min_size=40, max_size=200), st.floats(-20.0, 20.0), st.floats(0.0, 3.0))
def test_lost_setpoints_do_not_turn_the_velocity_round(heard, acceleration, speed):
    """The motion goes on in one direction; whatever is lost, the demand says so, or that it is not known."""
    speed += SPAN * T * max(-acceleration, 0.0) + len(heard) * T * max(-acceleration, 0.0)
    demand = estimator()
    for k, is_heard in enumerate([True] * 20 + heard):
        time_s = k * T + DELAY
        setpoint = speed * time_s + 0.5 * acceleration * time_s**2 if is_heard else math.nan
        _, velocity, ahead, _ = demand.take(k, setpoint)
        slack = 0.05 + 12 * T * abs(acceleration)  # the acceleration is filtered, and a gap filled in by a line
        for value, at_s in ((velocity, k * T), (ahead, k * T + LEAD)):
            assert math.isnan(value) or value == pytest.approx(speed + acceleration * at_s, abs=slack)
