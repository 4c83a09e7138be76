"""Set-points: derivatives against differences, continuity, and rest at both ends."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from friction_hil.motion.trajectory import (
    PathTime,
    Trajectory,
    circle_path,
    extent,
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
