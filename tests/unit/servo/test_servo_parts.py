"""Sensors, motor, filters, heat and wear of the simulated servo, each alone against what it should do."""

import math

import numpy as np
import pytest
from pydantic import ValidationError
from scipy.linalg import expm

from friction_hil.servo.config import ServoConfig
from friction_hil.servo.servo import Servo

OFF, CSP, CSV, CST = 0, 8, 9, 10
HZ = 80_000
LOOP = 8000
J = 1e-4
FREE = {"model": "coulomb", "parameters": {"coulomb": 0.0}}
HELD = {"model": "coulomb", "parameters": {"coulomb": 1.0}}
NODES = {
    "winding": {"capacity": 20.0, "resistance": 0.8, "loss": 12.0},
    "motor": {"capacity": 150.0, "resistance": 2.0},
}


def servo(position=0.0, *, friction=FREE, mechanics=None, lag=0.0, motor=None, **parts):
    motor = {"torque_lag_s": lag, "peak_torque": 10.0, "rated_torque": 0.5, **(motor or {})}
    parts |= {"mechanics": {"inertia": J, **(mechanics or {})}, "friction": friction, "motor": motor}
    return Servo(ServoConfig.model_validate(parts), position)


def pushed(one, torque, seconds=0.0):
    one.command(CST, torque)
    one.advance(round(seconds * HZ))
    return one


def test_the_encoder_reads_what_was_so_long_ago():
    """At an even speed it lags by speed times latency, whenever it is read."""
    for latency in (3e-5, 2.5e-4, 3.1e-3):
        one = servo(encoder={"latency_s": latency, "counts": 1e9})
        pushed(one, 0.05, 0.02)
        pushed(one, 0.0, 0.01)
        for steps in (3, 4, 7, 11):
            one.advance(steps)
            assert one.true_position - one.position == pytest.approx(one.true_velocity * latency, rel=1e-4)
        assert one.velocity == pytest.approx(one.true_velocity, rel=1e-3)


def test_the_periodic_error_of_the_encoder_is_its_harmonics():
    one = servo(encoder={"counts": 1e9, "periodic_error": [{"order": 1, "sine": 2e-3}, {"order": 64, "cosine": 1e-4}]})
    pushed(one, 0.01, 0.05)
    for _ in range(50):
        one.advance(631)
        q = one.true_position
        assert one.position - q == pytest.approx(2e-3 * math.sin(q) + 1e-4 * math.cos(64 * q), abs=1e-8)


def readings(seed, **parts):
    one = servo(seed=seed, **parts)
    rows = []
    for _ in range(4000):
        one.advance(10)
        rows.append((one.position, one.torque))
    return np.array(rows).T


def test_noise_has_its_deviation_is_white_and_the_same_for_the_same_seed():
    parts = {"encoder": {"noise": 1e-4, "counts": 1e9}, "torque_feedback": {"noise": 0.02}}
    position, torque = readings(1, **parts)
    for values, sigma in ((position, 1e-4), (torque, 0.02)):
        assert np.std(values) == pytest.approx(sigma, rel=0.05)
        assert abs(np.mean(values)) < 4.0 * sigma / math.sqrt(4000)
        assert abs(np.corrcoef(values[1:], values[:-1])[0, 1]) < 0.05
        assert np.abs(values).max() > 3.0 * sigma
    assert abs(np.corrcoef(position, torque)[0, 1]) < 0.05
    np.testing.assert_array_equal(position, readings(1, **parts)[0])
    assert abs(np.corrcoef(position, readings(2, **parts)[0])[0, 1]) < 0.05


def test_torque_feedback_has_gain_offset_and_delay():
    one = servo(friction=HELD, torque_feedback={"gain": 1.1, "offset": -0.03, "delay_s": 2e-3})
    pushed(one, 0.2, 1.9e-3)
    assert one.torque == pytest.approx(-0.03)
    assert one.true_torque == pytest.approx(0.2)
    one.advance(40)
    assert one.torque == pytest.approx(0.2 * 1.1 - 0.03)


def test_the_shaft_gets_the_torque_of_the_true_constant_and_the_drive_does_not_know():
    one = pushed(servo(motor={"torque_constant_error": -0.1}), 0.2, 0.01)
    assert one.torque == pytest.approx(0.2)
    assert one.true_velocity == pytest.approx(0.9 * 0.2 / J * 0.01, rel=1e-6)


