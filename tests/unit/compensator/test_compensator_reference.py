"""Which velocity feeds the model: sources, reference velocity, gate, rest, lead, and changes between them."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import friction_hil as fh
from friction_hil.compensator import reference
from tests.compensators import (
    EVERY_SOURCE,
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
    swing,
)

every_source = pytest.mark.parametrize("source", EVERY_SOURCE)
every_model = pytest.mark.parametrize("name", MODELS)


def state_velocity(demand, speed, **given):
    """Velocity at which the model's state is driven, by its spring, with demand and true velocity held."""
    changes = {name: given.pop(name) for name in ("source", "position_resolution", "gain") if name in given}
    one = compensator(SPRING, torque_limit=1e5, **changes)
    torque, _ = feed(one, *even(speed), 1000, demand=None if demand is None else even(demand)[1], **given)
    return np.diff(torque)[-1] / 10.0 / PERIOD_S


@given(st.sampled_from([0.1, 0.3, 0.5, 0.77, 1.0]), st.sampled_from(["difference", "drive"]), st.floats(0.0, 5e-3))
@pytest.mark.parametrize("source", EVERY_SOURCE)
def test_on_an_accelerating_axis_that_follows_the_model_sees_the_velocity_of_the_time_when_it_acts(
    source, smoothing, velocity, lead_s
):
    """Whatever the filter's delay: v(t) = a t, so the torque must be that of a (t + lead)."""
    a = 30.0
    one = compensator(smoothing=smoothing, velocity=velocity, source=source)
    # the difference is that of half a cycle before, the drive's own velocity of now
    torque, _ = feed(one, lambda t: 0.5 * a * t * t, lambda t: a * t, 500, demand=lambda t: a * t, lead_s=lead_s)
    t = np.arange(500) * PERIOD_S
    np.testing.assert_allclose(torque[200:], 0.05 + 0.01 * a * (t[200:] + lead_s), rtol=1e-9)


@every_source
def test_without_a_demand_the_measured_velocity_is_taken(source):
    torque, _ = feed(compensator(source=source), *even(-2.0), 100)
    assert torque[-1] == pytest.approx(-0.05 - 0.02, rel=0.01)  # the direction by a smooth map


@pytest.mark.parametrize(
    ("source", "level", "state"), [("measured", 3.0, 3.0), ("demand", 1.0, 1.0), ("auto", 3.0, 1.0)]
)
def test_each_source_takes_the_deviation_from_the_demand_its_own_way(source, level, state):
    """The demand is 1, the axis goes at 3: a deviation far above all noise. auto splits."""
    stribeck = fh.models.create("stribeck", coulomb=0.05, static=0.09, stribeck_velocity=2.0, viscous=0.01)
    torque, _ = feed(compensator(stribeck, source=source), *even(3.0), 1000, demand=even(1.0)[1])
    expected = 0.05 + 0.04 * math.exp(-((level / 2.0) ** 2)) + 0.01 * level
    assert torque[-1] == pytest.approx(expected, rel=2e-3)
    assert state_velocity(1.0, 3.0, source=source) == pytest.approx(state, rel=1e-6)


def test_the_gate_lets_noise_pass_as_little_as_it_is_real():
    """A deviation of a tenth of the gate comes through by a hundredth."""
    stribeck = fh.models.create("stribeck", coulomb=0.05, static=0.05, stribeck_velocity=2.0, viscous=1.0)
    deviation = 0.1 * reference.GATE_STRIBECK_RATIO * 2.0
    torque, _ = feed(compensator(stribeck), *even(1.0 + deviation), 2000, demand=even(1.0)[1])
    assert torque[-1] - 0.05 - 1.0 == pytest.approx(0.01 * deviation, rel=0.05)


@pytest.mark.parametrize("demand", [0.5, -0.5])
@pytest.mark.parametrize("error", [0.01, -0.01])
@pytest.mark.parametrize(("source", "recovery"), [("auto", reference.RECOVERY), ("measured", 0.0), ("demand", 0.0)])
def test_the_reference_velocity_makes_up_for_the_following_error(demand, error, source, recovery):
    """Other sources do not."""
    position_demand = demand * np.arange(1000) * PERIOD_S + error
    seen = state_velocity(demand, demand, position_demand=position_demand, source=source)
    assert seen == pytest.approx(demand + recovery * error, rel=1e-6)


def test_of_an_error_of_one_count_half_is_real_at_most():
    position_demand = 0.5 * np.arange(1000) * PERIOD_S + 1e-3
    seen = state_velocity(0.5, 0.5, position_demand=position_demand, position_resolution=1e-3)
    assert abs(seen - 0.5) <= 0.5001 * reference.RECOVERY * 1e-3


