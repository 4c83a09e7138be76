"""Missed periods: set-points go on from the last one, and catch up within limits, on the common path of all axes."""

import math

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from friction_hil.motion.catch_up import HeldTime
from friction_hil.motion.trajectory import (
    PathTime,
    Trajectory,
    circle_path,
    extent,
    largest_acceleration,
    triangle_path,
)

PERIOD_S = 1e-3
DELAY_S = 2.5e-3  # from sending a set-point to the drive's demand
RADIUS, FREQUENCY = 0.4, 0.8
SPEED = 2.0 * math.pi * FREQUENCY * RADIUS
ACCELERATION = 2.0 * math.pi * FREQUENCY * SPEED

stalls = st.dictionaries(st.integers(0, 2500), st.integers(1, 9), max_size=12)


class Machine:
    """The axes of a machine over periods, some of which are missed."""

    def __init__(self, *paths, limit=1.5 * SPEED, ramp_s=0.5):
        self.time = PathTime(ramp_s)
        self.axes = [Trajectory(path, self.time) for path in paths]
        for path in paths:
            self.time.keep_within(limit, extent(path, 1.0 / FREQUENCY)[2], largest_acceleration(path, 1.0 / FREQUENCY))
        self.sent, self.lags = [], []

    def run(self, stalls, cycles=3000, stop_cycle=math.inf):
        """Send set-points as the loop does; ``stalls`` are missed periods by the cycle at which they begin."""
        self.time.start(PERIOD_S + DELAY_S)
        cycle = 0
        while cycle < cycles:
            if missed := stalls.get(cycle, 0):
                cycle += missed
                self.time.hold(cycle * PERIOD_S, missed * PERIOD_S, cycle * PERIOD_S + DELAY_S)
            if cycle >= stop_cycle:
                self.time.stop(cycle * PERIOD_S + PERIOD_S + DELAY_S)
            self.sent.append([axis.at(cycle * PERIOD_S + DELAY_S).position for axis in self.axes])
            self.lags.append(self.time.lag_s(cycle * PERIOD_S))
            cycle += 1
        return np.array(self.sent).T


def circle(phase=0.0):
    return circle_path(RADIUS, FREQUENCY, phase)


@settings(max_examples=30, deadline=None)
@example({}, 1.02, math.inf)
@example({700: 9, 701: 9, 702: 9, 710: 1}, 1.5, 1500)
@given(stalls, st.floats(1.0, 3.0), st.one_of(st.just(math.inf), st.integers(0, 2500)))
def test_whatever_is_missed_the_drives_are_asked_for_a_motion_within_the_limits(stalls, headroom, stop_cycle):
    """By differences of what is sent, period by period, as a drive sees it that holds its last set-point."""
    limit = headroom * SPEED
    machine = Machine(circle(), circle(-0.5 * math.pi), limit=limit)
    sent = machine.run(stalls, stop_cycle=stop_cycle)
    velocity = np.diff(sent) / PERIOD_S
    assert np.abs(velocity).max() <= 0.5 * (limit + SPEED) * (1.0 + 1e-6)
    assert np.abs(velocity).max() <= 1.1 * SPEED * (1.0 + 1e-6)
    ramp = 1.5 / 0.5 * SPEED * 1.21  # of start and stop, at the faster rate
    acceleration = np.abs(np.diff(velocity)) / PERIOD_S
    assert acceleration.max() <= 1.41 * ACCELERATION + ramp + 1e-6
    if math.isinf(stop_cycle):
        assert acceleration[:, 600:].max() <= 1.41 * ACCELERATION + 1e-6
    # the circle stays one, also between the cycles of a catch-up: both axes are at the same path time
    np.testing.assert_allclose(np.hypot(*sent), RADIUS, rtol=1e-14)