def test_the_bus_voltage_limits_the_speed_but_not_the_braking():
    one = pushed(servo(motor={"no_load_speed": 200.0, "corner_speed": 150.0, "peak_torque": 0.5}), 0.5, 0.03)
    assert one.true_velocity == pytest.approx(150.0, rel=1e-3)  # up to here the full torque
    start = 50.0
    one.advance(HZ // 100)
    # dv/dt = (200 - v) / 50 * 0.5 / J
    assert 200.0 - one.true_velocity == pytest.approx(start * math.exp(-0.5 / 50.0 / J * 0.01), rel=0.02)
    fast = one.true_velocity
    pushed(one, -0.5, 0.01)
    assert fast - one.true_velocity == pytest.approx(0.5 / J * 0.01, rel=1e-6)


def test_cogging_acts_without_current_and_ripple_with_it():
    one = servo(0.1, motor={"cogging": [{"order": 6, "sine": 0.01}]})
    for _ in range(20):
        one.advance(97)
        before = one.true_position  # the torque of the last step is that of its beginning
        assert one.true_torque == pytest.approx(0.01 * math.sin(6 * before), abs=2e-4)
    assert abs(one.true_velocity) > 0.1
    one = servo(0.3, motor={"torque_ripple": [{"order": 3, "cosine": 0.05}]})
    one.advance(1000)
    assert one.true_position == 0.3
    pushed(one, 0.1, 1.0 / HZ)
    assert one.true_torque == pytest.approx(0.1 * (1.0 + 0.05 * math.cos(0.9)))


def amplitude(one, hz):
    """Torque of a sine of demand, relative to it, after its start."""
    rows = []
    for k in range(LOOP // 2):
        pushed(one, 0.1 * math.sin(2.0 * math.pi * hz * k / LOOP), 1.0 / LOOP)
        rows.append(one.true_torque)
    t = np.arange(LOOP // 4, LOOP // 2) / LOOP
    return abs(2.0 * np.mean(np.array(rows)[LOOP // 4 :] * np.exp(-2j * math.pi * hz * t))) / 0.1


def test_notch_and_low_pass_of_the_torque_have_their_corners():
    notch, half = {"frequency_hz": 400.0, "width_hz": 80.0}, math.sqrt(0.5)
    for loops, hz, expected in (
        ({"notch": notch}, 400.0, pytest.approx(0.0, abs=1e-3)),
        ({"notch": notch}, 40.0 + math.hypot(400.0, 40.0), pytest.approx(half, rel=0.02)),
        ({"notch": notch}, 40.0, pytest.approx(1.0, abs=0.01)),
        ({"notch": notch | {"depth": 0.25}}, 400.0, pytest.approx(0.25, rel=1e-3)),
        ({"torque_filter_hz": 100.0}, 100.0, pytest.approx(half, rel=0.03)),
        ({"torque_filter_hz": 100.0}, 800.0, pytest.approx(1.0 / math.hypot(1.0, 8.0), rel=0.1)),
    ):
        assert amplitude(servo(friction=HELD, loops=loops), hz) == expected, (loops, hz)


def test_the_torque_acts_after_the_dead_time_and_is_away_at_once_without_power():
    one = servo(friction=HELD, loops={"dead_time_s": 5e-4})
    one.advance(7)
    one.command(CST, 0.1)
    one.advance(3 + 40)  # to the next sample of the loops, and the dead time
    assert one.true_torque == 0.0
    one.advance(1)
    assert one.true_torque == pytest.approx(0.1)
    one.command(OFF, 0.0)
    one.advance(1)
    assert one.true_torque == 0.0
    one.advance(HZ // 100)
    assert one.true_torque == 0.0


def test_without_anti_windup_the_axis_overshoots_after_a_long_limit():
    def overshoot(has_anti_windup):
        loops = {"has_anti_windup": has_anti_windup, "velocity_gain": 0.02, "integral_hz": 10.0}
        one = servo(motor={"peak_torque": 0.02}, loops=loops, mechanics={"spring": {"stiffness": 1e-9}})
        highest = 0.0
        for _ in range(2000):
            one.command(CSV, 40.0)
            one.advance(80)
            highest = max(highest, one.true_velocity)
        return highest - 40.0

    assert overshoot(False) > 3.0 * max(overshoot(True), 1.0)


def test_temperatures_follow_the_exact_solution_of_the_nodes():
    """Constant loss in three linear nodes: matrix exponential; a thousand thermal seconds take one."""
    nodes = {**NODES, "gear": {"capacity": 300.0, "resistance": 1.5}, "contact": 0.7, "resistance_coefficient": 0.0}
    one = servo(friction=HELD, thermal=nodes, time_lapse=1000.0)
    one.command(CST, 0.25)
    inward, contact, outward, away = 1.0 / 0.8, 1.0 / 0.7, 1.0 / 2.0, 1.0 / 1.5
    system = np.array(
        [
            [-inward / 20.0, inward / 20.0, 0.0, 12.0 * 0.25 / 20.0],
            [inward / 150.0, -(inward + contact + outward) / 150.0, contact / 150.0, 0.0],
            [0.0, contact / 300.0, -(contact + away) / 300.0, 0.0],
            [0.0, 0.0, 0.0, 0.0],
        ]
    )
    for k in range(1, 6):
        one.advance(HZ // 20)
        warmed_s = 50.0 * k - 1000.0 / LOOP  # the torque acts from the first sample on, and heats from the second
        expected = (expm(system * warmed_s) @ [0.0, 0.0, 0.0, 1.0])[:3]
        found = np.array(one.temperatures)[:3] - 25.0
        np.testing.assert_allclose(found, expected, rtol=2e-3)


def test_friction_heats_the_gear_and_falls_with_its_temperature():
    """A motor driven at constant speed: all of its mechanical work arrives as heat, and the torque falls."""
    cooling = {"temperature": {"reference": 25.0, "coefficient": -0.01}}
    friction = {"model": "coulomb", "parameters": {"coulomb": 0.2}, "modifiers": cooling}
    thermal = {**NODES, "gear": {"capacity": 50.0, "resistance": 1e6}, "winding": {**NODES["winding"], "loss": 0.0}}
    one = servo(friction=friction, thermal=thermal, time_lapse=20.0)
    torques = []
    for _ in range(2000):
        one.command(CSV, 20.0)
        one.advance(80)
        torques.append(one.torque)
    warm = one.temperatures
    assert warm.gear - 25.0 == pytest.approx(20.0 * one.energy.friction_heat / 50.0, rel=0.01)
    assert warm.motor == pytest.approx(25.0, abs=1e-9)
    assert np.mean(torques[-100:]) == pytest.approx(0.2 * (1.0 - 0.01 * (warm.gear - 25.0)), rel=0.02)
    assert warm.gear > 26.0


def test_a_hot_motor_has_more_loss_and_less_torque():
    thermal = {**NODES, "ambient": 75.0, "torque_constant_coefficient": -1e-3}
    one = pushed(servo(friction=HELD, thermal=thermal), 0.5, 1.0)
    assert one.true_torque == pytest.approx(0.5 * (1.0 - 1e-3 * 50.0), rel=1e-3)
    assert one.torque == pytest.approx(0.5)
    cold = pushed(servo(friction=HELD, thermal=NODES), 0.5, 1.0)
    risen, plain = one.temperatures.winding - 75.0, cold.temperatures.winding - 25.0
    assert risen / plain == pytest.approx(1.0 + 3.9e-3 * 50.0, rel=2e-3)


def test_the_ambient_steps_at_its_times():
    steps = [{"time_s": 10.0, "temperature": 35.0}, {"time_s": 30.0, "temperature": 5.0}]
    one = servo(thermal={**NODES, "ambient_steps": steps}, time_lapse=100.0)
    seen = []
    for _ in range(4):
        one.advance(HZ // 10)
        seen.append((one.temperatures.ambient, one.temperatures.motor))
    assert [ambient for ambient, _ in seen] == [35.0, 35.0, 5.0, 5.0]
    assert 25.0 < seen[0][1] < seen[1][1]
    assert seen[3][1] < seen[1][1]


def test_friction_wears_and_is_lubricated_again():
    wear = [{"time_s": 0.0, "factor": 1.0}, {"time_s": 3600.0, "factor": 2.0}, {"time_s": 3601.0, "factor": 0.9}]
    one = servo(friction={"model": "coulomb", "parameters": {"coulomb": 0.1}}, wear=wear, time_lapse=3600.0)
    found = []
    for _ in range(1500):
        one.command(CSV, 5.0)
        one.advance(80)
        found.append(one.torque)
    assert np.mean(found[480:520]) == pytest.approx(0.15, rel=0.02)
    assert np.mean(found[960:990]) == pytest.approx(0.1975, rel=0.02)
    assert np.mean(found[1400:]) == pytest.approx(0.09, rel=0.02)
    stuck = servo(friction=HELD, wear=[{"time_s": 0.0, "factor": 0.5}])
    assert pushed(stuck, 0.49, 0.1).true_velocity == 0.0
    assert pushed(stuck, 0.51, 0.1).true_velocity > 1.0


@pytest.mark.parametrize(
    ("parts", "words"),
    [
        ({"loops": {"dead_time_s": 1e-4}}, "whole samples of the loops, e.g. 0.000125"),
        ({"loops": {"dead_time_s": 0.1}}, "loops.dead_time_s must be at most"),
        ({"encoder": {"latency_s": 0.1}}, "encoder.latency_s must be at most"),
        ({"loops": {"notch": {"frequency_hz": 5000.0, "width_hz": 10.0}}}, "below half of rate_hz"),
        ({"loops": {"torque_filter_hz": 5000.0}}, "below half of rate_hz"),
        ({"motor": {"corner_speed": 10.0}}, "needs no_load_speed"),
        ({"motor": {"corner_speed": 10.0, "no_load_speed": 5.0}}, "must be below no_load_speed"),
        ({"thermal": {**NODES, "contact": 1.0}}, "gear is missing"),
        ({"thermal": NODES, "time_lapse": 1e6}, "too fast for these thermal nodes; at most"),
        ({"wear": [{"time_s": 1.0, "factor": 1.0}, {"time_s": 0.0, "factor": 1.0}]}, "times of wear must rise"),
        ({"encoder": {"periodic_error": [{"order": 0.0}]}}, "greater than 0"),
    ],
)
def test_parts_that_cannot_be_are_refused(parts, words):
    with pytest.raises(ValidationError, match=words):
        ServoConfig.model_validate(parts)