@every_model
def test_at_rest_a_following_error_that_stays_winds_nothing_up(name):
    """The axis stays behind a demand that rests, and swings: no creep, for as long as it takes."""
    one = compensator(MODELS[name], position_resolution=resolution(20))
    demand = swing(0.05, 1.0)
    t = np.arange(1000) * PERIOD_S
    place = np.array([demand(x) for x in t])
    speed = np.gradient(place, PERIOD_S)
    known = {"velocity": speed, "velocity_demand": speed, "velocity_demand_ahead": speed}
    one.replay(columns(1000, position=place - 1e-3, position_demand=place, **known))
    t = np.arange(20_000) * PERIOD_S
    rest = {"position_demand": 0.0, "velocity_demand": 0.0, "velocity_demand_ahead": 0.0}
    behind = quantised(-1e-3 + 1e-5 * np.sin(40.0 * t), resolution(20))
    torque, _ = one.replay(columns(20_000, start=1000, position=behind, **rest))
    assert np.ptp(torque[1000:]) < 0.01 * MODELS[name].level  # what is left is viscous: the swing is real
    assert abs(torque[-1]) <= 1.01 * MODELS[name].level


@pytest.mark.parametrize("velocity", ["difference", "tracking"])
def test_the_level_stays_on_the_side_of_the_reference_velocity(velocity):
    """An axis that is pushed back gets no compensation that pushes along; naively fed, it does."""
    pushed = {"auto": 0.05, "demand": 0.05 + 0.01, "measured": -0.05 - 0.03}
    for source, expected in pushed.items():
        one = compensator(source=source, velocity=velocity)
        torque, _ = feed(one, *even(-3.0), 1000, demand=even(1.0)[1])
        assert torque[-1] == pytest.approx(expected, rel=2e-2)


@given(
    st.sampled_from(list(MODELS)), st.sampled_from([-1.0, 1.0]), st.lists(st.floats(-1.0, 1.0), min_size=1, max_size=20)
)
def test_with_a_demand_in_one_direction_no_deviation_turns_the_compensation(name, sign, deviations):
    one = compensator(MODELS[name], position_resolution=1e-5, gain=0.9)
    deviation = np.repeat(deviations, 20)
    cycles = deviation.size
    feed(one, *even(0.2 * sign), 100, demand=even(0.2 * sign)[1])  # a spring that is deflected this way
    position = 0.02 * sign + np.cumsum(0.2 * sign + deviation) * PERIOD_S
    known = {"velocity_demand": 0.2 * sign, "velocity_demand_ahead": 0.2 * sign}
    torque, _ = one.replay(columns(cycles, start=100, position=position, **known))
    assert (sign * torque >= 0.0).all()


def test_an_encoder_that_flickers_at_rest_hardly_moves_the_torque():
    flicker = np.random.default_rng(0).integers(0, 2, 2000) * 1e-3  # between two counts while the demand rests
    spread = {}
    for source in EVERY_SOURCE:
        one = compensator(position_resolution=1e-3, source=source)
        rest = {"position_demand": 0.0, "velocity_demand": 0.0, "velocity_demand_ahead": 0.0}
        torque, _ = one.replay(columns(2000, position=flicker, **rest))
        spread[source] = np.abs(torque[10:]).max()
    assert spread["demand"] == 0.0
    assert spread["auto"] < 0.1 * 0.05
    assert spread["measured"] > 0.3 * 0.05


@pytest.mark.parametrize("name", ["gms", "dahl", "lugre", "stribeck", "elasto_plastic"])
def test_a_coarse_encoder_does_not_make_the_compensation_chatter(name):
    """14 bits at 0.05 rad/s: a count every eighth cycle, which looks like 0.4 rad/s."""
    one = compensator(MODELS[name], position_resolution=resolution(14))
    t = np.arange(1500) * PERIOD_S
    known = {"velocity_demand": 0.05, "velocity_demand_ahead": 0.05, "position_demand": 0.05 * t}
    torque, _ = one.replay(columns(1500, position=quantised(0.05 * t, resolution(14)), **known))
    assert np.ptp(torque[500:]) < 0.1 * MODELS[name].level


@every_source
@pytest.mark.parametrize("lead_s", [0.0, 2e-3])
def test_position_dependent_friction_is_that_of_the_place_reached(source, lead_s):
    model = fh.models.create(
        "coulomb", coulomb=0.05, modifiers={"ripple": [{"order": 10, "cosine": 0.02, "sine": 0.01}]}
    )
    torque, _ = feed(compensator(model, source=source, lead_s=lead_s), *even(2.0), 500, demand=even(2.0)[1])
    place = 10.0 * 2.0 * (np.arange(500) * PERIOD_S + lead_s)
    np.testing.assert_allclose(torque[100:], (0.05 + 0.02 * np.cos(place) + 0.01 * np.sin(place))[100:], rtol=1e-6)


