"""Limit cycles: seen where the axis swings by itself, answered for good, and not seen where it does not."""

import math

import numpy as np
import pytest

import friction_hil as fh
from friction_hil.compensator import limit_cycle
from tests.compensators import (
    EVERY_SOURCE,
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
    quantised,
    resolution,
    swing,
)


def scaled(model, factor):
    """The model with every torque times a factor."""
    torques = {name: factor * model.parameters[name] for name in ("coulomb", "static", "sigma0", "sigma1", "sigma2")}
    return fh.models.create(model.name, **model.parameters | torques)


def steps(run):
    """Return the times at which the gain was reduced, after checking each step."""
    assert run.gain_factor[0] == 1.0
    ratios = run.gain_factor[1:] / run.gain_factor[:-1]
    np.testing.assert_allclose(ratios[ratios != 1.0], limit_cycle.STEP)
    return run.t[1:][ratios != 1.0]


def on_a_spring(strength, stiffness, duration_s):
    """Run of an axis whose friction is over-estimated, moved by nothing but a push and a spring without damping."""
    one = compensator(scaled(LUGRE, strength), position_resolution=resolution(20), lead_s=1.5e-3, torque_limit=0.5)
    return Axis(LUGRE).run(one, duration_s, hand=lambda t, x, _: -stiffness * x + (0.3 if t < 0.02 else 0.0))


@pytest.mark.parametrize("strength", [1.2, 1.5, 2.0, 3.0])
@pytest.mark.parametrize("stiffness", [2.0, 5.0])
def test_an_axis_on_a_spring_that_swings_by_too_much_compensation_comes_to_rest(strength, stiffness):
    """Hand guiding, at 16 and 25 Hz; a slow swing, at 8 Hz, is seen within a second."""
    run = on_a_spring(strength, stiffness, 3.0)
    times = steps(run)
    assert times[0] < 0.5
    assert times.size >= math.log(strength) / -math.log(limit_cycle.STEP) - 1.0
    assert np.abs(run.after(2.8).velocity).max() < 0.02
    assert np.abs(run.velocity).max() > 5.0
    assert strength not in (1.2, 2.0) or steps(on_a_spring(strength, 0.5, 1.0)).size >= 1


@pytest.mark.parametrize("velocity_gain", [0.06, 0.2])
def test_too_much_compensation_of_what_is_measured_is_seen_under_a_resting_demand(velocity_gain):
    step = resolution(20)
    one = compensator(scaled(LUGRE, 1.5), source="measured", position_resolution=step, lead_s=1.5e-3)

    def demand(t):
        return 0.05 * (1.0 - math.cos(2.0 * math.pi * min(t, 0.5)))

    run = Axis(LUGRE, velocity_gain=velocity_gain, resolution=step).run(one, 2.5, demand=demand)
    assert steps(run).size >= 2
    assert steps(run)[0] < 1.5  # a second from where it stops


@pytest.mark.parametrize("frequency_hz", [8.0, 15.0, 40.0, 120.0])
@pytest.mark.parametrize("source", ["auto", "measured"])
@pytest.mark.parametrize("name", ["lugre", "stribeck", "dahl"])
def test_a_swing_without_a_demand_is_seen_within_a_second(frequency_hz, source, name):
    one = compensator(MODELS[name], position_resolution=resolution(20), source=source)
    t = np.arange(1000) * PERIOD_S
    rate = 2.0 * math.pi * frequency_hz
    position = quantised(1.0 / rate * np.sin(rate * t), resolution(20))
    one.replay(columns(1000, position=position, velocity=np.cos(rate * t)))
    assert one.gain_factor < 1.0


def test_the_gain_is_lower_and_stays_so():
    """Switched off and on, and after a gap."""
    one = compensator(VISCOUS)
    feed(one, lambda t: 0.1 * math.sin(100.0 * t), lambda t: 10.0 * math.cos(100.0 * t), 700)
    kept = one.gain_factor
    assert 0.0 < kept < 1.0
    for start, is_enabled in ((700, 0.0), (5700, 1.0), (10_800, 1.0)):
        torque, _ = feed(one, *even(1.0), 5000, demand=even(1.0)[1], start=start, is_enabled=is_enabled)
        assert one.gain_factor == kept
    assert torque[-1] == pytest.approx(kept * (0.05 + 0.01))


