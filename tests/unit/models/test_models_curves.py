"""The modifiers over the distance since the last reversal and over the speed, against their definition."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

import friction_hil as fh

DT = 1e-3
REVERSAL = {"distance": [1e-4, 5e-4, 2e-3], "positive": [0.03, -0.01, 0.02], "negative": [0.01, 0.04, 0.0]}
SPEED = {"velocity": [0.1, 0.5], "positive": [0.02, -0.03], "negative": [-0.01, 0.01]}
velocities = arrays(float, st.integers(1, 60), elements=st.floats(-1.0, 1.0).map(lambda v: 0.0 if abs(v) < 0.1 else v))


def alone(**modifiers):
    """The torque of modifiers without any other friction."""
    model = fh.models.create("coulomb", coulomb=0.0, modifiers=modifiers)
    return lambda velocity: model.simulate(velocity, DT)


def on_curve(x, abscissa, torques):
    return float(np.interp(x, [0.0, *abscissa], [0.0, *torques]))


@given(velocities)
def test_the_torque_is_that_of_the_distance_since_the_last_reversal(velocity):
    """Once the distance of the first point is behind, nothing is left of what was before the reversal."""
    sign, distance = 0.0, 0.0
    for v, torque in zip(velocity, alone(reversal=REVERSAL)(velocity), strict=True):
        if v != 0.0:
            distance = (distance if np.sign(v) == sign else 0.0) + abs(v) * DT
            sign = np.sign(v)
        side = REVERSAL["positive" if sign > 0.0 else "negative"]
        if distance >= REVERSAL["distance"][0] * (1.0 + 1e-9):
            assert torque == pytest.approx(sign * on_curve(distance, REVERSAL["distance"], side), abs=1e-12)


@given(velocities)
def test_no_reversal_makes_the_torque_jump_and_it_is_bounded(velocity):
    fine = np.repeat(0.01 * velocity, 10)  # steps of at most 1e-5
    torque = alone(reversal=REVERSAL)(fine)
    most = max(map(abs, [*REVERSAL["positive"], *REVERSAL["negative"]]))
    assert np.max(np.abs(torque)) <= most * (1.0 + 1e-12)
    steepest = 2.0 * most / REVERSAL["distance"][0]
    assert np.all(np.abs(np.diff(torque, prepend=0.0)) <= steepest * np.abs(fine) * DT + 1e-15)
    assert np.all(np.diff(torque, prepend=0.0)[fine == 0.0] == 0.0)  # at rest nothing changes


@given(arrays(float, 20, elements=st.floats(-1.0, 1.0)))
def test_the_torque_over_the_speed_is_interpolated(velocity):
    expected = [
        np.sign(v) * on_curve(abs(v), SPEED["velocity"], SPEED["positive" if v > 0.0 else "negative"]) for v in velocity
    ]
    np.testing.assert_allclose(alone(speed=SPEED)(velocity), expected, atol=1e-15)


def test_the_steady_curve_has_the_speed_and_what_is_left_long_after_a_reversal():
    model = fh.models.create("coulomb", coulomb=0.0, modifiers={"reversal": REVERSAL, "speed": SPEED})
    np.testing.assert_allclose(model.steady_state([-0.5, 0.0, 0.5]), [-0.01, 0.0, -0.03 + 0.02], atol=1e-15)


def test_a_small_loop_gives_no_energy():
    """Within the distance of the first point the torque is a spring: to and fro, nothing is won."""
    velocity = np.tile(np.repeat([0.02, -0.02], 4), 200)
    below = {"positive": [-0.03, 0.0, 0.0], "negative": [-0.03, 0.0, 0.0]}
    torque = alone(reversal=REVERSAL | below)(velocity)
    work = np.cumsum((torque + np.append(0.0, torque[:-1])) * 0.5 * velocity * DT)
    assert np.max(np.abs(np.diff(work[7::8])[-20:])) < 1e-9 * 0.03 * 8e-5
    assert np.ptp(torque[-8:]) > 0.01
