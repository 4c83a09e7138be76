"""The CiA 402 device of a simulated drive: device control, modes, set-points and what the motor does."""

import math
import struct
from typing import Any

import pytest

from friction_hil.errors import DriveError
from tests.canopen_bench import PLAIN, Bench

RATED = 0.64
COUNTS = 1048576 / (2.0 * math.pi)  # per rad
DISABLED, READY, ON, ENABLED, STOPPING, FAULT = 0x40, 0x21, 0x23, 0x27, 0x07, 0x08


@pytest.fixture
def bench() -> Bench:
    return Bench(PLAIN)


@pytest.fixture
def turning() -> Bench:
    """A drive in csv that turns with 20 rad/s and brakes with 500 rad/s^2, or 1000 rad/s^2 in a quick stop."""
    one = Bench(PLAIN)
    for index, deceleration in ((0x6084, 500), (0x6085, 1000)):
        one.write(index, 0, "I", round(deceleration * COUNTS))
    one.stream(9)
    one.move(round(20 * COUNTS), 100)
    assert one.servo.velocity == pytest.approx(20.0, rel=0.02)
    return one


def state(bench: Bench) -> int:
    word = bench.statusword
    return word & 0x4F if word & 0x4F in (0x40, 0x08, 0x0F) else word & 0x6F


def control(bench: Bench, word: int) -> int:
    bench.write(0x6040, 0, "H", word)
    return state(bench)


# Device control


@pytest.mark.parametrize(("option", "word", "end"), [(0x605C, 0x07, ON), (0x605B, 0x06, READY)])
@pytest.mark.parametrize("is_ramped", [False, True])
def test_disabling_at_speed(turning: Bench, option: int, word: int, end: int, is_ramped: bool) -> None:
    turning.write(option, 0, "h", int(is_ramped))
    assert control(turning, word) == (ENABLED if is_ramped else end)
    turning.sync(20)
    assert turning.servo.velocity == pytest.approx(10.0 if is_ramped else 20.0, rel=0.2)
    turning.sync(40)
    assert (state(turning), turning.servo.torque_demand) == (end, 0.0)
    assert turning.servo.velocity == pytest.approx(0.0 if is_ramped else 20.0, abs=4.0)


def test_revoked_disabling_goes_on(turning: Bench) -> None:
    assert control(turning, 0x07) == ENABLED
    turning.sync(3)
    assert control(turning, 0x0F) == ENABLED
    turning.move(round(20 * COUNTS), 100)
    assert turning.servo.velocity == pytest.approx(20.0, rel=0.02)


