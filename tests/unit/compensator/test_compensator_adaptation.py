"""Adaptation: off, exact, per direction, bounded, frozen, undisturbed by load and acceleration."""

import math
import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import friction_hil as fh
from friction_hil.daemon.notices import adaptation_notice
from tests.compensators import (
    EVERY_VELOCITY,
    LUGRE,
    MODELS,
    PERIOD_S,
    VISCOUS,
    Axis,
    columns,
    compensator,
    even,
    feed,
    field,
    replayed,
    resolution,
    swing,
    wild_inputs,
)

LEARNING = {"adaptation_s": 0.3, "adaptation_bound": 0.3}


def factors(one):
    """What is learned, of positive and of negative torque."""
    return np.array(field(one, "adaptation.factor"))


def uneven(model, positive, negative):
    """The model with all its torques times a factor in each direction."""
    torques = [name for name in ("coulomb", "static", "sigma2") if name in model.parameters]
    sides = {
        side: {name: factor * model.parameters[name] for name in torques}
        for side, factor in (("positive", positive), ("negative", negative))
    }
    return fh.models.create(model.name, **model.parameters, modifiers={"direction": sides})


def slide(one, factor, seconds, *, speed=1.0, start=0, **given):
    """Feed an even motion with a torque of ``factor`` times the model's friction; return the next cycle."""
    friction = factor * float(one.model.steady_state([speed])[0])
    cycles = round(seconds / PERIOD_S)
    known = {"position_demand": speed * (start + np.arange(cycles)) * PERIOD_S, "torque": friction}
    feed(one, *even(speed), cycles, demand=even(speed)[1], start=start, **known | given)
    return start + cycles


def test_it_is_off_by_default_and_then_the_torque_counts_for_nothing():
    one, other = compensator(LUGRE), compensator(LUGRE)
    slide(one, 1.0, 1.0)
    slide(other, 1.3, 1.0)
    assert factors(other).tolist() == [1.0, 1.0]
    assert field(one, "compensation") == field(other, "compensation")
    assert adaptation_notice("x", "rad", other) is None


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("speed", [1.0, -1.0])
def test_the_factor_of_the_direction_of_motion_becomes_that_of_the_torque(name, speed):
    one = compensator(MODELS[name], **LEARNING)
    start = slide(one, 1.2, 4.0, speed=speed)
    k = 0 if speed > 0.0 else 1
    assert factors(one)[k] == pytest.approx(1.2, rel=5e-3)
    assert factors(one)[1 - k] == 1.0
    # and the compensation is the torque that was seen
    assert field(one, "compensation") == pytest.approx(1.2 * float(MODELS[name].steady_state([speed])[0]), rel=1e-2)
    slide(one, 0.9, 4.0, speed=speed, start=start)
    assert factors(one)[k] == pytest.approx(0.9, rel=5e-3)


def test_it_learns_over_the_time_given():
    """From the weight of one forgetting time on: a share of 1/e is left after that time."""
    one = compensator(VISCOUS, adaptation_s=2.0, adaptation_bound=0.5)
    slide(one, 1.2, 2.1)  # a tenth of a second until it begins
    model, level = 0.05 + 0.01, 0.05
    left = math.exp(-1.0)
    expected = 1.0 + 0.2 * (1.0 - left) * model**2 / (left * level**2 + (1.0 - left) * model**2)
    assert factors(one)[0] == pytest.approx(expected, rel=2e-3)


@pytest.mark.parametrize("velocity", EVERY_VELOCITY)
@pytest.mark.parametrize("bits", [14, 20])
def test_on_a_moving_axis_it_finds_the_friction_of_each_direction(velocity, bits):
    """With known inertia and load, of an axis that accelerates all the time."""
    step = resolution(bits)
    load = {"gravity": (0.03, 0.0, 0.0)}
    one = compensator(LUGRE, gain=0.9, velocity=velocity, position_resolution=step, lead_s=1.5e-3, **LEARNING, **load)
    axis = Axis(uneven(LUGRE, 1.2, 0.9), velocity_gain=0.2, resolution=step, load=0.03)
    axis.run(one, 3.0, demand=swing(0.5, 1.0))
    np.testing.assert_allclose(factors(one), [1.2, 0.9], rtol=0.03)
    assert one.gain_factor == 1.0


def test_inertia_counts():
    """Acceleration takes more torque than friction here, and would be taken for it."""
    t = np.arange(6000) * PERIOD_S
    speed, acceleration = 3.0 + 2.0 * np.sin(5.0 * t), 10.0 * np.cos(5.0 * t)
    place = 3.0 * t - 0.4 * np.cos(5.0 * t)
    inertia = 0.01
    friction = 1.2 * VISCOUS.steady_state(speed)
    known = {"position_demand": place, "velocity_demand": speed, "velocity_demand_ahead": speed, "velocity": speed}
    learned = {}
    for believed in (inertia, 1.5 * inertia):
        one = compensator(VISCOUS, velocity="drive", inertia=believed, adaptation_s=0.3, adaptation_bound=0.5)
        torque = friction + inertia * acceleration
        seen = []
        for begin in range(0, 6000, 100):
            part = slice(begin, begin + 100)
            given = {name: column[part] for name, column in known.items()}
            one.replay(columns(100, start=begin, position=place[part], torque=torque[part], **given))
            seen.append(factors(one)[0])
        learned[believed] = np.array(seen[20:])
    np.testing.assert_allclose(learned[inertia], 1.2, rtol=0.01)
    assert np.ptp(learned[1.5 * inertia]) > 0.1


