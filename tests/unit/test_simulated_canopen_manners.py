"""Manners of simulated drives: what stacks and vendors do differently, each on the bench."""

import struct
from typing import Any

import pytest
from pydantic import ValidationError

from friction_hil.drive import DriveState
from friction_hil.errors import UsageError
from tests.canopen_bench import Bench

PLAIN: dict[str, Any] = {"friction": {"model": "coulomb", "parameters": {"coulomb": 0.01}}}


def push(bench: Bench, time_ms: int) -> None:
    """Stream a torque for five cycles of a millisecond, from ``time_ms`` on."""
    for cycle in range(5):
        bench.at(time_ms + cycle)
        bench.send(0x205, struct.pack("<Hhh", 0x0F, 50, 0))
        bench.sync()


# Event timer of RPDOs


@pytest.mark.parametrize("at_sync_only", [False, True])
def test_timer_of_a_synchronous_rpdo_without_sync(at_sync_only: bool) -> None:
    bench = Bench(PLAIN, is_paced_by_sync=False, manners={"timer_at_sync_only": at_sync_only})
    bench.write(0x1400, 5, "H", 20)
    bench.stream(10)
    push(bench, 1)
    for time in range(6, 3000):
        bench.at(time)
    assert (bench.node.drive.state is DriveState.OPERATION_ENABLED) == at_sync_only
    assert (abs(bench.servo.true_velocity) > 10.0) == at_sync_only, "nobody stops it"
    bench.sync()
    assert bench.emergencies == ["8250"], "the SYNC makes it look"
    assert bench.node.drive.state in (DriveState.FAULT, DriveState.FAULT_REACTION_ACTIVE)


def test_timer_of_an_event_driven_rpdo_needs_no_sync() -> None:
    bench = Bench(PLAIN, is_paced_by_sync=False, manners={"timer_at_sync_only": True})
    bench.map(0x1403, 0x1603, 0x505, 255, [0x60400010])
    bench.write(0x1403, 5, "H", 20)
    bench.stream(10)
    push(bench, 1)
    bench.send(0x505, struct.pack("<H", 0x0F))
    for time in range(6, 25):
        bench.at(time)
    assert bench.emergencies == []
    bench.at(25)
    assert bench.emergencies == ["8250"]


# SDO


def upload(index: int, subindex: int = 0) -> bytes:
    return struct.pack("<BHB4x", 0x40, index, subindex)


@pytest.mark.parametrize("is_paced_by_sync", [False, True])
def test_every_answer_is_late(is_paced_by_sync: bool) -> None:
    bench = Bench(is_paced_by_sync=is_paced_by_sync, manners={"sdo_delay_s": 0.05})
    assert bench.sdo(upload(0x1000)) == []
    assert bench.node.answers_in_s == pytest.approx(0.05)
    assert bench.wait(49) == []
    assert bench.wait(1) == [(0x585, bytes.fromhex("43 00 10 00 92 01 02 00"))]
    assert bench.node.answers_in_s is None


def test_a_late_answer_comes_after_the_client_gave_up() -> None:
    bench = Bench(manners={"sdo": [{"index": 0x60A9, "delay_s": 0.7, "times": 1}]})
    assert bench.sdo(upload(0x60A9)) == []
    bench.wait(300)
    bench.sdo(struct.pack("<BHBI", 0x80, 0x60A9, 0, 0x05040000))  # as a client does at its time-out
    assert bench.sdo(upload(0x6076)) == [], "a busy drive reads its mailbox afterwards"
    assert [data[1:4] for _, data in bench.wait(400)] == [b"\xa9\x60\0", b"\x76\x60\0"]
    assert bench.read(0x60A9) == 0x00B50300, "slow once"


def test_late_abort() -> None:
    bench = Bench(manners={"sdo": [{"index": 0x6502, "delay_s": 0.7, "abort": 0x05040000}]})
    assert bench.sdo(upload(0x6502)) == []
    assert bench.wait(700) == [(0x585, struct.pack("<BHBI", 0x80, 0x6502, 0, 0x05040000))]


def test_aborts_of_choice_and_silence() -> None:
    manners = [
        {"index": 0x6007, "access": "write", "abort": 0x08000020},
        {"index": 0x1016, "subindex": 1, "is_silent": True},
        {"index": 0x60C2, "subindex": 2, "access": "write", "abort": 0x08000022, "times": 2},
    ]
    bench = Bench(manners={"sdo": manners})
    assert bench.try_write(0x6007, 0, "h", 3) == 0x08000020
    assert bench.read(0x6007, 0, "h") == 1, "the write had no effect"
    assert bench.sdo(upload(0x1016, 1)) == []
    assert bench.read(0x1016, 0, "B") == 2
    assert [bench.try_write(0x60C2, 2, "b", -3) for _ in range(3)] == [0x08000022, 0x08000022, 0]


