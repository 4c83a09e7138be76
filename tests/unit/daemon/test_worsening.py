"""Compensation that makes the following error larger is taken back, and no other: judged alone, and in whole runs."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from friction_hil.daemon.figures import Condition
from friction_hil.daemon.worsening import WorseningJudge
from tests.loop_run import Run, axis
from tests.unit.daemon import test_follower

T, STEP_S = 1e-3, 4e-3
BASELINE_S, WHOLE_S = 2.0, 8.0


def judged(error, *, velocity=lambda time_s: 2.0 * math.cos(math.tau * time_s), motion_s=1.0, baseline_s=2.0, seed=1):
    """What the judge says of a motion; ``error`` gets the time, the direction, the condition and a random number."""
    judge, noise = WorseningJudge(STEP_S, motion_s, 1e-6), np.random.default_rng(seed).normal(size=2000)
    for k in range(round(WHOLE_S / STEP_S)):
        time_s = k * STEP_S
        speed, change = velocity(time_s), -2.0 * math.tau * math.sin(math.tau * time_s)
        condition = Condition.WITHOUT if time_s < baseline_s else Condition.WITH
        found = judge.take(condition, speed, change, error(time_s, math.copysign(1.0, speed), condition, noise[k]))
        if found is not None:
            return time_s, found
    return None


def friction(compensated, noise=1e-5):
    """An error of 1e-4 without compensation, and ``compensated`` times that with it."""

    def error(time_s, sign, condition, random):
        return sign * 1e-4 * (1.0 if condition is Condition.WITHOUT else compensated) + noise * random

    return error


@pytest.mark.parametrize("compensated", [1.5, 2.0, -2.0, 5.0])
def test_an_error_that_is_larger_at_the_same_velocities_is_found_after_two_windows(compensated):
    """Also with the other sign: a model with far too much friction."""
    time_s, found = judged(friction(compensated))
    assert time_s == pytest.approx(BASELINE_S + 2.0, abs=0.05)
    assert found.compensated / found.without == pytest.approx(abs(compensated), rel=0.05)


@given(st.floats(-1.05, 1.05), st.floats(0.0, 5e-4), st.integers(0, 99))
@settings(max_examples=25)
def test_compensation_that_helps_or_does_nothing_is_left_whatever_the_noise(compensated, noise, seed):
    assert judged(friction(compensated, noise), seed=seed) is None


@given(st.sampled_from(["push", "shocks", "noise", "vibration"]), st.integers(0, 99), st.floats(2.0, 20.0))
@settings(max_examples=25)
def test_what_disturbs_the_axis_later_is_not_taken_for_the_compensation(kind, seed, size):
    rng = np.random.default_rng(seed)
    shocks = rng.uniform(BASELINE_S, WHOLE_S, 6)
    hz, phase = rng.integers(5, 40) + rng.uniform(0.2, 0.8), rng.uniform(0.0, 6.0)  # else it is part of the motion

    def error(time_s, sign, condition, random):
        value = friction(0.5)(time_s, sign, condition, random)
        if condition is Condition.WITHOUT:
            return value
        if kind == "push":
            return value + size * 1e-4
        if kind == "noise":
            return value + size * 1e-4 * random
        if kind == "vibration":
            return value + size * 1e-4 * math.sin(math.tau * hz * time_s + phase)
        return value + (size * 1e-4 if np.any((shocks <= time_s) & (time_s < shocks + 0.02)) else 0.0)

    assert judged(error, seed=seed) is None


@pytest.mark.parametrize("factor", [0.2, 0.6, 1.7, 3.0])
def test_a_motion_that_changes_is_not_compared(factor):
    """An error in proportion to the speed: a faster motion has more of it, with whatever compensation."""

    def velocity(time_s):
        return 2.0 * math.cos(math.tau * time_s) * (1.0 if time_s < BASELINE_S else factor)

    def error(time_s, sign, condition, random):
        return 1e-4 * velocity(time_s) + sign * 3e-5 * (1.0 if condition is Condition.WITHOUT else 0.4)

    assert judged(error, velocity=velocity, motion_s=math.inf) is None


@pytest.mark.parametrize("baseline_s", [0.0, 0.2])
def test_without_a_baseline_nothing_is_claimed(baseline_s):
    assert judged(friction(3.0), baseline_s=baseline_s) is None


COMPENSATION = {"fade_s": 0.1, "baseline_s": 2.0}


def reversed_drive(drives):
    for command in drives.pending:
        if command is not None:
            command.torque = -command.torque


@pytest.mark.parametrize("is_reversed", [True, False])
def test_a_run_takes_a_torque_of_the_wrong_sign_back_and_goes_on(is_reversed):
    given, before = axis(compensation=COMPENSATION), reversed_drive if is_reversed else None
    run = Run(given, before=before, duration_s=5.5)
    assert bool(run.axes[0].following.taken_back) == is_reversed
    assert run.events("warning") == run.result.warnings == [run.axes[0].following.taken_back] * is_reversed
    compensation, enabled = run.columns("compensation", "is_enabled")
    assert np.abs(compensation[round(4.0 / T)]) > 0.03
    if is_reversed:
        assert "inverted_torque" in run.axes[0].following.taken_back
        assert np.all(compensation[-300:] == 0.0)
        assert not enabled[-300:].any()
    else:
        assert np.all(enabled[round(2.5 / T) : round(5.0 / T)])


def test_a_sidecar_takes_it_back_too():
    machine = test_follower.Machine()
    send = machine.send

    def sent_reversed(commands):
        send(commands)
        machine.servos[0].torque_offset = -machine.offset

    machine.send = sent_reversed
    config = test_follower.configuration(compensation={"fade_s": 0.1, "baseline_s": 2.0})
    run = test_follower.Run(machine, config=config, duration_s=6.0)
    assert run.result.faults == []
    assert run.warnings == [run.axis.following.taken_back]
    assert run.largest(3000, 4000) > 0.03
    assert run.sent[-300:] == [0.0] * 300
