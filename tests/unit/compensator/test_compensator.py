"""The compensator: what no input may do, replay, fading, missed cycles, gains, settings and checksum."""

import math
import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import friction_hil as fh
from friction_hil.compensator import INPUTS, reference
from friction_hil.errors import UsageError
from friction_hil.recordings.columns import input_checksum
from tests import friction_models
from tests.compensators import (
    EVERY_SOURCE,
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
    opposite,
    quantised,
    replayed,
    resolution,
    row,
    swing,
    wild_inputs,
)

every_velocity = pytest.mark.parametrize("velocity", EVERY_VELOCITY)
every_source = pytest.mark.parametrize("source", EVERY_SOURCE)
every_model = pytest.mark.parametrize("name", MODELS)
ADAPTING = {"adaptation_s": 0.1, "adaptation_bound": 0.3}


def scattered(cycles=500, seed=0, **given):
    """A motion near a demand that comes and goes, with lost feedback and noise; the columns of its inputs."""
    random = np.random.default_rng(seed)
    t = np.arange(cycles) * PERIOD_S
    known = np.where(random.random(cycles // 50 + 1).repeat(50)[:cycles] < 0.8, 0.0, math.nan)
    position, velocity = 0.05 * (1.0 - np.cos(9.0 * t)), 0.45 * np.sin(9.0 * t)
    usual = {
        "position": quantised(position + 1e-4 * np.sin(70.0 * t), 1e-5),
        "velocity": velocity + 0.01 * random.standard_normal(cycles),
        "torque": 0.1 * np.sign(velocity) + 0.01 * random.standard_normal(cycles),
        "position_demand": position + known,
        "velocity_demand": velocity + known,
        "velocity_demand_ahead": 0.45 * np.sin(9.0 * (t + 1e-3)) + known,
        "is_fresh": random.random(cycles) < 0.95,
        "is_enabled": random.random(cycles // 100 + 1).repeat(100)[:cycles] < 0.8,
    }
    return columns(cycles, **usual | given)


@given(
    wild_inputs(),
    st.sampled_from([VISCOUS, LUGRE]),
    st.sampled_from(EVERY_SOURCE),
    st.sampled_from(EVERY_VELOCITY),
    st.sampled_from([{}, ADAPTING, {"dead_band": 0.1, "gain_negative": 0.3, "max_acceleration": 1e3}]),
)
def test_no_input_breaks_the_limits_of_torque_and_slew(rows, model, source, velocity, changes):
    one = compensator(model, torque_limit=0.3, torque_slew=20.0, source=source, velocity=velocity, **changes)
    before, cycle = 0.0, rows[0][0]
    for each in rows:
        passed, cycle = each[0] - cycle, each[0]
        (torque,) = replayed(one, [each])
        assert abs(torque) <= 0.3
        assert abs(torque - before) <= 20.0 * PERIOD_S * max(passed, 1) * (1.0 + 1e-9)
        assert math.isfinite(one.velocity_estimate)
        assert not one.is_faulty
        assert 0.0 < one.gain_factor <= 1.0
        before = torque


@given(wild_inputs(), st.sampled_from([VISCOUS, LUGRE]), st.sampled_from(EVERY_VELOCITY), st.booleans())
def test_opposite_inputs_give_exactly_the_opposite(rows, model, velocity, is_adapting):
    changes = {"velocity": velocity, **(ADAPTING if is_adapting else {})}
    forth, back = (compensator(model, torque_slew=50.0, **changes) for _ in range(2))
    for each in rows:
        assert replayed(forth, [each])[0] == -replayed(back, [opposite(each)])[0]


@given(wild_inputs(), st.integers(0, 59), st.sampled_from(EVERY_VELOCITY), st.sampled_from([{}, ADAPTING]))
def test_replay_is_step_for_step_the_same_bits_from_any_saved_state(rows, cut, velocity, changes):
    live = compensator(LUGRE, velocity=velocity, **changes)
    states, torques, estimates = [], [], []
    for each in rows:
        states.append(live.state.copy())
        torques += replayed(live, [each])
        estimates.append(live.velocity_estimate)
    cut %= len(rows)
    again = compensator(LUGRE, velocity=velocity, **changes)
    again.state[:] = states[cut]
    torque, estimate = again.replay([np.ascontiguousarray(column) for column in np.array(rows[cut:]).T])
    np.testing.assert_array_equal(torque.view(np.int64), np.array(torques[cut:]).view(np.int64))
    np.testing.assert_array_equal(estimate.view(np.int64), np.array(estimates[cut:]).view(np.int64))
    np.testing.assert_array_equal(again.state, live.state)


@every_model
@every_source
@every_velocity
def test_every_model_with_every_source_and_velocity_is_finite_bounded_odd_and_replayed(name, source, velocity):
    """A rich motion: the demand comes and goes, feedback is lost, it is switched on and off."""
    model = MODELS[name]
    given = {"position_resolution": 1e-5, "source": source, "velocity": velocity, "fade_s": 0.05}
    one, mirror, again = (compensator(model, **given) for _ in range(3))
    inputs = scattered()
    torque, estimate = one.replay(inputs)
    opposed, _ = mirror.replay([inputs[0], *(-column for column in inputs[1:7]), *inputs[7:]])
    np.testing.assert_array_equal(torque, -opposed)
    np.testing.assert_array_equal(torque[:300], again.replay([column[:300].copy() for column in inputs])[0])
    np.testing.assert_array_equal(torque[300:], again.replay([column[300:].copy() for column in inputs])[0])
    assert np.isfinite(estimate).all()
    assert np.abs(estimate).max() < 3.0
    # level and viscous parts at no more than that velocity; presliding damping of at most 1 N m s/rad
    assert np.abs(torque).max() <= 1.05 * max(model.level, np.abs(model.steady_state([0.01, 3.0])).max()) + 0.1
    assert np.abs(torque).max() > 0.3 * model.level


@given(friction_models.models(), st.sampled_from(EVERY_SOURCE), st.sampled_from(["difference", "tracking", "drive"]))
def test_no_model_whatever_its_parameters_goes_wrong(model, source, velocity):
    one = compensator(model, source=source, velocity=velocity, position_resolution=1e-5, torque_limit=1.0)
    torque, estimate = one.replay(scattered(200))
    assert np.isfinite(estimate).all()
    assert np.abs(torque).max() <= 1.0
    assert not one.is_faulty


def test_a_model_gone_wrong_gives_nothing_and_says_so():
    one = compensator(LUGRE, torque_slew=20.0)
    torque, _ = feed(one, *even(1.0), 50)
    assert not one.is_faulty
    field(one, "friction")[0] = math.nan
    (after,) = replayed(one, [row(50, position=0.05, velocity=1.0)])
    assert one.is_faulty
    assert after == pytest.approx(torque[-1] - 0.02)  # on its way to zero as fast as it may
    assert replayed(one, [row(cycle, position=0.05, velocity=1.0) for cycle in range(51, 60)])[-1] == 0.0


def test_it_fades_in_and_out_in_the_time_given():
    one = compensator(fade_s=0.1)
    rising, _ = feed(one, *even(1.0), 200, demand=even(1.0)[1])
    full = 0.05 + 0.01
    assert rising[0] == pytest.approx(0.01 * full)
    np.testing.assert_allclose(np.diff(rising[:100]), 0.01 * full, rtol=1e-6)
    np.testing.assert_allclose(rising[100:], full, rtol=1e-9)
    assert not one.is_faded_out
    falling, _ = feed(one, *even(1.0), 101, demand=even(1.0)[1], start=200, is_enabled=0.0)
    np.testing.assert_allclose(np.diff(falling[:99]), -0.01 * full, rtol=1e-6)
    assert falling[-1] == 0.0
    assert one.is_faded_out


def test_missed_cycles_count_in_the_fade():
    one = compensator(fade_s=0.1)
    given = {"velocity": 1.0, "velocity_demand": 1.0, "velocity_demand_ahead": 1.0}
    torques = replayed(one, [row(cycle, position=cycle * 1e-3, **given) for cycle in (0, 1, 2, 8)])
    assert torques[-1] == pytest.approx(0.09 * 0.06)


def test_a_slow_slew_outlasts_the_fade():
    one = compensator(fade_s=0.01, torque_slew=0.5)
    feed(one, *even(1.0), 300, demand=even(1.0)[1])
    falling, _ = feed(one, *even(1.0), 60, demand=even(1.0)[1], start=300, is_enabled=0.0)
    assert falling[60 - 1] == pytest.approx(0.06 - 60 * 0.5e-3)
    assert not one.is_faded_out


@every_source
def test_the_model_is_right_when_it_is_switched_on(source):
    """Presliding state and all: it ran along while it was disabled."""
    motion = (lambda t: 0.01 * math.sin(8.0 * t), lambda t: 0.08 * math.cos(8.0 * t))
    always, late = compensator(LUGRE, source=source), compensator(LUGRE, source=source)
    expected, _ = feed(always, *motion, 500, demand=motion[1])
    feed(late, *motion, 300, demand=motion[1], is_enabled=0.0)
    torque, _ = feed(late, *motion, 200, demand=motion[1], start=300)
    np.testing.assert_array_equal(torque[10:], expected[310:])


@given(st.floats(-50.0, 50.0))
def test_the_observer_knows_the_friction_and_the_load(speed):
    """At even speed the drive's torque is friction and load: nothing is left that would accelerate."""
    one = compensator(velocity="kalman", gravity=(0.3, 0.0, 0.0))
    friction = 0.05 * math.tanh(speed / (reference.RECOVERY * 1e-6)) + 0.01 * speed
    _, estimate = feed(one, *even(speed), 50, demand=even(speed)[1], torque=friction + 0.3)
    np.testing.assert_allclose(estimate[2:], speed, rtol=1e-5, atol=1e-6)
    assert abs(field(one, "motion")["torque"]) < 1e-4


@every_velocity
def test_stale_feedback_keeps_the_velocity(velocity):
    one = compensator(velocity=velocity)
    torque = 0.05 + 0.01 * 2.0
    feed(one, *even(2.0), 100, torque=torque, demand=even(2.0)[1])
    demanded = {"velocity_demand": 2.0, "velocity_demand_ahead": 2.0}
    for cycle in range(100, 105):
        replayed(one, [row(cycle, position=1e3, velocity=1e3, torque=1e3, is_fresh=0.0, **demanded)])
        assert one.velocity_estimate == pytest.approx(2.0, rel=1e-3)
    replayed(one, [row(105, position=2.0 * 105e-3, velocity=2.0, torque=torque, **demanded)])
    assert one.velocity_estimate == pytest.approx(2.0, rel=1e-3)


@pytest.mark.parametrize("is_stale", [False, True])
def test_after_a_long_gap_it_starts_anew_from_the_drives_velocity(is_stale):
    """Whether the cycles between are missed altogether or run without feedback."""
    one = compensator(source="measured")
    feed(one, *even(2.0), 50)
    if is_stale:
        replayed(one, [row(cycle, position=2.0 * 49e-3, velocity=2.0, is_fresh=0.0) for cycle in range(50, 100)])
    (after,) = replayed(one, [row(100, position=7.0, velocity=-1.5)])
    assert one.velocity_estimate == -1.5
    assert is_stale or after == pytest.approx(-0.05 - 0.015)
    replayed(one, [row(101, position=7.0 - 1.5e-3, velocity=-1.5)])
    assert one.velocity_estimate == pytest.approx(-1.5)


@given(st.lists(st.integers(1, 8), min_size=30, max_size=60), st.sampled_from(["auto", "measured"]))
def test_missed_cycles_do_not_disturb_an_even_motion(steps, source):
    one = compensator(source=source)
    feed(one, *even(2.0), 40, demand=even(2.0)[1])
    for cycle in 39 + np.cumsum(steps):
        position = 2.0 * cycle * PERIOD_S
        given = {"velocity": 2.0, "position_demand": position, "velocity_demand": 2.0, "velocity_demand_ahead": 2.0}
        assert replayed(one, [row(int(cycle), position=position, **given)])[0] == pytest.approx(0.07, rel=1e-9)


@pytest.mark.parametrize("velocity", ["difference", "tracking", "kalman"])
def test_a_glitch_is_passed_over_where_the_largest_acceleration_is_known(velocity):
    clean, glitched, naive = (
        compensator(source="measured", velocity=velocity, max_acceleration=a) for a in (500.0, 500.0, math.inf)
    )
    t = np.arange(200) * PERIOD_S
    course = {"velocity": 2.0, "torque": 0.07, "velocity_demand": 2.0, "velocity_demand_ahead": 2.0}
    wrong = 2.0 * t
    wrong[150] += 1.0
    expected, _ = clean.replay(columns(200, position=2.0 * t, **course))
    torque, estimate = glitched.replay(columns(200, position=wrong, **course))
    np.testing.assert_allclose(torque, expected, rtol=1e-2)
    np.testing.assert_allclose(estimate[100:], 2.0, rtol=1e-2)
    _, estimate = naive.replay(columns(200, position=wrong, **course))
    assert np.abs(estimate[150:153] - 2.0).max() > 1.0


@pytest.mark.parametrize("viscous", [0.05, 1.0])
def test_the_observer_stays_stable_with_much_viscous_friction(viscous):
    """On an axis of 2e-4 kg m^2, 1 N m s/rad brings a motion to rest within a fifth of a period."""
    model = fh.models.create("coulomb", coulomb=0.05, viscous=viscous)
    step = resolution(20)
    one = compensator(model, velocity="kalman", position_resolution=step, gain=0.9, lead_s=1.5e-3, torque_limit=5.0)
    run = Axis(model, resolution=step).run(one, 0.8, demand=swing(0.2, 1.0))
    assert abs(one.velocity_estimate - run.velocity[-1]) < 0.5
    assert np.abs(run.error).max() < 0.01


@pytest.mark.parametrize(
    ("speed", "changes", "expected"),
    [
        (1.0, {"gain": 0.5}, 0.03),
        (1.0, {"torque_limit": 0.04}, 0.04),
        (1.0, {"gain": 0.0}, 0.0),
        (1.0, {"gain": 0.8, "gain_negative": 0.5}, 0.048),
        (-1.0, {"gain": 0.8, "gain_negative": None}, -0.048),
        (-1.0, {"gain": 0.8, "gain_negative": 0.5}, -0.03),
        (-1.0, {"gain": 0.8, "gain_negative": 0.0}, 0.0),
    ],
)
def test_gains_scale_each_direction_and_the_limit_bounds(speed, changes, expected):
    torque, _ = feed(compensator(**changes), *even(speed), 50, demand=even(speed)[1])
    assert torque[-1] == pytest.approx(expected)


@every_source
@pytest.mark.parametrize(("speed", "share"), [(0.1, 0.2), (0.25, 0.5), (1.0, 1.0)])
def test_the_dead_band_takes_away_in_proportion_to_the_velocity(source, speed, share):
    torque, _ = feed(compensator(source=source, dead_band=0.5), *even(speed), 100, demand=even(speed)[1])
    assert torque[-1] == pytest.approx(share * (0.05 + 0.01 * speed), rel=1e-6)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"smoothing": 0.05}, "smoothing = 0.05 .* 19.5 cycles"),
        ({"smoothing": 0.05, "velocity": "drive"}, "smoothing = 0.05 .* 19"),
        ({"velocity": "tracking", "acceleration": 1e-4}, "tracking .* acceleration"),
        ({"velocity": "tracking", "acceleration": math.nan}, "tracking needs acceleration"),
        ({"velocity": "kalman", "inertia": 0.0}, "kalman needs inertia"),
        ({"velocity": "guess"}, "'guess'"),
        ({"adaptation_s": 1.0, "inertia": 0.0}, "adaptation needs the inertia"),
        ({"adaptation_s": 1.0, "inertia": math.nan}, "adaptation needs the inertia"),
        ({"adaptation_s": 1e-4}, r"adaptation_s = .* 0\.1 s"),  # less than a period: more than all is forgotten
        ({"adaptation_s": 0.05}, r"adaptation_s = .* 0\.1 s"),
        ({"max_acceleration": 0.0}, "max_acceleration = 0"),
        ({"position_resolution": 0.0}, "position_resolution = 0"),
        ({"position_resolution": math.nan}, "position_resolution = nan"),
        ({"position_resolution": math.inf}, "position_resolution = inf"),
    ],
)
def test_settings_without_sense_are_refused(changes, words):
    with pytest.raises(UsageError, match=words):
        compensator(**changes)


