"""The compensator: what no input may do, and what the right velocity at the right time gives."""

import math
import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import friction_hil as fh
from friction_hil.compensator import INPUTS, STATE, Compensator, CompensatorSettings, input_checksum
from friction_hil.errors import UsageError

PERIOD_S = 1e-3
VISCOUS = fh.models.create("coulomb", coulomb=0.05, viscous=0.01)
LUGRE = fh.models.create(
    "lugre",
    sigma0=2000.0,
    sigma1=1.0,
    sigma2=2e-3,
    coulomb=0.08,
    static=0.12,
    stribeck_velocity=0.2,
    damping_velocity=0.2,
)
checked = settings(max_examples=60, deadline=None)


def compensator(model=VISCOUS, **changes):
    given = {"period_s": PERIOD_S, "position_resolution": 1e-6, "torque_limit": 10.0, "gain": 1.0, "fade_s": 0.01}
    return Compensator(model, CompensatorSettings(**given | changes))


def drive(one, motion, cycles, *, demand=None, lead_s=0.0, start=0, enabled=True):
    """Feed position and velocity of a ``motion`` (functions of time); return compensations and estimates."""
    torques, estimates = [], []
    for cycle in range(start, start + cycles):
        t = cycle * PERIOD_S
        position, velocity = motion(t)
        now, ahead = (math.nan, math.nan) if demand is None else (demand(t), demand(t + lead_s))
        torques.append(one.step(float(cycle), position, velocity, now, ahead, True, enabled))
        estimates.append(one.velocity_estimate)
    return np.array(torques), np.array(estimates)


def even(speed):
    return lambda t: (speed * t, speed)


def even_demand(speed):
    return lambda t: speed


# --- what holds whatever comes in

wild = st.floats(-1e6, 1e6)
inputs = st.lists(
    st.tuples(
        st.integers(-1, 40),  # cycles that passed; none or fewer must not happen, but must not hurt
        wild,
        wild,
        st.one_of(st.just(math.nan), wild),
        st.one_of(st.just(math.nan), wild),
        st.booleans(),
        st.booleans(),
    ),
    min_size=1,
    max_size=60,
)


@checked
@given(inputs, st.sampled_from([VISCOUS, LUGRE]), st.sampled_from(["auto", "measured", "demand"]), st.booleans())
def test_no_input_breaks_the_limits_of_torque_and_slew(rows, model, source, uses_drive):
    one = compensator(model, torque_limit=0.3, torque_slew=20.0, source=source, uses_drive_velocity=uses_drive)
    before, cycle = 0.0, 0
    for passed, *rest in rows:
        cycle += passed
        torque = one.step(float(cycle), *rest)
        assert abs(torque) <= 0.3
        assert abs(torque - before) <= 20.0 * PERIOD_S * max(passed, 1) * (1.0 + 1e-12)
        assert math.isfinite(one.velocity_estimate)
        before = torque


@checked
@given(inputs, st.sampled_from([VISCOUS, LUGRE]))
def test_opposite_inputs_give_exactly_the_opposite(rows, model):
    forth, back = compensator(model, torque_slew=50.0), compensator(model, torque_slew=50.0)
    cycle = 0
    for passed, position, velocity, demand, ahead, is_fresh, is_enabled in rows:
        cycle += passed
        torque = forth.step(float(cycle), position, velocity, demand, ahead, is_fresh, is_enabled)
        assert torque == -back.step(float(cycle), -position, -velocity, -demand, -ahead, is_fresh, is_enabled)


@checked
@given(inputs, st.integers(0, 59))
def test_replay_is_step_for_step_the_same_bits_from_any_saved_state(rows, cut):
    cycles = np.cumsum([row[0] for row in rows]).astype(float)
    columns = [cycles, *np.array([row[1:] for row in rows], dtype=float).T.copy()]
    live = compensator(LUGRE)
    states, torques = [], []
    for row in zip(*columns, strict=True):
        states.append(live.state.copy())
        torques.append(live.step(*row))
    cut %= len(rows)
    again = compensator(LUGRE)
    again.state[:] = states[cut]
    torque, _ = again.replay([np.ascontiguousarray(column[cut:]) for column in columns])
    np.testing.assert_array_equal(torque.view(np.int64), np.array(torques[cut:]).view(np.int64))
    np.testing.assert_array_equal(again.state, live.state)


