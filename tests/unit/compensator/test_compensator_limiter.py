"""The torque and slew limit, as the compensator and the command of the loop apply it."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from friction_hil.compensator.limiter import limit_torque
from tests.examples import THOROUGH

thorough = settings(max_examples=THOROUGH)

PERIOD_S = 1e-3
any_float = st.floats(allow_nan=True, allow_infinity=True)


@thorough
@given(st.floats(1e-6, 1e3), st.floats(1e-3, 1e6), st.lists(any_float, max_size=50))
def test_no_wish_breaks_torque_or_slew(limit, slew, wishes):
    before = 0.0
    for wish in wishes:
        torque = limit_torque(wish, before, limit, slew * PERIOD_S)
        assert abs(torque) <= limit
        assert abs(torque - before) <= slew * PERIOD_S * (1.0 + 1e-9) + 1e-15 * limit
        before = torque


@thorough
@given(st.floats(-1.0, 1.0))
def test_what_can_be_reached_is_reached(wish):
    torque = 0.0
    for _ in range(10):
        torque = limit_torque(wish, torque, 1.0, 0.1)
    assert torque == pytest.approx(wish)
    assert limit_torque(wish, 0.0, 1.0, math.inf) == wish


@pytest.mark.parametrize("wish", [math.nan, math.inf, -math.inf])
def test_what_is_not_finite_counts_as_zero(wish):
    assert limit_torque(wish, 0.05, 1.0, 0.1) == 0.0