@pytest.mark.parametrize("lead_s", [0.0, 2e-3])
def test_load_dependent_friction_is_that_of_the_load_there(lead_s):
    model = fh.models.create("coulomb", coulomb=0.05, modifiers={"load": {"motoring": 0.2, "driven": 0.1}})
    one = compensator(model, lead_s=lead_s, gravity=(0.1, 0.5, 0.3))
    torque, _ = feed(one, *even(2.0), 1500, demand=even(2.0)[1])
    place = 2.0 * (np.arange(1500) * PERIOD_S + lead_s)
    load = 0.1 + 0.5 * np.sin(place) + 0.3 * np.cos(place)
    expected = [float(model.steady_state([2.0], load_torque=each)[0]) for each in load[100::50]]
    np.testing.assert_allclose(torque[100::50], expected, rtol=1e-6)
    assert np.ptp(expected) > 0.05


@given(st.sampled_from([0.3, 0.5, 1.0]), st.sampled_from(["difference", "drive"]), st.floats(0.0, 5e-3))
@pytest.mark.parametrize("source", EVERY_SOURCE)
def test_without_a_demand_the_model_sees_the_velocity_of_the_time_when_it_acts(source, smoothing, velocity, lead_s):
    """As with one: v(t) = a t, so the viscous torque must be that of a (t + lead)."""
    a = 30.0
    model = fh.models.create("coulomb", coulomb=1e-9, viscous=0.01)
    one = compensator(model, smoothing=smoothing, velocity=velocity, source=source, lead_s=lead_s)
    torque, _ = feed(one, lambda t: 0.5 * a * t * t, lambda t: a * t, 500)
    t = np.arange(500) * PERIOD_S
    np.testing.assert_allclose(torque[300:], 0.01 * a * (t[300:] + lead_s), atol=0.01 * a * 2e-5)


@every_model
@pytest.mark.parametrize("speed", [0.0, 0.05, 0.3])
def test_the_steps_of_a_coarse_encoder_are_no_acceleration(name, speed):
    """In even motion and at rest, 14 bits: what is led comes to the same as what is not."""
    torques = []
    for lead_s in (0.0, 2.5e-3):
        one = compensator(MODELS[name], position_resolution=resolution(14), lead_s=lead_s)
        place = quantised(speed * np.arange(2000) * PERIOD_S, resolution(14))
        place += resolution(14) * (np.random.default_rng(0).random(2000) < 0.1)  # flickers
        torques.append(one.replay(columns(2000, position=place, velocity=speed))[0])
    np.testing.assert_allclose(*torques, atol=1e-3 * MODELS[name].level)


@every_model
def test_feedback_that_is_lost_for_one_cycle_hardly_changes_the_compensation(name):
    """Behind a slow demand; it is lost in cycle 300 alone."""
    one, t = compensator(MODELS[name], position_resolution=resolution(20)), np.arange(400) * PERIOD_S
    known = {"velocity_demand": 0.005, "velocity_demand_ahead": 0.005, "position_demand": 0.005 * t}
    known |= {"position": 0.005 * t + 5e-4, "velocity": 0.005, "is_fresh": np.arange(400) != 300}
    torque, _ = one.replay(columns(400, **known))
    assert np.abs(np.diff(torque[295:306])).max() < 0.1 * MODELS[name].level


