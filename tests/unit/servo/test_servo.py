"""The simulated servo: mechanics compared with physics, drive functions with CiA 402."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError
from scipy.integrate import solve_ivp

from friction_hil.errors import UsageError
from friction_hil.friction import describe
from friction_hil.servo.config import ServoConfig
from friction_hil.servo.plant import BRIDGED_PERIODS
from friction_hil.servo.servo import Servo

OFF, CSP, CSV, CST = 0, 8, 9, 10
J = 2e-4
STEPS = 80  # integration steps a millisecond
FREE = {"model": "coulomb", "parameters": {"coulomb": 0.0}}
COULOMB = {"model": "coulomb", "parameters": {"coulomb": 0.08, "static": 0.12}}
LUGRE = dict(describe("lugre").example)


def servo(position=0.0, **parts):
    return Servo(ServoConfig.model_validate(parts), position)


def instant(friction, **mechanics):
    """A servo whose torque acts at once."""
    return servo(friction=friction, motor={"torque_lag_s": 0.0}, mechanics=mechanics)


def spun_up(one, milliseconds=100, torque=0.3):
    """Set in motion by a torque, then switched off."""
    one.command(CST, torque)
    one.advance(milliseconds * STEPS)
    one.command(OFF, 0.0)
    one.advance(10)  # the drive's next control sample takes the torque away
    return one


def stream(one, mode, targets, offset=0.0):
    """Command a target every millisecond; return position and velocity demand and position after each."""
    rows = []
    for target in targets:
        one.command(mode, float(target), 0.0, offset)
        one.advance(STEPS)
        rows.append((one.position_demand, one.velocity_demand, one.true_position))
    return np.array(rows)


@pytest.mark.parametrize("lag", [0.0, 3e-4, 5e-3])
def test_a_torque_step_accelerates_by_torque_over_inertia(lag):
    one, t = servo(friction=FREE, motor={"torque_lag_s": lag}), 0.01
    one.command(CST, 0.05)
    one.advance(10 * STEPS)
    risen = -math.expm1(-t / lag) if lag else 1.0
    assert one.true_velocity == pytest.approx(0.05 / J * (t - lag * risen), rel=5e-3)
    assert one.torque == pytest.approx(0.05 * risen, rel=1e-9)


def test_a_load_torque_pulls_backward_and_viscous_friction_brakes_exponentially():
    one = instant(FREE, load_torque=0.02)
    one.advance(10 * STEPS)
    assert one.true_velocity == pytest.approx(-0.02 / J * 0.01, rel=1e-9)
    one = spun_up(instant({"model": "coulomb", "parameters": {"coulomb": 0.0, "viscous": 2e-3}}))
    before = one.true_velocity
    one.advance(50 * STEPS)
    assert one.true_velocity == pytest.approx(before * math.exp(-2e-3 / J * 0.05), rel=1e-3)


def test_coulomb_friction_brakes_evenly_and_stops_for_good():
    one = spun_up(instant(COULOMB))
    speed, start = one.true_velocity, one.true_position
    assert speed == pytest.approx((0.3 - 0.08) / J * 0.1, rel=2e-3)
    needed = speed * J / 0.08
    one.advance(round(0.9 * needed * 80_000))
    assert one.true_velocity == pytest.approx(0.1 * speed, rel=1e-3)
    one.advance(round(0.2 * needed * 80_000))
    assert one.true_velocity == 0.0
    assert one.true_position - start == pytest.approx(0.5 * speed * needed, rel=1e-3)


@pytest.mark.parametrize("load", [0.1199, -0.1199])
def test_static_friction_sticks_exactly_below_break_away(load):
    one = instant(COULOMB, load_torque=load)
    one.advance(500 * STEPS)
    assert (one.true_position, one.true_velocity) == (0.0, 0.0)
    one = instant(COULOMB, load_torque=math.copysign(0.1201, load))
    one.advance(100 * STEPS)
    assert one.true_position * load < 0.0
    assert one.true_velocity == pytest.approx(-math.copysign(0.0401, load) / J * 0.1, rel=1e-3)  # slides on Coulomb's


def test_a_dynamic_model_creeps_no_further_than_its_presliding():
    one = servo(mechanics={"load_torque": 0.1})
    one.advance(200 * STEPS)
    assert 0.1 / 2000.0 < -one.true_position < 3e-4
    assert abs(one.true_velocity) < 1e-3


def test_a_brake_holds_only_while_the_drive_is_off():
    one = servo(mechanics={"load_torque": 1.0, "has_brake": True})
    one.advance(100 * STEPS)
    assert one.true_position == 0.0
    one.command(CST, 0.0)
    one.advance(5 * STEPS)
    assert one.true_position < -1e-3


def test_the_plant_agrees_with_an_ode_solver():
    """Mass with LuGre friction under the torque of a sine, from sticking over breaking away to sliding back."""

    def torque(t):
        return 0.15 * math.sin(2.0 * math.pi * 5.0 * math.floor(t * 1000.0) * 1e-3)  # held for each millisecond

    def rates(t, y):
        _, v, z = y
        level = 0.08 + 0.04 * math.exp(-((v / 0.2) ** 2))
        dz = v - 2000.0 * abs(v) / level * z
        friction = 2000.0 * z + math.exp(-((v / 0.2) ** 2)) * dz + 2e-3 * v
        return v, (torque(t) - friction) / J, dz

    one = servo(friction={"model": "lugre", "parameters": LUGRE}, motor={"torque_lag_s": 0.0})
    y, positions, expected = np.zeros(3), [], []
    for k in range(300):
        one.command(CST, torque(k * 1e-3 + 1e-6))
        one.advance(STEPS)
        span = (k * 1e-3 + 1e-9, (k + 1) * 1e-3 - 1e-9)
        y = solve_ivp(rates, span, y, "Radau", rtol=1e-7, atol=1e-10, max_step=2e-4).y[:, -1]
        positions.append(one.true_position)
        expected.append(y[0])
    assert np.ptp(expected) > 0.1
    np.testing.assert_allclose(positions, expected, atol=0.01 * np.ptp(expected))


@settings(max_examples=30, deadline=None)
@given(st.floats(0.15, 1.0), st.integers(5, 60))
def test_a_coasting_servo_only_loses_energy(torque, milliseconds):
    one = spun_up(servo(), milliseconds, torque)
    one.advance(5 * STEPS)  # what the torque lag still gives
    energy = 0.5 * J * one.true_velocity**2 + 0.5 * 0.12**2 / 2000.0  # the bristles cannot hold more
    for _ in range(200):
        one.advance(STEPS)
        now = 0.5 * J * one.true_velocity**2
        assert now <= energy
        energy = min(energy, now + 0.5 * 0.12**2 / 2000.0)
    assert abs(one.true_velocity) < spun_up(servo(), milliseconds, torque).true_velocity


@settings(max_examples=40, deadline=None)
@given(st.floats(-100.0, 100.0), st.sampled_from([64, 4096, 1048576]))
def test_the_encoder_counts_whole_steps_downward(position, counts):
    one = servo(position, encoder={"counts": counts})
    assert one.counts_per_unit == pytest.approx(counts / (2.0 * math.pi))
    in_counts = one.position * one.counts_per_unit
    assert in_counts == pytest.approx(round(in_counts), abs=1e-6)
    assert -1e-9 <= one.true_position * one.counts_per_unit - in_counts <= 1.0
    assert one.true_position == position
    linear = servo(0.0123, mechanics={"axis": "linear", "inertia": 10.0}, encoder={"counts": 10_000})
    assert linear.counts_per_unit == 10_000, "per metre"
    assert linear.position == pytest.approx(0.0123, abs=1e-4)


def test_the_drives_velocity_follows_the_true_one():
    one = instant(FREE)
    one.command(CST, 0.02)
    one.advance(50 * STEPS)
    # behind by half a control sample, the filter's delay and what has passed since the last sample
    behind = 1.0 / (2.0 * math.pi * 1000.0) + 1.5 / 8000.0
    assert one.true_velocity - one.velocity == pytest.approx(0.02 / J * behind, rel=0.3)


def test_a_position_target_is_the_demand_one_and_a_half_periods_later():
    """With the period that the exchange takes, 2.5 periods from sending to demand."""
    now = 1e-3 * np.arange(400)
    seen = now + 1e-3 - 1.0 / 8000.0  # the demand is that of the last control sample
    demand = stream(servo(friction=FREE), CSP, 0.2 * np.sin(20.0 * now))[10:, 0]
    np.testing.assert_allclose(demand, 0.2 * np.sin(20.0 * (seen[10:] - 1.5e-3)), atol=0.2 * (20.0 * 1e-3) ** 2)
    demand, velocity = stream(servo(), CSP, 2.0 * now)[3:, :2].T
    np.testing.assert_allclose(demand, 2.0 * (seen[3:] - 1.5e-3), atol=1e-12)
    np.testing.assert_allclose(velocity, 2.0, atol=1e-9)


def test_the_demand_is_smooth_within_the_period():
    one = servo()
    rng = np.random.default_rng(4)
    targets = np.cumsum(rng.normal(size=50)) * 1e-3
    positions, velocities = [], []
    for target in targets:
        one.command(CSP, float(target))
        for _ in range(8):
            one.advance(10)
            positions.append(one.position_demand)
            velocities.append(one.velocity_demand)
    dt = 1.0 / 8000.0
    mean = 0.5 * (np.array(velocities)[1:] + velocities[:-1])
    np.testing.assert_allclose(np.diff(positions), mean * dt, atol=1e-12)  # a parabola between samples, no step
    assert np.abs(np.diff(velocities)).max() < np.abs(np.diff(targets, 2)).max() / 1e-3 / 8 * 1.01


def test_a_missed_target_is_bridged_and_then_the_demand_stands_until_it_goes_on_from_there():
    one = servo()
    stream(one, CSP, 2.0 * 1e-3 * np.arange(50))
    before = one.position_demand
    one.advance(STEPS)  # no command came
    assert one.position_demand == pytest.approx(before + 2e-3, abs=1e-9)
    one.advance(5 * STEPS)
    # the curve reaches half a period behind its newest target by itself
    assert one.position_demand == pytest.approx(0.097 + 2e-3 * BRIDGED_PERIODS, abs=1e-9)
    assert one.velocity_demand == 0.0
    standing, positions = one.position_demand, []
    for target in standing + 2e-3 * np.arange(4):
        one.command(CSP, target)
        for _ in range(8):
            one.advance(STEPS // 8)
            positions.append(one.position_demand)
    steps = np.diff([standing, *positions])
    assert np.all((steps >= 0.0) & (steps <= 2e-3 / 8 * (1.0 + 1e-9)))
    assert steps[-1] == pytest.approx(2e-3 / 8, rel=1e-6)


def test_a_late_target_is_met_without_a_step():
    one, late = servo(), servo()
    targets = 2.0 * 1e-3 * np.arange(50)
    stream(one, CSP, targets)
    stream(late, CSP, targets[:-1])
    late.advance(STEPS)
    stream(late, CSP, 2.0 * 1e-3 * np.arange(50, 60))
    stream(one, CSP, 2.0 * 1e-3 * np.arange(50, 60))
    assert late.position_demand == pytest.approx(one.position_demand, abs=1e-9)


@pytest.mark.parametrize("feedforward", [0.0, 0.5, 1.0])
def test_a_velocity_target_is_reached_in_one_straight_period_and_is_no_feed_forward(feedforward):
    """That gain belongs to the position loop: a drive without it follows the targets of csv as well."""
    one = servo(friction=FREE, loops={"velocity_feedforward": feedforward})
    one.command(CSV, 0.0)
    one.advance(STEPS)
    one.command(CSV, 4.0)
    ramp = []
    for _ in range(16):
        one.advance(10)
        ramp.append(one.velocity_demand)
    np.testing.assert_allclose(ramp, [*np.arange(8) * 0.5, *([4.0] * 8)], atol=1e-12)
    stream(one, CSV, [4.0] * 300)
    assert one.true_velocity == pytest.approx(4.0, rel=1e-3)


def test_offsets_are_added():
    plain, pushed = instant(FREE), instant(FREE)
    plain.command(CST, 0.05)
    pushed.command(CST, 0.02, 0.0, 0.03)
    for one in (plain, pushed):
        one.advance(STEPS)
    assert pushed.true_velocity == pytest.approx(plain.true_velocity, rel=1e-12)
    one = servo(friction=FREE)
    for _ in range(300):
        one.command(CSV, 1.0, 0.5)
        one.advance(STEPS)
    assert one.true_velocity == pytest.approx(1.5, rel=1e-3)


def test_a_period_that_is_no_whole_number_of_steps_is_refused():
    for period_s in (1.0001e-3, 1e-6):
        with pytest.raises(UsageError, match="not a whole number"):
            servo().set_period(period_s)


def test_quick_stop_comes_to_rest_at_its_deceleration_and_holds_against_a_load():
    one = servo(mechanics={"load_torque": 0.2})
    stream(one, CSP, 10.0 * 1e-3 * np.arange(400))
    assert one.true_velocity == pytest.approx(10.0, rel=0.01)
    begin = one.position_demand
    one.quick_stop(200.0)
    demands = []
    for _ in range(1000):
        one.advance(STEPS)
        demands.append(one.velocity_demand)
    assert np.diff(demands).min() == pytest.approx(-0.2, rel=1e-6)
    assert demands[48] > 0.0
    assert demands[51] == 0.0
    assert one.position_demand - begin == pytest.approx(10.0**2 / 400.0, rel=0.02)
    assert one.true_position == pytest.approx(one.position_demand, abs=1e-3)
    assert one.is_at_rest
    assert one.torque == pytest.approx(0.2, abs=0.12)  # holds the load, within friction


@pytest.mark.parametrize("mode", [OFF, CST])
def test_quick_stop_catches_a_free_axis_where_it_is(mode):
    one = spun_up(servo(friction=FREE))
    one.command(mode, 0.0)
    one.advance(STEPS)
    speed = one.true_velocity
    assert speed > 100.0
    one.quick_stop(1000.0)
    one.advance(10)
    assert one.velocity_demand == pytest.approx(speed, rel=0.02)
    one.advance(500 * STEPS)
    assert abs(one.true_velocity) < 0.05


targets, offsets = st.floats(-1e3, 1e3), st.floats(-100.0, 100.0)
orders = st.tuples(st.sampled_from([OFF, CSP, CSV, CST, 2]), targets, offsets, offsets, st.integers(1, 200))
commands = st.lists(orders, min_size=1, max_size=12)


def obey(one, orders):
    for mode, target, velocity_offset, torque_offset, steps in orders:
        if mode == 2:
            one.quick_stop(500.0)
        else:
            one.command(mode, target, velocity_offset, torque_offset)
        one.advance(steps)


@settings(max_examples=60, deadline=None)
@given(commands, st.floats(0.01, 10.0))
def test_no_command_gets_more_torque_than_the_limit(orders, limit):
    one = servo()
    one.torque_limit = limit
    assert one.torque_limit == min(limit, 1.92)
    for order in orders:
        obey(one, [order])
        assert abs(one.torque_demand) <= one.torque_limit
        assert abs(one.torque) <= one.torque_limit * (1.0 + 1e-12)
        assert math.isfinite(one.true_position)
    one.command(OFF, 0.0)
    one.advance(10)
    assert one.torque_demand == 0.0
    one.advance(40 * STEPS)
    assert abs(one.torque) < 1e-12


def test_the_limited_torque_is_reported():
    one = servo()
    one.torque_limit = 0.05
    for torque in (0.04, 0.06):
        one.command(CST, torque)
        one.advance(STEPS)
        assert one.is_torque_limited == (torque > 0.05)


@pytest.mark.parametrize("first", [CSP, CSV, CST])
@pytest.mark.parametrize("second", [CSP, CSV, 2])
def test_a_change_of_mode_in_motion_does_not_jump(first, second):
    """The demand of the new mode starts from what the axis does, whatever its first target says."""
    one = servo(friction=FREE)
    speed = 2.0
    for k in range(400):
        one.command(first, {CSP: speed * 1e-3 * k, CSV: speed, CST: 0.0 if one.true_velocity > speed else 0.02}[first])
        one.advance(STEPS)
    position = one.true_position
    if second == 2:
        one.quick_stop(50.0)
    else:
        one.command(second, {CSP: one.position, CSV: one.velocity}[second])
    one.advance(10)
    assert one.position_demand == pytest.approx(position, abs=0.01)
    if second != CSP:
        assert one.velocity_demand == pytest.approx(speed, rel=0.05)
    assert abs(one.torque_demand) < 1.0


@settings(max_examples=40, deadline=None)
@given(commands)
def test_same_calls_same_bits_however_the_steps_are_cut(orders):
    whole, cut = servo(0.3), servo(0.3)
    obey(whole, orders)
    for *order, steps in orders:
        obey(cut, [(*order, 1)])
        for _ in range(steps - 1):
            cut.advance(1)
    for name in ("true_position", "true_velocity", "torque", "position_demand", "velocity_demand", "velocity"):
        assert getattr(whole, name) == getattr(cut, name)


@pytest.mark.parametrize(
    ("parts", "words"),
    [
        ({"mechanics": {"inertia": -1e-4}}, "greater than 0"),
        ({"mechanics": {"inertia": math.nan}}, "finite"),
        ({"encoder": {"counts": 0}}, "greater than 0"),
        ({"friction": {"model": "lugree"}}, "did you mean 'lugre'"),
        ({"friction": {"model": "coulomb", "parameters": {"coulomb": -1}}}, "coulomb = -1 is not allowed"),
        ({"integration_hz": 81_000.0}, "a multiple of loops.rate_hz, not 10.125 times it; try 80000"),
        ({"integration_hz": 8_000.0}, "is too slow for this friction and inertia; at least"),
        ({"mechanics": {"inertia": 1e-9}}, "is too slow for this friction and inertia"),
        ({"sloth": 1}, "sloth"),
    ],
)
def test_a_servo_that_cannot_be_is_refused(parts, words):
    with pytest.raises(ValidationError, match=words.replace("*", r"\*")):
        ServoConfig.model_validate(parts)


def test_the_least_integration_rate_is_stable():
    with pytest.raises(ValidationError) as caught:
        ServoConfig.model_validate({"mechanics": {"inertia": 1e-5}, "integration_hz": 8000.0})
    rate = float(str(caught.value).split("at least ")[1].split()[0])
    one = spun_up(servo(mechanics={"inertia": 1e-5}, integration_hz=rate), 1)
    one.advance(round(rate))
    assert abs(one.true_velocity) < 1e-6
