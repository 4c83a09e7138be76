"""Whether an axis moves, and towards its set-point, at the beginning of its path."""

import math

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from friction_hil.daemon.follow_check import FollowCheck
from friction_hil.daemon.safety import SafetyLimits
from tests.messages import codes_in

PERIOD_S = 1e-3
COUNT = 2.0 * math.pi / 65536


def check(extent=0.5, *, is_torque_ours=True, **limits):
    limits = SafetyLimits(**{"torque": 0.3, "velocity": 30.0} | limits)
    return FollowCheck("x", "rad", limits, extent, PERIOD_S, COUNT, is_torque_ours=is_torque_ours)


def run(
    one, sign=1.0, load=0.0, friction=0.0, gain=0.6, damping=0.02, amplitude=0.5, seconds=2.0, push=0.0, moves=True
):
    """Run a mass under position control; ``sign`` is -1 for torque that acts the wrong way."""
    position = velocity = 0.0
    torques = [0.0, 0.0]
    for cycle in range(round(seconds / PERIOD_S)):
        time_s = cycle * PERIOD_S
        demand = amplitude * math.sin(2.0 * math.pi * 0.5 * time_s) ** 2
        torque = min(max(gain * (demand - position) - damping * velocity, -0.3), 0.3)
        if (fault := one.take(round(position / COUNT) * COUNT, velocity, demand, torque)) or one.is_confirmed:
            return fault
        torques.append(torque)
        force = sign * torques.pop(0) + load + (push if 0.1 < time_s < 0.2 else 0.0)
        for _ in range(10 if moves else 0):
            most = friction if velocity else min(friction, abs(force))
            change = (force - math.copysign(most, velocity or force)) / 2e-4 * PERIOD_S / 10
            is_caught = velocity and (velocity + change) * velocity < 0.0 and abs(force) < friction
            velocity = 0.0 if is_caught else velocity + change
            position += velocity * PERIOD_S / 10
    return None


@settings(max_examples=60, deadline=None)
@given(
    load=st.floats(-0.15, 0.15), friction=st.floats(0.0, 0.1), gain=st.floats(0.8, 2.0), damping=st.floats(0.005, 0.05)
)
@example(load=0.125, friction=0.09375, gain=2.0, damping=0.03125)  # rests beside its set-point, then follows it
def test_a_load_or_friction_is_no_fault(load, friction, gain, damping):
    assert run(check(), load=load, friction=friction, gain=gain, damping=damping) is None


@pytest.mark.parametrize("push", [-0.2, 0.2])
def test_an_axis_that_is_pushed_is_no_fault(push):
    assert run(check(), push=push) is None


@settings(max_examples=30, deadline=None)
@given(gain=st.floats(0.3, 2.0), damping=st.floats(0.005, 0.05), friction=st.floats(0.0, 0.02))
def test_torque_of_the_wrong_sign_is_told(gain, damping, friction):
    fault = run(check(), sign=-1.0, gain=gain, damping=damping, friction=friction)
    assert codes_in(fault) == "x FH-125"


@pytest.mark.parametrize("is_torque_ours", [True, False])
@pytest.mark.parametrize("following_error", [math.inf, 0.1])
def test_an_axis_that_does_not_move_is_told_before_its_following_error(is_torque_ours, following_error):
    one = check(is_torque_ours=is_torque_ours, following_error=following_error)
    assert codes_in(run(one, moves=False, seconds=3.0)) == "x FH-124"


def test_a_path_that_holds_is_no_fault():
    one = check(0.0)
    assert all(one.take(1e-3 * math.sin(k), 0.0, 0.0, 0.0) is None for k in np.arange(2000.0))


def test_the_check_ends_when_the_axis_follows():
    one = check()
    assert run(one) is None
    assert one.is_confirmed