def test_what_the_message_on_smoothing_proposes_is_accepted():
    with pytest.raises(UsageError) as caught:
        compensator(smoothing=0.01)
    compensator(smoothing=float(str(caught.value).split("take ")[1].split()[0]))


@every_velocity
def test_the_longest_delay_that_is_allowed_has_room_in_the_history(velocity):
    """An accelerating axis that follows: any error in time is one of torque."""
    one = compensator(source="measured", velocity=velocity, smoothing=1.0 / 16.0)
    known = {"demand": lambda t: 30.0 * t, "torque": np.arange(1000) * 3e-4 + 0.056}
    torque, _ = feed(one, lambda t: 15.0 * t * t, lambda t: 30.0 * t, 1000, **known)
    assert torque[-1] == pytest.approx(0.05 + 0.01 * 30.0 * 0.999, rel=1e-4)


@given(
    st.tuples(*[st.floats(allow_nan=False)] * 7, st.booleans(), st.booleans(), *[st.floats(allow_nan=False)] * 3),
    st.integers(0, 8),
    st.integers(0, 63),
)
def test_the_checksum_sees_every_single_bit(values, place, bit):
    values = tuple(map(float, values))
    (word,) = struct.unpack("<Q", struct.pack("<d", values[place]))
    (flipped,) = struct.unpack("<d", struct.pack("<Q", word ^ 1 << bit))
    assert len(values) == len(INPUTS)
    assert input_checksum(*values) != input_checksum(*values[:place], flipped, *values[place + 1 :])
    assert input_checksum(*values[:11], math.nan) not in (input_checksum(*values), input_checksum(*values[:11], 0.0))