def test_reset_forgets_late_answers() -> None:
    bench = Bench(manners={"sdo_delay_s": 0.05})
    bench.sdo(upload(0x1000))
    bench.nmt(0x82)
    assert bench.wait(100) == []


# Units and direction


def speed_in(unit: str | None, increments: int, **bench: Any) -> tuple[Bench, float]:
    """Run in csv at a velocity in the drive's unit; return the velocity reached, rad/s."""
    made = Bench(PLAIN, manners={"velocity_unit": unit, **bench})
    made.stream(9)
    for _ in range(200):
        made.send(0x205, struct.pack("<Hih", 0x0F, increments, 0))
        made.sync()
    assert made.read(0x606C, 0, "i") == pytest.approx(increments, rel=0.02, abs=1.5)
    assert made.read(0x606B, 0, "i") == pytest.approx(increments, rel=0.02, abs=1.5)
    return made, made.servo.true_velocity


@pytest.mark.parametrize(
    ("unit", "increments", "code"),
    [
        ("rpm", 60, 0x00B44700),
        ("0.1 rpm", 600, 0xFFB44700),
        ("0.001 rpm", 60_000, 0xFDB44700),
        ("rad/s", 6, 0x00100300),
        ("0.01 deg/s", 36_000, 0xFE410300),
        ("rev/s", 1, 0x00B40300),
        ("counts/s", 1_048_576, 0x00B50300),
        (None, 1_048_576, 0x00B50300),
    ],
)
def test_velocity_unit(unit: str | None, increments: int, code: int) -> None:
    bench, speed = speed_in(unit, increments)
    assert speed == pytest.approx(6.28, rel=0.05)
    assert bench.read(0x60A9) == code


def test_velocity_unit_may_be_told_wrongly() -> None:
    bench, speed = speed_in("rpm", 60, values=[{"index": 0x60A9, "value": 0x00B50300}])
    assert speed == pytest.approx(6.28, rel=0.05)
    assert bench.read(0x60A9) == 0x00B50300


def test_quick_stop_ramp_is_the_same_in_every_unit() -> None:
    ways = []
    for unit, increments in (("counts/s", 1_048_576), ("rpm", 60)):
        bench, _ = speed_in(unit, increments)
        bench.write(0x6040, 0, "H", 0x02)
        start = bench.servo.true_position
        bench.sync(200)
        ways.append(bench.servo.true_position - start)
    assert ways[1] == pytest.approx(ways[0], rel=0.02)


@pytest.mark.parametrize("mode", [8, 9, 10])
def test_inverted_drive(mode: int) -> None:
    """Everything on the bus is as on the drive beside it, and the axis turns the other way."""
    turned, answers, errors = [], [], []
    for is_inverted in (False, True):
        bench = Bench(PLAIN, manners={"is_inverted": is_inverted})
        bench.stream(mode)
        for cycle in range(1, 101):
            target = {8: 500 * cycle, 9: 500_000, 10: 20}[mode]
            bench.send(0x205, struct.pack("<Hhh" if mode == 10 else "<Hih", 0x0F, target, 10))
            bench.sync()
        turned.append(bench.servo.true_position)
        answers.append(struct.unpack("<Hih", bench.sync()[0][1]))
        assert answers[-1][1] > 1000
        assert bench.read(0x606C, 0, "i") > 100_000
        errors.append(bench.read(0x60F4, 0, "i"))
    assert turned[0] == pytest.approx(-turned[1], rel=1e-3)
    assert errors[0] == pytest.approx(errors[1], abs=2)
    assert answers[0][1] == pytest.approx(answers[1][1], abs=2)
    assert answers[0][2] == pytest.approx(answers[1][2], abs=3)


@pytest.mark.parametrize(
    "manners",
    [{"velocity_unit": "knots"}, {"velocity_unit": "3 rpm"}, {"sdo": [{"index": 5}]}, {"sdo_delay_s": -1}],
)
def test_manners_are_checked(manners: dict[str, Any]) -> None:
    with pytest.raises(ValidationError):
        Bench(manners=manners)


@pytest.mark.parametrize("preset", [{"index": 0x6099, "value": 1}, {"index": 0x6007, "value": 40_000}])
def test_values_are_checked(preset: dict[str, int]) -> None:
    with pytest.raises(UsageError, match=r"simulation\.canopen\.values"):
        Bench(manners={"values": [preset]})