def test_a_model_gone_wrong_gives_nothing_and_says_so():
    one = compensator(torque_slew=20.0)
    torque, _ = drive(one, even(1.0), 50)
    assert not one.is_faulty
    wrong = compensator(LUGRE, torque_slew=20.0)
    wrong.state[:] = one.state
    fields = STATE.fields
    assert fields is not None
    wrong.state[fields["friction"][1] // 8] = math.nan
    after = wrong.step(50.0, 0.05, 1.0, math.nan, math.nan, True, True)
    assert wrong.is_faulty
    assert after == pytest.approx(torque[-1] - 0.02)  # on its way to zero as fast as it may
    for cycle in range(51, 60):
        after = wrong.step(float(cycle), 0.05, 1.0, math.nan, math.nan, True, True)
    assert after == 0.0


# --- fading


def test_it_fades_in_and_out_in_the_time_given():
    one = compensator(fade_s=0.1)
    rising, _ = drive(one, even(1.0), 200, demand=even_demand(1.0))
    full = 0.05 + 0.01
    assert rising[0] == pytest.approx(0.01 * full)
    np.testing.assert_allclose(np.diff(rising[:100]), 0.01 * full, rtol=1e-6)
    np.testing.assert_allclose(rising[100:], full, rtol=1e-9)
    assert not one.is_faded_out
    falling, _ = drive(one, even(1.0), 101, demand=even_demand(1.0), start=200, enabled=False)
    np.testing.assert_allclose(np.diff(falling[:99]), -0.01 * full, rtol=1e-6)
    assert falling[-1] == 0.0
    assert one.is_faded_out


def test_missed_cycles_count_in_the_fade():
    one = compensator(fade_s=0.1)
    for cycle in (0, 1, 2, 8):
        torque = one.step(float(cycle), cycle * 1e-3, 1.0, 1.0, 1.0, True, True)
    assert torque == pytest.approx(0.09 * 0.06)


def test_a_slow_slew_outlasts_the_fade():
    one = compensator(fade_s=0.01, torque_slew=0.5)
    drive(one, even(1.0), 300, demand=even_demand(1.0))
    falling, _ = drive(one, even(1.0), 60, demand=even_demand(1.0), start=300, enabled=False)
    assert falling[60 - 1] == pytest.approx(0.06 - 60 * 0.5e-3)
    assert not one.is_faded_out


def test_the_model_is_right_when_it_is_switched_on():
    """Presliding state and all: it ran along while it was disabled."""

    def motion(t):
        return 0.01 * math.sin(8.0 * t), 0.08 * math.cos(8.0 * t)

    always, late = compensator(LUGRE), compensator(LUGRE)
    expected, _ = drive(always, motion, 500, demand=lambda t: motion(t)[1])
    drive(late, motion, 300, demand=lambda t: motion(t)[1], enabled=False)
    torque, _ = drive(late, motion, 200, demand=lambda t: motion(t)[1], start=300)
    np.testing.assert_array_equal(torque[10:], expected[310:])


# --- velocity


@checked
@given(st.floats(0.1, 1.0), st.floats(-50.0, 50.0), st.booleans())
def test_the_estimate_of_an_even_motion_is_its_velocity(smoothing, speed, uses_drive):
    _, estimate = drive(compensator(smoothing=smoothing, uses_drive_velocity=uses_drive), even(speed), 400)
    assert estimate[-1] == pytest.approx(speed, rel=1e-9, abs=1e-12)


@checked
@given(st.sampled_from([0.1, 0.3, 0.5, 0.77, 1.0]), st.booleans(), st.floats(0.0, 5e-3))
@pytest.mark.parametrize("source", ["auto", "measured", "demand"])
def test_on_an_accelerating_axis_that_follows_the_model_sees_the_velocity_of_the_time_when_it_acts(
    source, smoothing, uses_drive, lead_s
):
    """Whatever the filter's delay: v(t) = a t, so the torque must be that of a (t + lead)."""
    a = 30.0
    one = compensator(smoothing=smoothing, uses_drive_velocity=uses_drive, source=source)
    torque, _ = drive(one, lambda t: (0.5 * a * t * t, a * t), 500, demand=lambda t: a * t, lead_s=lead_s)
    t = np.arange(500) * PERIOD_S
    np.testing.assert_allclose(torque[200:], 0.05 + 0.01 * a * (t[200:] + lead_s), rtol=1e-9)


def test_without_a_demand_the_measured_velocity_is_taken():
    torque, _ = drive(compensator(), even(-2.0), 100)
    assert torque[-1] == pytest.approx(-0.05 - 0.02)


@pytest.mark.parametrize(
    ("source", "level", "state"), [("measured", 3.0, 3.0), ("demand", 1.0, 1.0), ("auto", 3.0, 2.0)]
)
def test_each_source_takes_the_deviation_from_the_demand_its_own_way(source, level, state):
    """The demand is 1, the axis goes at 3: a deviation far above all noise. auto splits: half of it to the state."""
    stribeck = fh.models.create("stribeck", coulomb=0.05, static=0.09, stribeck_velocity=2.0, viscous=0.01)
    torque, _ = drive(compensator(stribeck, source=source), even(3.0), 1000, demand=even_demand(1.0))
    expected = 0.05 + 0.04 * math.exp(-((level / 2.0) ** 2)) + 0.01 * level
    assert torque[-1] == pytest.approx(expected, rel=2e-3)
    # presliding: by the velocity of the state a fresh bristle deflects
    lugre = fh.models.create("lugre", sigma0=10.0, coulomb=1e4, stribeck_velocity=1.0)
    torque, _ = drive(compensator(lugre, source=source, torque_limit=1e5), even(3.0), 1000, demand=even_demand(1.0))
    assert np.diff(torque)[-1] == pytest.approx(10.0 * state * PERIOD_S, rel=0.01)


def test_the_gate_lets_noise_pass_as_little_as_it_is_real():
    """A deviation of a tenth of the gate comes through by a hundredth."""
    stribeck = fh.models.create("stribeck", coulomb=0.05, static=0.05, stribeck_velocity=2.0, viscous=1.0)
    speed = 1.0 + 0.1 * 0.05 * 2.0
    torque, _ = drive(compensator(stribeck), even(speed), 2000, demand=even_demand(1.0))
    assert torque[-1] - 0.05 - 1.0 == pytest.approx(0.01 * (speed - 1.0), rel=0.05)


def test_an_encoder_that_flickers_at_rest_hardly_moves_the_torque():
    flicker = np.random.default_rng(0).integers(0, 2, 2000) * 1e-3  # between two counts while the demand rests
    spread = {}
    for source in ("auto", "measured", "demand"):
        one = compensator(position_resolution=1e-3, source=source)
        torque = [one.step(float(k), float(x), 0.0, 0.0, 0.0, True, True) for k, x in enumerate(flicker)]
        spread[source] = np.abs(torque[100:]).max()
    assert spread["demand"] == 0.0
    assert spread["auto"] < 0.1 * 0.05
    assert spread["measured"] > 0.3 * 0.05


def test_stale_feedback_keeps_the_last_velocity_and_the_next_difference_spans_it():
    one = compensator(smoothing=1.0)
    drive(one, even(2.0), 20)
    for cycle in range(20, 25):
        one.step(float(cycle), 1e3, 1e3, math.nan, math.nan, False, True)
        assert one.velocity_estimate == pytest.approx(2.0)
    one.step(25.0, 2.0 * 25e-3, 2.0, math.nan, math.nan, True, True)
    assert one.velocity_estimate == pytest.approx(2.0)


def test_after_a_long_gap_the_estimate_starts_anew_from_the_drives_velocity():
    one = compensator()
    drive(one, even(2.0), 50)
    after = one.step(100.0, 7.0, -1.5, math.nan, math.nan, True, True)
    assert one.velocity_estimate == -1.5
    assert after == pytest.approx(-0.05 - 0.015)
    one.step(101.0, 7.0 - 1.5e-3, -1.5, math.nan, math.nan, True, True)
    assert one.velocity_estimate == pytest.approx(-1.5)


@checked
@given(st.lists(st.integers(1, 8), min_size=30, max_size=60))
def test_missed_cycles_do_not_disturb_an_even_motion(steps):
    one = compensator(source="measured")
    drive(one, even(2.0), 40, demand=even_demand(2.0))
    cycle = 39
    for step in steps:
        cycle += step
        torque = one.step(float(cycle), 2.0 * cycle * PERIOD_S, 2.0, 2.0, 2.0, True, True)
        assert torque == pytest.approx(0.07, rel=1e-9)


# --- settings and checksum


def test_gain_scales_and_the_limit_bounds():
    for gain, limit, expected in ((0.5, 10.0, 0.03), (1.0, 0.04, 0.04), (0.0, 10.0, 0.0)):
        torque, _ = drive(compensator(gain=gain, torque_limit=limit), even(1.0), 50, demand=even_demand(1.0))
        assert torque[-1] == pytest.approx(expected)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"smoothing": 0.05}, "smoothing = 0.05 delays the velocity by 19.5 cycles, more than 14; take 0.0"),
        ({"position_resolution": 0.0}, "position_resolution = 0 must be finite and above zero"),
        ({"position_resolution": math.nan}, "position_resolution = nan must be"),
        ({"position_resolution": math.inf}, "position_resolution = inf must be"),
    ],
)
def test_settings_without_sense_are_refused(changes, words):
    with pytest.raises(UsageError, match=words):
        compensator(**changes)


def test_what_the_message_on_smoothing_proposes_is_accepted():
    with pytest.raises(UsageError) as caught:
        compensator(smoothing=0.01)
    compensator(smoothing=float(str(caught.value).split("take ")[1].split()[0]))


@given(
    st.tuples(*[st.floats(allow_nan=False)] * 5, st.booleans(), st.booleans()), st.integers(0, 6), st.integers(0, 63)
)
def test_the_checksum_sees_every_single_bit(values, place, bit):
    values = tuple(map(float, values))
    (word,) = struct.unpack("<Q", struct.pack("<d", values[place]))
    (flipped,) = struct.unpack("<d", struct.pack("<Q", word ^ 1 << bit))
    assert len(values) == len(INPUTS)
    assert input_checksum(*values) != input_checksum(*values[:place], flipped, *values[place + 1 :])