@settings(max_examples=30, deadline=None)
@given(stalls, st.floats(1.05, 3.0))
def test_path_time_catches_up_and_is_never_ahead(stalls, headroom):
    machine = Machine(circle(), limit=headroom * SPEED)
    machine.run(stalls, cycles=2600)
    lags = np.array([*machine.lags, *(machine.time.lag_s(2.6 + 0.05 * k) for k in range(200))])
    assert np.all(lags >= 0.0)
    assert lags.max() <= PERIOD_S * sum(stalls.values()) * (1.0 + 1e-9)
    assert lags[-1] == 0.0
    prompt = Machine(circle())
    prompt.run({}, cycles=1)
    assert [axis.at(20.0) for axis in machine.axes] == [axis.at(20.0) for axis in prompt.axes], "to the bit"


@settings(max_examples=30, deadline=None)
@given(stalls)
def test_rate_and_its_derivative_are_those_of_the_time(stalls):
    time, now = HeldTime(excess=0.1, change=2.0), 0.0
    for cycle, missed in sorted(stalls.items()):
        now = max(now + PERIOD_S, cycle * PERIOD_S) + missed * PERIOD_S
        before = time.at(now - missed * PERIOD_S)
        time.hold(now, missed * PERIOD_S, now + DELAY_S)
        assert time.at(now) == pytest.approx(before, abs=1e-12), "it goes on from where it was, as it was"
    t, h = now + np.linspace(0.0, 2.0, 400), 1e-6
    motion, rate, change = np.array([time.at(float(one)) for one in t]).T
    later = np.array([time.at(float(one + h)) for one in t]).T
    np.testing.assert_allclose((later[0] - motion) / h, rate, atol=1e-5)
    np.testing.assert_allclose((later[1] - rate) / h, change, atol=1e-3)
    assert np.all((rate >= 1.0) & (rate <= 1.1 + 1e-12))
    assert np.all(np.abs(change) <= 2.0 * (1.0 + 1e-12))
    np.testing.assert_allclose([time.lag_s(float(one)) for one in t], t - motion, atol=1e-12)


def test_a_path_at_its_velocity_limit_remains_behind():
    machine = Machine(circle(), limit=SPEED)
    sent = machine.run({1000: 5, 1500: 2}, cycles=4000)
    assert machine.lags[-1] == pytest.approx(7e-3)
    assert np.abs(np.diff(sent)).max() <= SPEED * PERIOD_S * (1.0 + 1e-9)


def test_the_axis_with_the_least_room_decides_for_all():
    slow, fast = PathTime(0.5), PathTime(0.5)
    for time, limit in ((slow, 1.04), (fast, 9.0)):
        time.keep_within(9.0, 1.0, 5.0)
        time.keep_within(limit, 1.0, 5.0)
        time.keep_within(1.0, 0.0, 0.0)  # an axis that holds
        time.start(0.0)
        time.hold(1.0, 9e-3, 1.0)
    rates = [max(time.at(1.0 + 0.01 * k)[1] for k in range(300)) for time in (slow, fast)]
    assert rates[0] == pytest.approx(1.02, abs=1e-3)
    assert 1.05 < rates[1] <= 1.1


def test_corners_of_a_triangle_are_passed_within_the_limits_too():
    path = triangle_path(0.4, FREQUENCY, 0.1)
    speed = extent(path, 1.0 / FREQUENCY)[2]
    machine = Machine(path, limit=1.2 * speed)
    velocity = np.diff(machine.run({200 + 150 * k: 6 for k in range(15)})) / PERIOD_S
    assert np.abs(velocity).max() <= 1.1 * speed * (1.0 + 1e-6)


def test_what_is_missed_before_the_start_delays_nothing():
    time, prompt = PathTime(0.5), PathTime(0.5)
    time.hold(0.5, 0.2, 0.5)
    for one in (time, prompt):
        one.start(1.0)
    assert [time.at(t) for t in (1.0, 1.2, 3.0)] == [prompt.at(t) for t in (1.0, 1.2, 3.0)]
    assert time.lag_s(2.0) == 0.0


def test_a_stop_ends_later_by_what_was_missed_in_it():
    time = PathTime(0.5)
    time.keep_within(1.0, 1.0, 5.0)  # a path at its velocity limit, which does not catch up
    time.start(0.0)
    time.stop(2.0)
    time.hold(2.2, 8e-3, 2.2)
    assert not time.is_standing(2.5)
    assert time.is_standing(2.508)
    assert time.at(2.508)[1:] == (0.0, 0.0)
