"""The CiA 402 device of a simulated drive: device control, modes, set-points and what the motor does."""

import math
import struct
from typing import Any

import pytest

from friction_hil.drive import Mode
from friction_hil.errors import DriveError
from tests.canopen_bench import Bench

INERTIA, FRICTION, RATED = 2e-4, 0.01, 0.64
COUNTS = 1048576 / (2.0 * math.pi)  # per rad
PLAIN: dict[str, Any] = {"friction": {"model": "coulomb", "parameters": {"coulomb": FRICTION}}}
DISABLED, READY, ON, ENABLED, STOPPING, FAULT = 0x40, 0x21, 0x23, 0x27, 0x07, 0x08


@pytest.fixture
def bench() -> Bench:
    return Bench(PLAIN)


def state(bench: Bench) -> int:
    word = bench.statusword
    return word & 0x4F if word & 0x4F in (0x40, 0x08, 0x0F) else word & 0x6F


def control(bench: Bench, word: int) -> int:
    bench.write(0x6040, 0, "H", word)
    return state(bench)


def move(bench: Bench, mode: int, value: int, cycles: int, torque_offset: int = 0, word: int = 0x0F) -> None:
    """Stream a set-point for some cycles."""
    code = "i" if mode in (8, 9) else "h"
    for _ in range(cycles):
        bench.send(0x205, struct.pack(f"<H{code}h", word, value, torque_offset))
        bench.sync()


def torque(bench: Bench) -> float:
    """What the power stage is asked for, N m."""
    return bench.servo.torque_demand


# Device control


def test_the_way_up_and_down(bench: Bench) -> None:
    bench.write(0x6060, 0, "b", 8)
    assert state(bench) == DISABLED
    assert [control(bench, word) for word in (0x07, 0x0F, 0x02, 0x00)] == [DISABLED] * 4
    assert [control(bench, word) for word in (0x06, 0x07, 0x0F)] == [READY, ON, ENABLED]
    assert [control(bench, word) for word in (0x07, 0x06, 0x00)] == [ON, READY, DISABLED]


