"""A delay of the demand is found in following errors, told from friction, and left out of the comparison."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from friction_hil.cli.work.run import _hint
from friction_hil.daemon.delay_fit import DelaySums
from friction_hil.daemon.figures import AxisFigures, Condition, FollowingErrors
from tests.loop_run import heard
from tests.unit.daemon import test_follower

T = 4e-3
TIME = np.arange(1000) * T
MOTIONS = {
    "sine": (0.5 * math.pi * np.sin(math.pi * TIME), 0.5 * math.pi**2 * np.cos(math.pi * TIME)),
    "strokes": (np.where(TIME % 2.0 < 1.0, 0.5, -0.5) * (1.0 + (TIME > 2.0)), np.zeros(TIME.size)),
    "sweep": (np.sin(TIME**2), 2.0 * TIME * np.cos(TIME**2)),
}


def friction(velocity, size):
    """What a loop with integral action leaves of friction: an error after each reversal that decays."""
    error, direction, value = np.zeros(velocity.size), 0.0, 0.0
    for k, speed in enumerate(velocity):
        if np.sign(speed) != direction:
            direction, value = np.sign(speed), 1.0
        value *= 0.93
        error[k] = size * (direction * value + 0.1 * direction)
    return error


def summed(error, velocity, acceleration):
    sums = DelaySums()
    for one, speed, change in zip(error, velocity, acceleration, strict=True):
        sums.add(float(one), float(speed * T), float(change))
    return sums


@pytest.mark.parametrize("motion", MOTIONS)
@given(st.floats(0.1, 3.9), st.sampled_from([-1.0, 1.0]), st.floats(0.0, 1e-4), st.integers(0, 9))
def test_a_delay_is_fitted_and_the_errors_without_it_are_those_of_friction(motion, size, sign, level, seed):
    velocity, acceleration = MOTIONS[motion]
    left = friction(velocity, level) + 1e-6 * np.random.default_rng(seed).normal(size=velocity.size)
    sums = summed(sign * size * velocity * T + left, velocity, acceleration)
    found = sums.delay(5.0)
    if found == 0.0:  # friction hides a small one
        assert size * T * np.abs(velocity).max() < 40.0 * level
        return
    assert found == pytest.approx(sign * size, abs=0.03 + 40.0 * level)
    assert sums.rms(sign * size) == pytest.approx(np.sqrt(np.mean(left**2)), rel=1e-6, abs=1e-9)
    assert sums.peak(sign * size) == pytest.approx(np.abs(left).max(), abs=0.02 * T * np.abs(velocity).max())


@pytest.mark.parametrize("motion", MOTIONS)
@given(st.floats(0.0, 1e-2), st.integers(0, 9))
def test_friction_and_noise_are_no_delay(motion, level, seed):
    velocity, acceleration = MOTIONS[motion]
    noise = 1e-4 * np.random.default_rng(seed).normal(size=velocity.size)
    assert summed(friction(velocity, level) + noise, velocity, acceleration).delay(2.5) == 0.0


def test_what_cannot_be_configured_or_looks_like_friction_is_not_said():
    velocity, acceleration = MOTIONS["sine"]
    assert summed(-1.0 * velocity * T, velocity, acceleration).delay(0.5) == 0.0
    assert summed(1.0 * velocity * T, velocity, acceleration).delay(9.5) == 0.0
    assert summed(0.0 * velocity, 0.0 * velocity, acceleration).delay(2.5) == 0.0
    one_speed = np.where(TIME % 2.0 < 1.0, 0.5, -0.5)
    assert summed(1.0 * one_speed * T, one_speed, 0.0 * one_speed).delay(2.5) == 0.0


def test_both_conditions_are_compared_without_the_delay():
    velocity, acceleration = (np.tile(each, 4) for each in MOTIONS["sine"])
    errors, own = FollowingErrors(T, 0.0, 2.0), friction(velocity, 2e-4)
    for k, (speed, change) in enumerate(zip(velocity, acceleration, strict=True)):
        condition = Condition.WITHOUT if k < 2000 else Condition.WITH
        left = float(own[k]) * (1.0 if k < 2000 else 0.25)
        errors.take(condition, left + 0.5 * float(speed) * T, 0, True, float(speed), float(change))
    delay = errors.delay(2.0)
    assert delay == pytest.approx(0.5, abs=0.02)
    raw = [errors.figures(each).rms for each in (Condition.WITHOUT, Condition.WITH)]
    without, compensated = (errors.figures(each, delay).rms for each in (Condition.WITHOUT, Condition.WITH))
    assert raw[0] / raw[1] < 1.1
    assert without / compensated == pytest.approx(4.0, rel=0.15)


@pytest.mark.parametrize("has_demand", [True, False])
def test_a_sidecar_without_a_demand_says_that_no_error_can_be_given(has_demand):
    disturb = heard(0 if not has_demand else 10**6, position_demand=math.nan)
    axis = test_follower.Run(test_follower.Machine(disturb=disturb), duration_s=0.6).axis
    assert axis.lacks_demand == (not has_demand)
    figures = AxisFigures("rad", None, None, True, 0, lacks_demand=axis.lacks_demand)
    hint = _hint(figures, test_follower.configuration().axes["x"])
    assert hint.startswith("no position demand in csp") == (not has_demand)
