"""Reported velocity against the derivative of the position: what contradicts lasts, what a real drive does passes."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from friction_hil.daemon.velocity_check import VelocityCheck

PERIOD_S = 1e-3
COUNT = 1e-4  # rad
LIMIT = 30.0


def lasting_after(positions, velocities, *, usable=None, period_s=PERIOD_S, limit=LIMIT, **options):
    """Cycle in which the contradiction lasts, None for never."""
    check = VelocityCheck(period_s, limit, COUNT, **options)
    for cycle, (position, velocity) in enumerate(zip(positions, velocities, strict=True)):
        check.take(position, velocity, is_usable=usable is None or bool(usable[cycle]))
        if check.is_lasting:
            return cycle
    return None


def moved(velocity, period_s=PERIOD_S):
    """Position, quantised, of an axis that moves with ``velocity``."""
    return np.round(np.cumsum(velocity) * period_s / COUNT) * COUNT


def test_a_frozen_encoder_is_found_before_the_axis_is_fast():
    velocity = 500.0 * np.arange(200) * PERIOD_S  # 500 rad/s^2
    found = lasting_after(np.zeros(200), velocity)
    assert velocity[found] <= LIMIT


@pytest.mark.parametrize(
    ("factor", "most"), [(0.0, 60), (60.0 / (2.0 * math.pi), 199), (0.1, 199), (-1.0, 199), (2.0, 199)]
)
def test_a_frozen_velocity_a_wrong_unit_and_a_wrong_sign_are_found(factor, most):
    velocity = np.full(200, 10.0)
    assert lasting_after(moved(velocity), factor * velocity) <= most


@settings(max_examples=40, deadline=None)
@given(
    st.floats(0.05, 1.0),
    st.floats(0.5, 20.0),
    st.floats(0.0, 5e-3),
    st.integers(0, 2),
    st.floats(0.0, 0.1),
    st.floats(0.0, 0.2),
    st.integers(0, 2**31),
)
def test_filters_delays_quantisation_noise_and_loss_pass(part, frequency, filter_s, delay, step, lost, seed):
    """A sine up to the limit; the reported velocity is filtered, late, quantised (1 rpm is 0.1 rad/s) and noisy."""
    rng = np.random.default_rng(seed)
    time_s = np.arange(1500) * PERIOD_S
    true = part * LIMIT * np.sin(2.0 * np.pi * frequency * time_s)
    reported, value = np.empty_like(true), 0.0
    for cycle, velocity in enumerate(true):
        value += (velocity - value) * PERIOD_S / (filter_s + PERIOD_S)
        reported[cycle] = value
    reported = np.concatenate([np.zeros(delay), reported])[: true.size] + rng.normal(0.0, 0.01 * LIMIT, true.size)
    if step:
        reported = np.trunc(reported / step) * step
    assert lasting_after(moved(true), reported, usable=rng.random(true.size) >= lost) is None


def test_one_glitch_is_no_lasting_contradiction():
    velocity = np.full(400, 3.0)
    reported = velocity.copy()
    reported[200] = 1e4
    assert lasting_after(moved(velocity), reported) is None


def test_a_slow_loop_and_a_coarse_velocity_are_allowed_for():
    period_s, time_s = 0.02, np.arange(500) * 0.02
    true = 1.0 * np.sin(2.0 * np.pi * 0.5 * time_s)
    assert lasting_after(moved(true, period_s), true, period_s=period_s, limit=1.5) is None
    slow = np.full(500, 0.09)  # below 1 rpm
    assert lasting_after(moved(slow), np.zeros(500), limit=0.2, velocity_resolution=0.105) is None
    assert lasting_after(moved(slow), np.zeros(500), limit=0.2) is not None


def test_without_feedback_nothing_is_judged():
    velocity = np.full(400, 10.0)
    assert lasting_after(np.zeros(400), velocity, usable=np.arange(400) % 2 == 0) is None
    check = VelocityCheck(PERIOD_S, LIMIT, COUNT)
    for _ in range(100):
        assert check.take(math.nan, 1.0) is None
    assert check.last is None
