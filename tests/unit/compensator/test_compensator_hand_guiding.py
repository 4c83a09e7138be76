"""Hand guiding, where no demand says what is intended: felt friction, waking, resting, letting go."""

import math

import numpy as np
import pytest

import friction_hil as fh
from friction_hil.compensator import STATE, reference
from friction_hil.compensator.kernel import RESTING_S, WAKING_S
from tests.compensators import (
    INERTIA,
    LUGRE,
    MODELS,
    PERIOD_S,
    SPRING,
    Axis,
    columns,
    compensator,
    even,
    feed,
    quantised,
    resolution,
)

SPEEDS = (0.01, 0.03, 0.1, 0.3)


def felt_share(name, bits, speed, *, is_even, gain=0.9):
    """Share of the work against friction that is left to the hand, of an imposed motion to and fro.

    At even speed with turns of 20 ms, or as a sine; the compensation acts a cycle after the position was taken.
    """
    amplitude, fine = 0.1, 8
    period = 4.0 * amplitude / speed if is_even else 2.0 * math.pi * amplitude / speed
    cycles = round(period / PERIOD_S)
    t = np.arange(2 * cycles * fine) * PERIOD_S / fine
    velocity = speed * np.sin(2.0 * math.pi * t / period)
    if is_even:
        velocity = np.clip(velocity * period / (2.0 * math.pi * 0.02), -speed, speed)
    position = 6e-4 + np.cumsum(velocity) * PERIOD_S / fine
    friction = MODELS[name].simulate(velocity, PERIOD_S / fine)
    step = resolution(bits)
    one = compensator(MODELS[name], position_resolution=step, gain=gain)
    sampled = {"position": quantised(position[::fine], step), "velocity": velocity[::fine]}
    torque, _ = one.replay(columns(2 * cycles, **sampled))
    acting = np.concatenate([[0.0], torque[:-1]]).repeat(fine)
    settled = slice(cycles * fine, None)
    without = np.sum((friction * velocity)[settled])
    return float(np.sum(((friction - acting) * velocity)[settled]) / without)


@pytest.mark.deep
@pytest.mark.parametrize("is_even", [True, False])
@pytest.mark.parametrize("speed", SPEEDS)
@pytest.mark.parametrize("bits", [14, 20])
@pytest.mark.parametrize("name", list(MODELS))
def test_felt_friction_is_at_least_80_percent_lower(name, bits, speed, is_even):
    assert abs(felt_share(name, bits, speed, is_even=is_even)) < 0.2


@pytest.mark.parametrize("name", list(MODELS))
def test_a_hand_never_feels_more_than_without(name):
    for speed in SPEEDS:
        assert felt_share(name, 14, speed, is_even=True) < 1.0


@pytest.mark.parametrize(
    ("source", "share"), [("auto", reference.STIFFNESS_FRACTION), ("demand", 0.25), ("measured", 1.0)]
)
def test_most_of_the_presliding_spring_is_left_to_the_axis(source, share):
    """Told to be awake: this spring never comes to slide, and would not wake it."""
    one = compensator(SPRING, source=source, torque_limit=1e5)
    feed(one, *even(0.2), 100, demand=even(0.2)[1])
    one.state.view(STATE)[0]["resting_s"] = 0.0
    torque, _ = feed(one, *even(0.2), 100, start=100)
    assert np.diff(torque)[-1] == pytest.approx(share * 10.0 * 0.2 * PERIOD_S, rel=1e-6)