@every_model
@every_source
@pytest.mark.parametrize("speed", [0.0, 0.05, 0.5])
def test_a_demand_that_comes_and_goes_changes_the_compensation_by_no_more_than_the_level(name, source, speed):
    one = compensator(MODELS[name], position_resolution=resolution(20), source=source)
    moving = np.where(np.arange(2500) < 300, 0.1, speed)
    position = quantised(np.cumsum(moving) * PERIOD_S, resolution(20))
    known = np.where((np.arange(2500) // 500) % 2 == 0, moving, math.nan)
    given = {"velocity_demand": known, "velocity_demand_ahead": known, "position_demand": position + 0.0 * known}
    torque, _ = one.replay(columns(2500, position=position, velocity=moving, **given))
    for change in (500, 1000, 1500, 2000):
        around = torque[change - 2 : change + 200]
        assert np.abs(np.diff(around)).max() <= 1.02 * MODELS[name].level
        assert speed == 0.0 or (around >= 0.0).all()


@pytest.mark.parametrize("smoothing", [1.0, 0.1])
@every_source
def test_a_demand_that_comes_while_the_axis_follows_it_changes_nothing(source, smoothing):
    """The velocity does not change, so neither does the compensation: 0.05 + 0.05 v."""
    model = fh.models.create("coulomb", coulomb=0.05, viscous=0.05)
    one = compensator(model, source=source, smoothing=smoothing)
    cycle = np.arange(600)
    known = np.where((cycle < 200) | (cycle >= 400), math.nan, 2.0)
    given = {"velocity_demand": known, "velocity_demand_ahead": known, "position_demand": 2e-3 * cycle + 0.0 * known}
    torque, _ = one.replay(columns(600, position=2e-3 * cycle, velocity=2.0, **given))
    np.testing.assert_allclose(torque[150:], 0.15, rtol=2e-3)  # guided, its direction goes by a smooth map


@every_model
def test_a_deviation_that_changes_its_sign_makes_no_jump(name):
    one = compensator(MODELS[name], velocity="drive", position_resolution=resolution(20))
    t = np.arange(2000) * PERIOD_S
    velocity = 0.3 + 0.25 * np.sin(6.0 * t)
    known = {"velocity_demand": 0.3, "velocity_demand_ahead": 0.3}
    torque, _ = one.replay(columns(2000, position=np.cumsum(velocity) * PERIOD_S, velocity=velocity, **known))
    # dv/dt = 1.5 rad/s^2 on a curve of at most 1 N m s/rad, and the gate's opening
    assert np.abs(np.diff(torque[200:])).max() < 0.02 * MODELS[name].level


@pytest.mark.deep
@pytest.mark.parametrize("strength", [1.0, 1.2])
@pytest.mark.parametrize("bits", [14, 20])
@pytest.mark.parametrize("velocity_gain", [0.06, 0.2])
def test_at_rest_the_compensation_stays_and_does_not_hunt(strength, bits, velocity_gain):
    def demand(t):
        return 0.05 * (1.0 - math.cos(2.0 * math.pi * min(t, 0.75)))

    # beside the demand it stops by up to a count, from where the drive's integral takes seconds
    given = {"velocity_gain": velocity_gain, "resolution": resolution(bits)}
    one = compensator(LUGRE, gain=strength, position_resolution=resolution(bits), lead_s=1.5e-3)
    run = Axis(LUGRE, **given).run(one, 5.0, demand=demand).after(3.5)
    plain = Axis(LUGRE, **given).run(None, 5.0, demand=demand).after(3.5)
    assert np.ptp(run.compensation) < 0.02 * LUGRE.level
    assert np.ptp(run.position) <= np.ptp(plain.position) + 0.05 * resolution(bits) + 2e-6
    assert one.gain_factor == 1.0


@pytest.mark.parametrize("frequency", [60.0, 110.0, 150.0])
def test_a_swing_about_the_demand_is_predicted_until_the_torque_acts(frequency):
    """Velocity 1 + 0.1 sin: the viscous torque of `auto` is that of the time when it acts, `measured` is late."""
    viscous = fh.models.create("stribeck", coulomb=0.05, static=0.05, stribeck_velocity=0.1, viscous=1.0)
    lead_s, t = 1.8e-3, np.arange(1500) * PERIOD_S
    w = 2.0 * math.pi * frequency
    place = t + 0.1 * (1.0 - np.cos(w * t)) / w
    acting = 0.1 * np.sin(w * (t + lead_s))
    known = {"velocity_demand": 1.0, "velocity_demand_ahead": 1.0, "position_demand": t}
    miss = {}
    for source in ("auto", "measured"):
        one = compensator(viscous, source=source, lead_s=lead_s, position_resolution=1e-6)
        torque, _ = one.replay(columns(1500, position=place, **known))
        miss[source] = np.std((torque - 1.05 - acting)[500:]) / np.std(acting[500:])
    assert miss["auto"] < 0.15  # the outcome is interpolated between two cycles
    assert miss["measured"] > 0.7


@pytest.mark.parametrize("seed", [1, 2])
def test_noise_is_not_predicted(seed):
    """Of deviations without any memory, no more comes through than was measured."""
    viscous = fh.models.create("stribeck", coulomb=0.05, static=0.05, stribeck_velocity=0.1, viscous=1.0)
    t = np.arange(3000) * PERIOD_S
    deviation = np.random.default_rng(seed).normal(0.0, 0.05, t.size)
    known = {"velocity_demand": 1.0, "velocity_demand_ahead": 1.0, "position_demand": t}
    one = compensator(viscous, lead_s=1.8e-3, position_resolution=1e-6)
    torque, _ = one.replay(columns(t.size, position=t + np.cumsum(deviation) * PERIOD_S, **known))
    # the deviation advanced by half a cycle is 1.5 d - 0.5 d before
    assert np.std(torque[500:]) < 1.1 * math.hypot(1.5, 0.5) * 0.05