@pytest.mark.parametrize(("option", "word", "end"), [(0x605C, 0x07, ON), (0x605B, 0x06, READY)])
@pytest.mark.parametrize("is_ramped", [False, True])
def test_disabling_at_speed(bench: Bench, option: int, word: int, end: int, is_ramped: bool) -> None:
    bench.write(option, 0, "h", int(is_ramped))
    bench.stream(9)
    move(bench, 9, round(20 * COUNTS), 100)
    assert bench.servo.velocity == pytest.approx(20.0, rel=0.02)
    assert control(bench, word) == (ENABLED if is_ramped else end)
    deceleration = bench.read(0x6084) / COUNTS
    cycles = math.ceil(1e3 * 20.0 / deceleration)
    bench.sync(cycles // 2)
    if is_ramped:
        assert bench.servo.velocity == pytest.approx(10.0, rel=0.2)
    bench.sync(cycles // 2 + 20)
    assert state(bench) == end
    assert torque(bench) == 0.0
    assert bench.servo.velocity == pytest.approx(0.0 if is_ramped else 20.0, abs=3.0)


@pytest.mark.parametrize("option", [0, 1, 2, 5, 6])
def test_quick_stop(bench: Bench, option: int) -> None:
    bench.write(0x605A, 0, "h", option)
    bench.write(0x6084, 0, "I", round(500 * COUNTS))
    bench.write(0x6085, 0, "I", round(1000 * COUNTS))
    bench.stream(9)
    move(bench, 9, round(20 * COUNTS), 100)
    assert control(bench, 0x02) == (DISABLED if option == 0 else STOPPING)
    if option == 0:
        assert torque(bench) == 0.0
        return
    needed = 40 if option in (1, 5) else 20  # ms at the ramp of the option
    bench.sync(needed // 2)
    assert bench.servo.velocity == pytest.approx(10.0, rel=0.15)
    bench.sync(needed // 2 + 100)
    assert abs(bench.servo.velocity) < 0.05
    if option in (1, 2):
        assert state(bench) == DISABLED
        return
    assert state(bench) == STOPPING
    assert bench.statusword & 0x400, "target reached: it stands"
    start = bench.servo.position
    bench.sync(50)
    assert bench.servo.position == pytest.approx(start, abs=1e-3)
    assert control(bench, 0x0F) == ENABLED, "transition 16"
    bench.sync(50)
    assert bench.servo.position == pytest.approx(start, abs=1e-3), "it resumes from its position"


def test_fault_is_reset_by_the_rising_edge_alone(bench: Bench) -> None:
    bench.stream(8)
    bench.nmt(0x80)  # leaving Operational while enabled is a lost connection
    bench.sync(3)
    assert state(bench) == FAULT
    assert bench.read(0x603F, 0, "H") == 0x8100
    assert bench.read(0x1001, 0, "B") == 0x11
    for word in (0x00, 0x06, 0x07, 0x0F, 0x0F):
        assert control(bench, word) == FAULT
    assert control(bench, 0x80) == DISABLED
    assert bench.read(0x603F, 0, "H") == 0
    assert bench.read(0x1001, 0, "B") == 0
    assert bench.emergencies == ["8100", "0000"]


# Modes and set-points


def test_drive_has_the_modes_that_it_says() -> None:
    bench = Bench(modes=[Mode.CSP, Mode.CST])
    assert bench.read(0x6502) == 0x280
    assert bench.try_write(0x6060, 0, "b", 9) == 0x06090030
    assert bench.try_write(0x6060, 0, "b", 10) == 0


def test_csp_follows_and_adds_the_torque_offset(bench: Bench) -> None:
    bench.stream(8)
    for cycle in range(400):
        move(bench, 8, round(1e-3 * cycle * 5.0 * COUNTS), 1)
    assert bench.statusword & 0x3C00 == 0x1000
    assert bench.read(0x606C, 0, "i") == pytest.approx(5.0 * COUNTS, rel=0.02)
    assert bench.read(0x606B, 0, "i") == pytest.approx(5.0 * COUNTS, rel=1e-3)
    assert abs(bench.read(0x60F4, 0, "i")) < 1e-3 * COUNTS
    assert bench.read(0x6062, 0, "i") - bench.read(0x6064, 0, "i") == pytest.approx(bench.read(0x60F4, 0, "i"), abs=1)
    before = torque(bench)
    for cycle in range(400, 402):
        move(bench, 8, round(1e-3 * cycle * 5.0 * COUNTS), 1, torque_offset=50)
    assert 0.5 < (torque(bench) - before) / (0.05 * RATED) < 1.0, "the loops have begun to work against it"


def test_csv_follows_with_its_offset(bench: Bench) -> None:
    bench.stream(9)
    move(bench, 9, round(8 * COUNTS), 50)
    bench.write(0x60B1, 0, "i", round(2 * COUNTS))
    move(bench, 9, round(8 * COUNTS), 200)
    assert bench.servo.velocity == pytest.approx(10.0, rel=0.02)


def test_interpolation_period_stretches_the_demand(bench: Bench) -> None:
    bench.write(0x60C2, 1, "B", 10)
    bench.stream(9)
    move(bench, 9, 0, 1)
    bench.send(0x205, struct.pack("<Hih", 0x0F, round(10 * COUNTS), 0))
    bench.sync(6)
    assert bench.servo.velocity_demand == pytest.approx(5.0, abs=0.6), "half-way after half a period"
    bench.sync(6)
    assert bench.servo.velocity_demand == pytest.approx(10.0)


def test_position_wraps_at_32_bits() -> None:
    start = ((1 << 31) - 3000) / COUNTS
    bench = Bench(PLAIN, position=start)
    bench.stream(8)
    first = bench.read(0x6064, 0, "i")
    assert first == pytest.approx((1 << 31) - 3000, abs=1)
    for cycle in range(200):
        target = (first + 100 * cycle + (1 << 31)) % (1 << 32) - (1 << 31)
        move(bench, 8, target, 1)
    assert bench.read(0x6064, 0, "i") == pytest.approx(first + 19900 - (1 << 32), abs=300)
    assert bench.servo.position == pytest.approx(start + 19900 / COUNTS, abs=300 / COUNTS)
    assert state(bench) == ENABLED


def test_stale_set_points_do_nothing_at_enable(bench: Bench) -> None:
    for index, code, value in ((0x607A, "i", 99999), (0x60FF, "i", 99999), (0x6071, "h", 500), (0x60B2, "h", 500)):
        bench.write(index, 0, code, value)
    for mode in (8, 9, 10):
        bench.enable(mode)
        bench.sync(20)
        assert abs(bench.servo.position) < 1e-5, mode
        assert torque(bench) == pytest.approx(0.0, abs=1e-9), mode
        control(bench, 0x00)


def test_jump_at_enable_is_a_following_error_before_anything_moves(bench: Bench) -> None:
    bench.write(0x6065, 0, "I", 5000)
    bench.stream(8)
    move(bench, 8, 5001, 1)
    assert bench.statusword & 0x2000
    bench.sync(2)
    assert state(bench) == FAULT
    assert bench.emergencies == ["8611"]
    assert bench.servo.position == 0.0
    control(bench, 0x00)
    assert control(bench, 0x80) == DISABLED
    bench.enable(8)
    move(bench, 8, 4999, 1)
    assert state(bench) == ENABLED


def test_the_window_of_the_configuration_is_that_of_the_following_error() -> None:
    weak = {"peak_torque": 1.2 * FRICTION}
    bench = Bench(PLAIN | {"loops": {"following_error_window": 0.02}, "motor": weak})
    assert bench.read(0x6065) == round(0.02 * COUNTS)
    bench.stream(8)
    errors = []
    for k in range(40):
        move(bench, 8, round(5e-3 * k * COUNTS), 1)
        errors.append(abs(bench.servo.following_error))
        if bench.statusword & 0x2000:
            break
    assert 0.02 < errors[-1] < 0.1
    assert all(error < 0.02 for error in errors[: -bench.read(0x6066, 0, "H") - 2])
    assert bench.read(0x603F, 0, "H") == 0x8611


def test_a_drive_with_an_encoder_at_the_load_reports_the_load() -> None:
    load = {"inertia": 1e-4, "stiffness": 1.0, "damping": 1e-2}
    bench = Bench(
        PLAIN | {"mechanics": {"inertia": 1e-4, "load": load}, "encoder": {"at": "both", "load_counts": 40000}}
    )
    assert bench.read(0x608F, 1) == 40000
    bench.stream(10)
    move(bench, 10, 300, 30)
    assert abs(bench.servo.true_position - bench.servo.load_position) > 0.01
    assert bench.read(0x6064, 0, "i") == math.floor(bench.servo.load_position * 40000 / (2.0 * math.pi))


def test_a_warm_drive_reports_the_temperatures_of_motor_and_gear() -> None:
    thermal = {
        "ambient": 20.0,
        "winding": {"capacity": 1.0, "resistance": 0.1, "loss": 200.0},
        "motor": {"capacity": 2.0, "resistance": 1.0},
        "gear": {"capacity": 5.0, "resistance": 1.0},
    }
    bench = Bench(PLAIN | {"thermal": thermal, "friction": {"model": "coulomb", "parameters": {"coulomb": 1.0}}})
    assert (bench.read(0x5FF0, 0, "h"), bench.read(0x5FF1, 0, "h")) == (200, 200)
    bench.stream(10)
    move(bench, 10, 1000, 100)
    temperatures = bench.servo.temperatures
    assert temperatures is not None
    assert bench.read(0x5FF0, 0, "h") == round(10.0 * temperatures.motor) > 205
    assert bench.read(0x5FF1, 0, "h") == 200
    assert Bench(PLAIN).read(0x5FF0, 0, "h") == 250


# Limits


def test_torque_limit(bench: Bench) -> None:
    bench.write(0x6072, 0, "H", 50)
    bench.stream(10)
    move(bench, 10, 400, 3)
    assert torque(bench) == pytest.approx(0.05 * RATED)
    assert bench.statusword & 0x0800, "internal limit active"
    move(bench, 10, 40, 3)
    assert not bench.statusword & 0x0800
    bench.write(0x6072, 0, "H", 20)
    bench.sync()
    assert torque(bench) == pytest.approx(0.02 * RATED)


def test_speed_limit(bench: Bench) -> None:
    bench.write(0x6080, 0, "I", 60)  # one turn a second
    bench.stream(9)
    move(bench, 9, round(100 * COUNTS), 300)
    assert bench.servo.velocity == pytest.approx(2 * math.pi, rel=0.02)
    assert bench.statusword & 0x0800


def test_position_limits(bench: Bench) -> None:
    bench.write(0x607D, 1, "i", -1000)
    bench.write(0x607D, 2, "i", 2000)
    bench.stream(8)
    for target, reached in ((5000, 2000), (-5000, -1000)):
        move(bench, 8, target, 300)
        assert bench.read(0x6064, 0, "i") == pytest.approx(reached, abs=20)
        assert bench.statusword & 0x0800
    move(bench, 8, 500, 100)
    assert not bench.statusword & 0x0800


# Description


def test_what_the_drive_says_of_its_motor() -> None:
    bench = Bench({"motor": {"rated_torque": 1.234, "peak_torque": 2.468}, "encoder": {"counts": 1000.5}})
    assert bench.read(0x6076) == 1234
    assert bench.read(0x6072, 0, "H") == 2000
    assert bench.read(0x608F, 1) / bench.read(0x608F, 2) == 1000.5
    assert bench.read(0x60A9) == 0x00B50300


def test_servo_beyond_all_bounds_is_a_clear_error() -> None:
    bench = Bench({**PLAIN, "mechanics": {"inertia": 1e-300, "load_torque": 1e300}})
    with pytest.raises(DriveError, match="diverged"):
        bench.sync(2)


def test_interpolation_period_that_fits_nothing_is_found_at_enable(bench: Bench) -> None:
    bench.write(0x60C2, 2, "b", -5)  # one step of 10 us, which the servo cannot do
    bench.write(0x6060, 0, "b", 8)
    control(bench, 0x06)
    control(bench, 0x07)
    assert control(bench, 0x0F) == FAULT
    assert bench.read(0x603F, 0, "H") == 0x6320


def test_reset_node_returns_to_the_defaults_and_keeps_the_place(bench: Bench) -> None:
    bench.stream(8)
    move(bench, 8, 3000, 100)
    bench.write(0x6065, 0, "I", 7)
    start = bench.servo.position
    assert bench.nmt(0x81)[0] == (0x705, b"\0")
    assert state(bench) == DISABLED
    assert torque(bench) == 0.0
    assert bench.read(0x6065) == round(1048576 / 20)
    assert bench.read(0x6060, 0, "b") == 0
    assert bench.read(0x1600, 0, "B") == 1
    assert bench.servo.position == pytest.approx(start, abs=1e-3)


def test_a_reversed_drive_turns_against_its_targets() -> None:
    for mode, target in ((9, struct.pack("<Hih", 0x0F, 100000, 0)), (10, struct.pack("<Hhh", 0x0F, 300, 0))):
        bench = Bench(manners={"is_reversed": True})
        bench.stream(mode)
        bench.send(0x205, target)
        bench.sync(100)
        assert bench.servo.position < -1e-3


def test_revoked_disabling_goes_on(bench: Bench) -> None:
    bench.stream(9)
    move(bench, 9, round(20 * COUNTS), 100)
    assert control(bench, 0x07) == ENABLED
    bench.sync(3)
    assert control(bench, 0x0F) == ENABLED
    move(bench, 9, round(20 * COUNTS), 100)
    assert bench.servo.velocity == pytest.approx(20.0, rel=0.02)


def test_no_mode_gives_no_torque(bench: Bench) -> None:
    bench.stream(8)
    bench.write(0x6060, 0, "b", 0)
    bench.write(0x6071, 0, "h", 500)
    bench.write(0x60B2, 0, "h", 500)
    bench.sync(5)
    assert bench.read(0x6061, 0, "b") == 0
    assert (torque(bench), bench.servo.position) == (0.0, 0.0)
    assert not bench.statusword & 0x1000
