"""Several simulated drives in one loop, on python-can's virtual bus within this process."""

import itertools
from collections.abc import Callable
from typing import Any

import can
import pytest
from friction_hil_drivers.canopen.simulated import SimulatedCanopenDrives

from friction_hil.config import from_dict
from friction_hil.errors import UsageError

_channels = itertools.count()


def drives_on_a_bus(pace: Any, simulation: Any = None, period_s: float = 1e-3) -> tuple[SimulatedCanopenDrives, Any]:
    """Make two axes and a listener."""
    channel = f"simulated-{next(_channels)}"
    axis = {
        "driver": "canopen",
        "mode": "csp",
        "limits": {"torque": 0.3, "velocity": 100.0},
        "model": {"axis": "rotary", "friction": {"model": "coulomb", "parameters": {"coulomb": 0.1}}},
        "trajectory": {"kind": "hold"},
        "simulation": simulation or {},
    }
    configuration = from_dict(
        {
            "version": 1,
            "period_s": period_s,
            "bus": {"interface": "virtual", "channel": channel},
            "axes": {"a": {**axis, "node": 3}, "b": {**axis, "node": 4}},
            "realtime": {"spin_us": 0},
        },
        "test",
    )
    listener = can.Bus(interface="virtual", channel=channel)
    return SimulatedCanopenDrives(configuration, configuration.axes, pace=pace), listener


def after(passes: int) -> Callable[[], bool]:
    """End after so many passes of the loop."""
    count = itertools.count()
    return lambda: next(count) >= passes


def frames(listener: Any) -> list[tuple[int, str]]:
    found = []
    while (message := listener.recv(0.0)) is not None:
        found.append((message.arbitration_id, bytes(message.data).hex()))
    return found


def send(listener: Any, can_id: int, data: str = "") -> None:
    listener.send(can.Message(arbitration_id=can_id, data=bytes.fromhex(data), is_extended_id=False))


@pytest.mark.parametrize("pace", ["real", "sync"])
def test_all_nodes_answer_a_sync_in_order(pace: str) -> None:
    drives, listener = drives_on_a_bus(pace)
    try:
        assert drives.open().startswith("a=node 3, b=node 4 on virtual simulated-")
        assert frames(listener) == [(0x703, "00"), (0x704, "00")]
        for node in (3, 4):
            send(listener, 0x600 + node, "2f00180201000000")
        send(listener, 0x000, "0100")
        send(listener, 0x080)
        drives.run(after(4))
        assert frames(listener) == [
            (0x583, "6000180200000000"),
            (0x584, "6000180200000000"),
            (0x183, "5002"),
            (0x184, "5002"),
        ]
    finally:
        drives.close()
        drives.close()
        listener.shutdown()


def test_without_sync_no_time_passes() -> None:
    drives, listener = drives_on_a_bus("sync")
    try:
        drives.open()
        send(listener, 0x603, "2b17100002000000")
        send(listener, 0x080)
        send(listener, 0x080)
        for _ in range(5):
            send(listener, 0x300)
        drives.run(after(8))
        assert frames(listener)[2:] == [(0x583, "6017100000000000"), (0x703, "7f")]
    finally:
        drives.close()
        listener.shutdown()


def test_period_must_fit_the_integration() -> None:
    drives, listener = drives_on_a_bus("sync", period_s=1.2345e-4)
    with pytest.raises(UsageError, match="whole number of integration steps"):
        drives.open()
    listener.shutdown()


def test_drive_is_what_the_configuration_says() -> None:
    shown = {
        "vendor_id": 7,
        "product_code": 8,
        "revision": 9,
        "serial": 10,
        "supported_modes": ["cst"],
        "missing": [0x60B2],
    }
    drives, listener = drives_on_a_bus("sync", {"canopen": shown})
    try:
        drives.open()
        for subindex in (1, 2, 3, 4):
            send(listener, 0x603, f"401810{subindex:02x}00000000")
        send(listener, 0x603, "4002650000000000")
        send(listener, 0x603, "40b2600000000000")
        drives.run(after(6))
        answers = [data for can_id, data in frames(listener) if can_id == 0x583]
        assert [answer[8:10] for answer in answers[:4]] == ["07", "08", "09", "0a"]
        assert answers[4:] == ["4302650000020000", "80b2600000000206"]
    finally:
        drives.close()
        listener.shutdown()


@pytest.mark.parametrize("pace", ["real", "sync"])
def test_a_remote_frame_reaches_its_node(pace: str) -> None:
    drives, listener = drives_on_a_bus(pace)
    try:
        drives.open()
        listener.send(can.Message(arbitration_id=0x704, is_remote_frame=True, dlc=1, is_extended_id=False))
        send(listener, 0x603, "4000100000000000")
        drives.run(after(3))
        assert frames(listener)[2:] == [(0x704, "7f"), (0x583, "4300100092010200")]
    finally:
        drives.close()
        listener.shutdown()