@pytest.mark.parametrize("bits", [14, 20])
@pytest.mark.parametrize("name", list(MODELS))
def test_a_hand_that_shakes_the_axis_is_none(name, bits):
    one = compensator(MODELS[name], position_resolution=resolution(bits), gain=0.9)
    t, rate = np.arange(6000) * PERIOD_S, 2.0 * math.pi * 4.0
    position = quantised(0.05 * np.sin(rate * t), resolution(bits))
    torque, _ = one.replay(columns(6000, position=position, velocity=0.05 * rate * np.cos(rate * t)))
    assert one.gain_factor == 1.0
    assert bits == 14 or np.ptp(torque) > MODELS[name].level  # it changed its sign all the time


@pytest.mark.parametrize("frequency_hz", [0.5, 2.0])
def test_pulses_of_a_coarse_encoder_where_a_hand_turns_are_none(frequency_hz):
    """A bristle's damping times the velocity of a count, 0.4 rad/s, is a third of the level."""
    model = fh.models.create("lugre", sigma0=400.0, sigma1=1.5, coulomb=0.45, static=0.6, stribeck_velocity=0.15)
    one = compensator(model, position_resolution=resolution(14), gain=0.9)
    t, rate = np.arange(4000) * PERIOD_S, 2.0 * math.pi * frequency_hz
    position = quantised(0.1 * np.sin(rate * t), resolution(14))
    torque, _ = one.replay(columns(4000, position=position))
    assert np.abs(np.diff(torque)).max() > 0.2 * model.level
    assert one.gain_factor == 1.0


@pytest.mark.parametrize("source", EVERY_SOURCE)
@pytest.mark.parametrize("frequency_hz", [1.0, 10.0, 30.0])
def test_a_demand_that_turns_is_none(source, frequency_hz):
    rate = 2.0 * math.pi * frequency_hz
    one = compensator(LUGRE, source=source)
    motion = (lambda t: math.sin(rate * t) / rate), (lambda t: math.cos(rate * t))
    place = [motion[0](k * PERIOD_S) for k in range(3000)]
    torque, _ = feed(one, *motion, 3000, demand=motion[1], position_demand=place)
    assert one.gain_factor == 1.0
    assert np.ptp(torque) > LUGRE.level


@pytest.mark.parametrize("name", ["lugre", "gms", "stribeck", "elasto_plastic", "dahl"])
@pytest.mark.parametrize(("velocity_gain", "speed", "bits"), [(0.03, 0.05, 20), (0.06, 0.05, 14), (0.06, 0.01, 20)])
def test_an_axis_that_sticks_and_slips_in_motion_is_none(name, velocity_gain, speed, bits):
    """The soft drive of an ordinary axis, slower than the Stribeck velocity, with the right model."""
    given = {"velocity_gain": velocity_gain, "resolution": resolution(bits)}
    one = compensator(MODELS[name], gain=0.9, position_resolution=resolution(bits), lead_s=1.5e-3)
    run = Axis(MODELS[name], **given).run(one, 1.5, demand=lambda t: speed * t)
    assert (run.gain_factor == 1.0).all()
    assert np.abs(run.error).max() < 8e-3


@pytest.mark.parametrize("velocity_gain", [0.06, 0.2])
@pytest.mark.parametrize("amplitude", [0.02, 0.2])
def test_an_ordinary_motion_with_the_right_model_is_none(velocity_gain, amplitude):
    one = compensator(LUGRE, gain=1.0, position_resolution=resolution(20), lead_s=1.5e-3)
    run = Axis(LUGRE, velocity_gain=velocity_gain).run(one, 2.0, demand=swing(amplitude, 1.0))
    assert (run.gain_factor == 1.0).all()


def test_a_swing_of_small_torque_is_none():
    """Of a twentieth of the level: no matter what causes it."""
    model = fh.models.create("lugre", sigma0=2000.0, coulomb=0.1, stribeck_velocity=0.1)
    one = compensator(model, source="measured")
    amplitude = 0.02 * 0.1 / 2000.0  # of a spring that is deflected by a fiftieth of the level
    t = np.arange(3000) * PERIOD_S
    one.replay(columns(3000, position=amplitude * np.sin(100.0 * t), is_fresh=1.0))
    assert one.gain_factor == 1.0
    assert field(one, "limit_cycle.alternations") == 0.0
