"""Set-points: derivatives, continuity, rest at both ends, and how they go on after missed periods."""

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
    sine_path,
    still_path,
    triangle_path,
)

PATHS = {
    "sine": sine_path(0.3, 1.5, 0.7),
    "circle": circle_path(0.5, 2.0, -0.4),
    "triangle": triangle_path(0.4, 1.0, 0.1),
    "rounded": triangle_path(0.4, 1.0, 0.5),
    "hold": still_path,
}
paths = pytest.mark.parametrize("path", PATHS.values(), ids=PATHS.keys())


def moving(path, ramp_s=0.5, start_s=0.2, stop_s=math.inf):
    time = PathTime(ramp_s)
    time.start(start_s)
    if math.isfinite(stop_s):
        time.stop(stop_s)
    trajectory = Trajectory(path, time)
    trajectory.begin_at(1.25)
    return trajectory, time


def difference(function, t, h=1e-4):
    """Central difference of eighth order."""
    weights = (4 / 5, -1 / 5, 4 / 105, -1 / 280)
    return sum(w * (function(t + k * h) - function(t - k * h)) for k, w in enumerate(weights, 1)) / h


@pytest.mark.parametrize("name", ["sine", "circle", "hold"])
@settings(max_examples=60, deadline=None)
@given(t=st.floats(0.0, 6.0), stop_s=st.floats(0.75, 4.0))
def test_velocity_and_acceleration_are_the_derivatives(name, t, stop_s):
    trajectory, _ = moving(PATHS[name], stop_s=stop_s)
    joints = (0.2, 0.7, stop_s, stop_s + 0.5)
    if min(abs(t - joint) for joint in joints) < 1e-3:
        return  # there a higher derivative jumps; continuity has its own test
    assert difference(lambda s: trajectory.at(s).position, t) == pytest.approx(trajectory.at(t).velocity, abs=1e-8)
    assert difference(lambda s: trajectory.at(s).velocity, t) == pytest.approx(trajectory.at(t).acceleration, abs=1e-7)


@settings(max_examples=100, deadline=None)
@given(st.floats(-3.0, 7.0), st.floats(0.01, 0.5))
def test_a_triangle_is_the_integral_of_its_velocity_everywhere(t, rounding):
    path = triangle_path(0.4, 1.0, rounding)
    h = 1e-5
    slope = (path(t + h)[0] - path(t - h)[0]) / (2 * h)
    assert slope == pytest.approx(path(t)[1], abs=2 * h * abs(1.6 / (rounding / 4)))
    s = np.linspace(t, t + 1.0, 2_001)
    velocity = np.array([path(x)[1] for x in s[:-1] + 2.5e-4])
    assert np.sum(velocity) * 5e-4 == pytest.approx(0.0, abs=1e-4)  # one period closes
    assert np.abs(velocity).max() == pytest.approx(1.6, rel=1e-9)


def test_a_triangle_has_its_corners_where_they_belong():
    path = triangle_path(0.4, 1.0, 0.1)
    assert [path(s)[0] for s in (0.0, 0.1, 0.5, 0.6, 1.0)] == pytest.approx([0.0, 0.16, 0.0, -0.16, 0.0], abs=1e-15)
    for s, position in ((0.25, 0.38), (0.75, -0.38), (-0.25, -0.38), (3.25, 0.38)):  # by speed * corner / 2 inside
        assert path(s)[:2] == pytest.approx((position, 0.0), abs=1e-12)
    assert path(0.25)[2] == pytest.approx(-1.6 / 0.025)


@paths
@pytest.mark.parametrize("stop_s", [0.3, 0.45, 0.7, 1.111, 3.0])
def test_position_and_velocity_are_continuous_also_in_a_stop_amid_the_start(path, stop_s):
    trajectory, _ = moving(path, stop_s=stop_s)
    t = np.linspace(0.0, 4.5, 9_001)
    position, velocity, acceleration = np.array([trajectory.at(float(one)) for one in t]).T
    bound = np.abs(acceleration).max() + 1e-9
    assert np.abs(np.diff(velocity)).max() <= 5.1e-4 * bound
    np.testing.assert_allclose(np.diff(position), 2.5e-4 * (velocity[1:] + velocity[:-1]), atol=2.5e-7 * bound)


@paths
def test_it_starts_and_comes_to_rest_without_a_jump(path):
    trajectory, time = moving(path, stop_s=2.0)
    assert trajectory.at(0.0) == trajectory.at(0.2) == (1.25, 0.0, 0.0)
    end = 2.0 + 0.5
    assert not time.is_standing(end - 1e-6)
    assert time.is_standing(end)
    rest = trajectory.at(end)
    assert (rest.velocity, rest.acceleration) == (0.0, 0.0)
    assert trajectory.at(end - 1e-9).position == pytest.approx(rest.position, abs=1e-12)
    assert trajectory.at(1e6) == rest


def test_at_full_speed_path_time_is_time():
    _, time = moving(still_path)
    assert time.at(1.0)[1:] == (1.0, 0.0)
    assert time.at(3.5)[0] - time.at(1.5)[0] == pytest.approx(2.0, abs=1e-12)
    assert time.at(0.7)[0] == pytest.approx(0.25, abs=1e-12)  # the ramp costs half its time
    assert not time.is_standing(1e9)


@settings(max_examples=100, deadline=None)
@given(st.floats(0.1, 2.0), st.floats(0.0, 3.0))
def test_a_stop_never_turns_round_and_takes_no_longer_than_the_ramp(ramp_s, after_s):
    time = PathTime(ramp_s)
    time.start(1.0)
    time.stop(1.0 + after_s)
    t = 1.0 + after_s + np.linspace(0.0, 1.2 * ramp_s, 400)
    path, rate, _ = np.array([time.at(float(one)) for one in t]).T
    assert np.all(np.diff(path) >= -1e-12)
    assert np.all((rate >= 0.0) & (rate <= 1.0 + 1e-12))
    assert np.all(np.diff(rate) <= 1e-12)
    assert time.is_standing(1.0 + after_s + ramp_s)


def test_only_the_first_stop_counts():
    trajectory, time = moving(PATHS["sine"], stop_s=1.0)
    before = trajectory.at(1.3)
    time.stop(1.2)
    assert trajectory.at(1.3) == before


@pytest.mark.parametrize("name", ["sine", "circle", "triangle", "rounded"])
def test_extent_bounds_the_path(name):
    path = PATHS[name]
    period = {"sine": 1 / 1.5, "circle": 0.5}.get(name, 1.0)
    low, high, speed = extent(path, period)
    s = np.linspace(0.0, 3.0 * period, 7919)
    position, velocity, _ = np.array([path(float(one)) for one in s]).T
    position -= path(0.0)[0]
    assert (low, high) == pytest.approx((position.min(), position.max()), abs=1e-5)
    assert speed == pytest.approx(np.abs(velocity).max(), rel=1e-4)


def test_two_axes_draw_a_circle_all_the_way():
    """They share the path time, so that they are on the circle also while they start and stop."""
    time = PathTime(0.5)
    axes = [Trajectory(circle_path(2.0, 1.0, phase), time) for phase in (0.0, -0.5 * math.pi)]
    axes[0].begin_at(2.0)
    axes[1].begin_at(0.0)
    time.start(0.0)
    time.stop(2.3)
    for t in np.linspace(0.0, 3.0, 301):
        assert math.hypot(*(axis.at(float(t)).position for axis in axes)) == pytest.approx(2.0, abs=1e-12)


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
