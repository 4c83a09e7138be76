"""Manners of simulated drives: what stacks and vendors do differently, each on the bench."""

import struct
from typing import Any

import pytest

from friction_hil.drive import DriveState
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