@pytest.mark.parametrize(("option", "ramp_ms"), [(0, 0), (1, 40), (2, 20), (5, 40), (6, 20)])
def test_quick_stop(turning: Bench, option: int, ramp_ms: int) -> None:
    turning.write(0x605A, 0, "h", option)
    assert control(turning, 0x02) == (STOPPING if ramp_ms else DISABLED)
    if not ramp_ms:
        assert turning.servo.torque_demand == 0.0
        return
    turning.sync(ramp_ms // 2)
    assert turning.servo.velocity == pytest.approx(10.0, rel=0.15)
    turning.sync(ramp_ms // 2 + 100)
    assert abs(turning.servo.velocity) < 0.05
    assert state(turning) == (DISABLED if option in (1, 2) else STOPPING)
    if option in (5, 6):
        assert turning.statusword & 0x400, "target reached: it stands"
        start = turning.servo.position
        turning.sync(50)
        assert turning.servo.position == pytest.approx(start, abs=1e-3)
        assert control(turning, 0x0F) == ENABLED, "transition 16"
        turning.sync(50)
        assert turning.servo.position == pytest.approx(start, abs=1e-3), "it resumes from its position"


# Modes and set-points


def test_csp_follows_and_adds_the_torque_offset(bench: Bench) -> None:
    bench.stream(8)
    for cycle in range(400):
        bench.move(round(1e-3 * cycle * 5.0 * COUNTS))
    assert bench.statusword & 0x3C00 == 0x1000
    assert bench.read(0x606C, 0, "i") == pytest.approx(5.0 * COUNTS, rel=0.02)
    assert bench.read(0x606B, 0, "i") == pytest.approx(5.0 * COUNTS, rel=1e-3)
    error = bench.read(0x60F4, 0, "i")
    assert abs(error) < 1e-3 * COUNTS
    assert bench.read(0x6062, 0, "i") - bench.read(0x6064, 0, "i") == pytest.approx(error, abs=1)
    before = bench.servo.torque_demand
    for cycle in range(400, 402):
        bench.move(round(1e-3 * cycle * 5.0 * COUNTS), offset=50)
    gained = (bench.servo.torque_demand - before) / (0.05 * RATED)
    assert 0.5 < gained < 1.0, "the loops have begun to work against it"


def test_csv_follows_with_its_offset_and_interpolates_over_its_period(bench: Bench) -> None:
    bench.write(0x60C2, 1, "B", 10)
    bench.stream(9)
    bench.move(0)
    bench.send(0x205, struct.pack("<Hih", 0x0F, round(8 * COUNTS), 0))
    bench.sync(6)
    assert bench.servo.velocity_demand == pytest.approx(4.0, abs=0.5), "half-way after half a period"
    bench.sync(6)
    assert bench.servo.velocity_demand == pytest.approx(8.0)
    bench.write(0x60B1, 0, "i", round(2 * COUNTS))
    bench.move(round(8 * COUNTS), 200)
    assert bench.servo.velocity == pytest.approx(10.0, rel=0.02)


@pytest.mark.parametrize("mode", [8, 9, 10])
def test_stale_set_points_do_nothing_at_enable(bench: Bench, mode: int) -> None:
    for index, code, value in ((0x607A, "i", 99999), (0x60FF, "i", 99999), (0x6071, "h", 500), (0x60B2, "h", 500)):
        bench.write(index, 0, code, value)
    bench.enable(mode)
    bench.sync(20)
    assert abs(bench.servo.position) < 1e-5
    assert bench.servo.torque_demand == pytest.approx(0.0, abs=1e-9)


def test_no_mode_gives_no_torque(bench: Bench) -> None:
    bench.stream(8)
    bench.write(0x6060, 0, "b", 0)
    bench.write(0x6071, 0, "h", 500)
    bench.write(0x60B2, 0, "h", 500)
    bench.sync(5)
    assert bench.read(0x6061, 0, "b") == 0
    assert (bench.servo.torque_demand, bench.servo.position) == (0.0, 0.0)
    assert not bench.statusword & 0x1000


def test_jump_at_enable_is_a_following_error_before_anything_moves(bench: Bench) -> None:
    bench.write(0x6065, 0, "I", 5000)
    bench.stream(8)
    bench.move(5001)
    assert bench.statusword & 0x2000
    bench.sync(2)
    assert (state(bench), bench.emergencies, bench.servo.position) == (FAULT, ["8611"], 0.0)
    control(bench, 0x00)
    assert control(bench, 0x80) == DISABLED
    bench.enable(8)
    bench.move(4999)
    assert state(bench) == ENABLED


def test_the_window_of_the_configuration_is_that_of_the_following_error() -> None:
    bench = Bench(PLAIN | {"loops": {"following_error_window": 0.02}, "motor": {"peak_torque": 0.012}})
    assert bench.read(0x6065) == round(0.02 * COUNTS)
    bench.stream(8)
    errors = []
    while not bench.statusword & 0x2000:
        bench.move(round(5e-3 * len(errors) * COUNTS))
        errors.append(abs(bench.servo.following_error))
        assert len(errors) < 40
    assert 0.02 < errors[-1] < 0.1
    assert max(errors[: -bench.read(0x6066, 0, "H") - 2]) < 0.02
    assert bench.read(0x603F, 0, "H") == 0x8611


# Limits


def test_torque_and_speed_limit(bench: Bench) -> None:
    bench.write(0x6072, 0, "H", 50)
    bench.stream(10)
    bench.move(400, 3)
    assert bench.servo.torque_demand == pytest.approx(0.05 * RATED)
    assert bench.statusword & 0x0800, "internal limit active"
    bench.move(40, 3)
    assert not bench.statusword & 0x0800
    bench.write(0x6072, 0, "H", 20)
    bench.sync()
    assert bench.servo.torque_demand == pytest.approx(0.02 * RATED)
    bench = Bench(PLAIN)
    bench.write(0x6080, 0, "I", 60)  # one turn a second
    bench.stream(9)
    bench.move(round(100 * COUNTS), 300)
    assert bench.servo.velocity == pytest.approx(2 * math.pi, rel=0.02)
    assert bench.statusword & 0x0800


def test_position_limits(bench: Bench) -> None:
    bench.write(0x607D, 1, "i", -1000)
    bench.write(0x607D, 2, "i", 2000)
    bench.stream(8)
    for target, reached, is_limited in ((5000, 2000, True), (-5000, -1000, True), (500, 500, False)):
        bench.move(target, 300)
        assert bench.read(0x6064, 0, "i") == pytest.approx(reached, abs=20)
        assert bool(bench.statusword & 0x0800) is is_limited, target


# Description


def test_a_drive_with_an_encoder_at_the_load_reports_the_load() -> None:
    mechanics = {"inertia": 1e-4, "load": {"inertia": 1e-4, "stiffness": 1.0, "damping": 1e-2}}
    bench = Bench(PLAIN | {"mechanics": mechanics, "encoder": {"at": "both", "load_counts": 40000}})
    assert bench.read(0x608F, 1) == 40000
    bench.stream(10)
    bench.move(300, 30)
    assert abs(bench.servo.true_position - bench.servo.load_position) > 0.01
    assert bench.read(0x6064, 0, "i") == math.floor(bench.servo.load_position * 40000 / (2.0 * math.pi))


def test_a_warm_drive_reports_the_temperatures_of_motor_and_gear() -> None:
    thermal: dict[str, Any] = {
        "ambient": 20.0,
        "winding": {"capacity": 1.0, "resistance": 0.1, "loss": 200.0},
        "motor": {"capacity": 2.0, "resistance": 1.0},
        "gear": {"capacity": 5.0, "resistance": 1.0},
    }
    bench = Bench({"thermal": thermal, "friction": {"model": "coulomb", "parameters": {"coulomb": 1.0}}})
    assert (bench.read(0x5FF0, 0, "h"), bench.read(0x5FF1, 0, "h")) == (200, 200)
    bench.stream(10)
    bench.move(1000, 100)
    assert bench.servo.temperatures is not None
    assert bench.read(0x5FF0, 0, "h") == round(10.0 * bench.servo.temperatures.motor) > 205
    assert bench.read(0x5FF1, 0, "h") == 200
    assert Bench(PLAIN).read(0x5FF0, 0, "h") == 250


def test_servo_beyond_all_bounds_is_a_clear_error() -> None:
    bench = Bench(PLAIN | {"mechanics": {"inertia": 1e-300, "load_torque": 1e300}})
    with pytest.raises(DriveError, match="diverged"):
        bench.sync(2)


def test_interpolation_period_that_fits_nothing_is_found_at_enable(bench: Bench) -> None:
    bench.write(0x60C2, 2, "b", -5)  # one step of 10 us, which the servo cannot do
    bench.write(0x6060, 0, "b", 8)
    assert [control(bench, word) for word in (0x06, 0x07, 0x0F)] == [READY, ON, FAULT]
    assert bench.read(0x603F, 0, "H") == 0x6320