def left_of_a_fast_motion(name, period_s, *, is_led=True):
    """RMS of the friction less what compensates it, over that of the friction: 5 Hz, acting two cycles late."""
    fine, cycles, rate = round(8 * period_s / PERIOD_S), round(1.6 / period_s), 2.0 * math.pi * 5.0
    t = np.arange(cycles * fine) * period_s / fine
    velocity = 0.1 * rate * np.sin(rate * t)
    position = np.cumsum(velocity) * period_s / fine
    friction = MODELS[name].simulate(velocity, period_s / fine)
    given = {"period_s": period_s, "position_resolution": resolution(20), "lead_s": 2.5 * period_s, "gain": 0.9}
    one = compensator(MODELS[name], **given)
    if not is_led:
        one.record[0]["ahead_noise_square"] = math.inf
    torque, _ = one.replay(columns(cycles, position=quantised(position[::fine], resolution(20)), velocity=0.0))
    acting = np.concatenate([[0.0, 0.0], torque[:-2]]).repeat(fine)
    settled = slice(cycles * fine // 2, None)
    return float(np.sqrt(np.mean((friction - acting)[settled] ** 2) / np.mean(friction[settled] ** 2)))


@pytest.mark.parametrize(("period_s", "most"), [(1e-3, 0.3), (4e-3, 0.5)])
@pytest.mark.parametrize("name", list(MODELS))
def test_at_fast_reversals_the_lead_takes_away_most_of_what_the_delay_leaves(name, period_s, most):
    left = left_of_a_fast_motion(name, period_s)
    assert left < most
    assert left < 0.75 * left_of_a_fast_motion(name, period_s, is_led=False)


def effort(name, bits, frequency_hz, amplitude, *, is_led=True, **given):
    """RMS torque of a hand that leads the axis to and fro, N m, and the gain factor in the end."""
    stiffness, rate = 20.0, 2.0 * math.pi * frequency_hz
    damping = 1.4 * math.sqrt(stiffness * INERTIA)
    torques = []

    def hand(t, position, velocity):
        place, speed = amplitude * (1.0 - math.cos(rate * t)), amplitude * rate * math.sin(rate * t)
        torques.append(stiffness * (place - position) + damping * (speed - velocity))
        return torques[-1]

    usual = {"gain": 0.9, "position_resolution": resolution(bits), "lead_s": 1.8e-3, "torque_limit": 1.0}
    one = compensator(MODELS[name], **usual | given)
    if not is_led:
        one.record[0]["ahead_noise_square"] = math.inf
    Axis(MODELS[name], resolution=resolution(bits)).run(one, 1.5, hand=hand)
    return float(np.sqrt(np.mean(np.square(torques[len(torques) // 3 :])))), one.gain_factor


@pytest.mark.parametrize("name", ["lugre", "stribeck", "gms", "dahl"])
def test_a_hand_has_less_to_do_by_the_lead_and_the_axis_does_not_swing(name):
    led, gain_factor = effort(name, 20, 5.0, 0.1)
    assert gain_factor == 1.0
    assert led < 0.8 * effort(name, 20, 5.0, 0.1, is_led=False)[0]


@pytest.mark.parametrize(("bits", "frequency_hz", "amplitude"), [(14, 2.0, 0.05), (14, 5.0, 0.1), (20, 2.0, 0.05)])
@pytest.mark.parametrize("name", ["lugre", "stribeck", "gms", "dahl"])
def test_the_lead_is_never_worse(name, bits, frequency_hz, amplitude):
    led, gain_factor = effort(name, bits, frequency_hz, amplitude)
    without, gain_factor_without = effort(name, bits, frequency_hz, amplitude, is_led=False)
    assert gain_factor >= gain_factor_without
    assert led < 1.02 * without


@pytest.mark.parametrize("name", ["lugre", "stribeck", "gms", "dahl"])
def test_the_observer_does_not_take_its_own_compensation_for_the_hand(name):
    torque, gain_factor = effort(name, 20, 5.0, 0.1, velocity="kalman")
    assert gain_factor == 1.0
    assert torque < 0.6 * effort(name, 20, 5.0, 0.1, gain=0.0)[0]


def stopped(source="auto", cycles=2000):
    """Compensation of an axis that is moved at 0.1 rad/s, and stopped after half a second."""
    moving = np.where(np.arange(cycles) < 500, 0.1, 0.0)
    one = compensator(LUGRE, position_resolution=resolution(20), source=source)
    place = quantised(np.cumsum(moving) * PERIOD_S, resolution(20))
    return one.replay(columns(cycles, position=place, velocity=moving))[0]


def test_the_compensation_goes_when_the_axis_rests():
    torque = stopped()
    rest = 500 + round(RESTING_S / PERIOD_S)
    held = torque[520]
    assert held > 0.9 * LUGRE.level
    np.testing.assert_allclose(torque[520 : rest - 5], held, rtol=1e-9)
    going = torque[rest : rest + round(RESTING_S / PERIOD_S) - 5]
    np.testing.assert_allclose(np.diff(going), -held * PERIOD_S / RESTING_S, rtol=1e-6)
    assert (torque[rest + round(RESTING_S / PERIOD_S) + 5 :] == 0.0).all()


def test_an_axis_that_is_fed_with_what_is_measured_does_not_rest():
    torque = stopped("measured")
    np.testing.assert_allclose(torque[520:], torque[520], rtol=1e-9)
    assert torque[-1] > 0.9 * LUGRE.level


def test_it_wakes_within_the_time_given_once_it_moves():
    one = compensator(LUGRE, position_resolution=resolution(20), fade_s=1e-3)
    moving = np.where(np.arange(1500) < 1000, 0.0, 0.5)
    place = quantised(np.cumsum(moving) * PERIOD_S, resolution(20))
    torque, _ = one.replay(columns(1500, position=place, velocity=moving))
    assert (torque[:1000] == 0.0).all()
    settled = 1000 + round(WAKING_S / PERIOD_S) + 2
    np.testing.assert_allclose(torque[settled:], torque[-1], rtol=0.01)
    assert torque[1000 + 4] < 0.7 * torque[-1]


def test_the_noise_of_an_axis_at_rest_does_not_wake_it():
    flicker = np.random.default_rng(0).integers(-1, 2, 3000) * resolution(14)
    for model in MODELS.values():
        one = compensator(model, position_resolution=resolution(14))
        assert (one.replay(columns(3000, position=flicker))[0] == 0.0).all()


def let_go(name, bits, duration_s):
    """A hand leads the axis by a damped spring for two seconds, and lets go where it turns."""
    stiffness, rate = 2.0, math.pi
    damping = 1.4 * math.sqrt(stiffness * INERTIA)

    def hand(t, position, velocity):
        place, speed = 0.2 * (1.0 - math.cos(rate * t)), 0.2 * rate * math.sin(rate * t)
        return stiffness * (place - position) + damping * (speed - velocity) if t < 2.0 else 0.0

    one = compensator(MODELS[name], gain=0.9, position_resolution=resolution(bits), lead_s=1.5e-3, torque_limit=1.0)
    return one, Axis(MODELS[name], resolution=resolution(bits)).run(one, 2.0 + duration_s, hand=hand)


WRONG_REST = pytest.mark.xfail(
    strict=True, reason="without damping of the spring the axis swings on it, which counts as motion"
)
SWINGING = [pytest.param(name, 20, marks=WRONG_REST) for name in ("dahl", "gms")]


@pytest.mark.parametrize(
    ("name", "bits"),
    [*((name, bits) for name in ("lugre", "elasto_plastic", "stribeck") for bits in (14, 20)), ("gms", 14), *SWINGING],
)
def test_after_the_hand_lets_go_the_axis_rests_without_any_compensation(name, bits):
    one, run = let_go(name, bits, 2.0)
    rest = run.after(3.5)
    assert np.ptp(rest.position) < 3e-6
    assert (rest.compensation == 0.0).all()
    assert np.abs(run.after(2.1).position - run.after(2.1).position[0]).max() < 5e-3
    assert one.gain_factor == 1.0


def test_what_a_hand_did_before_a_demand_is_forgotten_after_it():
    """Guided at 5 rad/s, then led at 0.2 rad/s for 1.5 s: the viscous torque is that of 0.2 rad/s."""
    model = fh.models.create("stribeck", coulomb=1e-6, static=1e-6, stribeck_velocity=0.2, viscous=0.01)
    one = compensator(model, position_resolution=resolution(14))
    cycle = np.arange(2200)
    velocity = np.where(cycle < 600, 5.0, 0.2)
    place = np.cumsum(velocity) * PERIOD_S
    demand = np.where((cycle < 500) | (cycle >= 2100), math.nan, velocity)
    known = {"velocity_demand": demand, "velocity_demand_ahead": demand, "position_demand": place + 0.0 * demand}
    torque, _ = one.replay(columns(2200, position=quantised(place, resolution(14)), velocity=velocity, **known))
    assert np.abs(torque[2100:]).max() < 3.0 * 0.01 * 0.2
