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