@pytest.mark.parametrize(("factor", "expected"), [(5.0, 1.3), (0.0, 0.7), (-3.0, 0.7), (1.29, 1.29)])
def test_it_stays_between_its_bounds(factor, expected):
    one = compensator(VISCOUS, **LEARNING)
    slide(one, factor, 4.0)
    assert factors(one)[0] == pytest.approx(expected, rel=1e-3)
    assert 0.7 <= factors(one)[0] <= 1.3


@given(wild_inputs(), st.sampled_from([LUGRE, VISCOUS]))
def test_no_input_takes_it_beyond_its_bounds(rows, model):
    one = compensator(model, adaptation_s=0.1, adaptation_bound=0.3)
    for each in rows:
        replayed(one, [each])
        assert (np.abs(factors(one) - 1.0) <= 0.3 + 1e-12).all()


@pytest.mark.parametrize("speed", [0.03, -0.1])
def test_it_learns_below_the_stribeck_velocity(speed):
    """There the friction is the model's level at that velocity, too."""
    assert abs(speed) < LUGRE.parameters["stribeck_velocity"]
    one = compensator(LUGRE, position_resolution=resolution(20), **LEARNING)
    slide(one, 1.2, 4.0, speed=speed)
    assert factors(one)[0 if speed > 0.0 else 1] == pytest.approx(1.2, rel=5e-3)
    assert 3.5 < one.learned_s < 4.0


@pytest.mark.parametrize("amplitude", [0.02, 0.2])
def test_on_a_slow_swing_it_finds_the_friction_of_each_direction(amplitude):
    one = compensator(LUGRE, gain=0.9, position_resolution=resolution(20), lead_s=1.5e-3, **LEARNING)
    axis = Axis(uneven(LUGRE, 1.2, 0.9), velocity_gain=0.2, resolution=resolution(20))
    axis.run(one, 6.0, demand=swing(amplitude, 0.25))
    np.testing.assert_allclose(factors(one), [1.2, 0.9], rtol=0.05)


def learned_from(motion, **given):
    """Factors before and after a motion (position and velocity over time) with a torque that is far off."""
    one = compensator(LUGRE, position_resolution=1e-5, **LEARNING)
    start = slide(one, 1.1, 1.0)
    kept = factors(one)
    position, velocity = motion(np.arange(3000) * PERIOD_S)
    position = position + (start - 1) * PERIOD_S  # from where it was last
    course = {"velocity_demand": velocity, "velocity_demand_ahead": velocity, "torque": 0.5}
    one.replay(columns(3000, start=start, position=position, velocity=velocity, **course | given))
    return kept, factors(one)


ALONG = lambda t: (t, 1.0 + 0.0 * t)  # noqa: E731


@pytest.mark.parametrize(
    ("motion", "missing"),
    [
        pytest.param(lambda t: (0.0 * t, 0.0 * t), {}, id="rest"),
        pytest.param(lambda t: (2e-5 * np.sin(3.0 * t), 6e-5 * np.cos(3.0 * t)), {}, id="presliding"),
        pytest.param(lambda t: (0.01 * np.sin(40.0 * t), 0.4 * np.cos(40.0 * t)), {}, id="reversals"),
        pytest.param(ALONG, {"torque": math.nan}, id="unknown torque"),
        pytest.param(ALONG, {"torque": math.inf}, id="infinite torque"),
        pytest.param(ALONG, {"is_fresh": 0.0}, id="no feedback"),
    ],
)
def test_it_is_frozen_without_steady_sliding_and_what_it_needs(motion, missing):
    before, after = learned_from(motion, **missing)
    np.testing.assert_array_equal(before, after)
    assert before[0] > 1.05


@pytest.mark.parametrize(("missed", "speed"), [(100, 1.0), (0, -1.0)])
def test_after_a_gap_or_a_reversal_it_waits_until_its_filters_have_settled(missed, speed):
    one = compensator(LUGRE, **LEARNING)
    start = slide(one, 1.1, 1.0)
    kept = factors(one)
    slide(one, 9.0, 0.09, speed=speed, start=start + missed)
    np.testing.assert_array_equal(factors(one), kept)


@pytest.mark.parametrize("speed", [0.1, 1.0])
def test_a_run_says_that_nothing_was_learned_and_from_which_velocity_on_it_is(speed):
    """14 bits at 1 kHz: a velocity of 0.1 rad/s is within the noise."""
    one = compensator(LUGRE, position_resolution=resolution(14), **LEARNING)
    slide(one, 1.2, 2.0, speed=speed)
    notice = adaptation_notice("x", "rad", one)
    assert (notice is None) == (speed > one.slowest_learning)
    assert notice is None or re.match(r"x: compensation.adaptation .* 0.63 rad/s", notice)


def test_the_reported_torque_is_divided_by_its_ratio_to_that_of_the_model():
    one, other = compensator(VISCOUS, **LEARNING, torque_ratio=0.8), compensator(VISCOUS, **LEARNING)
    slide(one, 0.8 * 1.1, 2.0)
    slide(other, 1.1, 2.0)
    assert factors(one) == pytest.approx(factors(other))
