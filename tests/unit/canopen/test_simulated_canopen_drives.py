"""Several simulated drives in one loop, on python-can's virtual bus within this process."""

import itertools
from collections.abc import Callable, Iterator
from typing import Any

import can
import pytest
from friction_hil_drivers.canopen.simulated import SimulatedCanopenDrives

from friction_hil.config import from_dict
from friction_hil.errors import UsageError

_channels = itertools.count()
MODEL = {"axis": "rotary", "friction": {"model": "coulomb", "parameters": {"coulomb": 0.1}}}
AXIS = {"driver": "canopen", "mode": "csp", "limits": {"torque": 0.3, "velocity": 100.0}, "model": MODEL}


class Drives:
    """Drives of two axes, and a listener."""

    def __init__(self, pace: Any, simulation: Any = None, period_s: float = 1e-3) -> None:
        bus = {"interface": "virtual", "channel": f"simulated-{next(_channels)}"}
        axis = AXIS | {"trajectory": {"kind": "hold"}, "simulation": simulation or {}}
        data = {"version": 1, "period_s": period_s, "bus": bus, "realtime": {"spin_us": 0}}
        configuration = from_dict(data | {"axes": {"a": axis | {"node": 3}, "b": axis | {"node": 4}}}, "test")
        self.bus = can.Bus(**bus)
        self.drives = SimulatedCanopenDrives(configuration, configuration.axes, pace=pace)

    def send(self, can_id: int, data: str = "", **flags: Any) -> None:
        self.bus.send(can.Message(arbitration_id=can_id, data=bytes.fromhex(data), is_extended_id=False, **flags))

    def run(self, passes: int) -> list[tuple[int, str]]:
        """Let the loop pass; return what was heard."""
        count = itertools.count()
        self.drives.run(lambda: next(count) >= passes)
        return self.heard()

    def heard(self) -> list[tuple[int, str]]:
        return [(message.arbitration_id, message.data.hex()) for message in iter(lambda: self.bus.recv(0.0), None)]


@pytest.fixture
def make() -> Iterator[Callable[..., Drives]]:
    made: list[Drives] = []
    yield lambda *what, **how: made.append(Drives(*what, **how)) or made[-1]  # type: ignore[func-returns-value]
    for one in made:
        one.drives.close()
        one.drives.close()
        one.bus.shutdown()


@pytest.mark.parametrize("pace", ["real", "sync"])
def test_all_nodes_answer_a_sync_in_order_and_a_remote_frame_reaches_its_node(make: Any, pace: str) -> None:
    one = make(pace)
    assert one.drives.open().startswith("a=node 3, b=node 4 on virtual simulated-")
    assert one.run(1) == [(0x703, "00"), (0x704, "00")]
    one.send(0x704, is_remote_frame=True, dlc=1)
    for node in (3, 4):
        one.send(0x600 + node, "2f00180201000000")
    one.send(0x000, "0100")
    one.send(0x080)
    written = [(0x583, "6000180200000000"), (0x584, "6000180200000000")]
    assert one.run(5) == [(0x704, "7f"), *written, (0x183, "5002"), (0x184, "5002")]


def test_period_must_fit_the_integration(make: Any) -> None:
    with pytest.raises(UsageError, match="whole number of integration steps"):
        make("sync", period_s=1.2345e-4).drives.open()


def test_drive_is_what_the_configuration_says(make: Any) -> None:
    identity = {"vendor_id": 7, "product_code": 8, "revision": 9, "serial": 10}
    one = make("sync", {"canopen": {**identity, "supported_modes": ["cst"], "missing": [0x60B2]}})
    one.drives.open()
    for request in (*(f"401810{subindex:02x}" for subindex in (1, 2, 3, 4)), "40026500", "40b26000"):
        one.send(0x603, f"{request}00000000")
    answers = [data for can_id, data in one.run(6) if can_id == 0x583]
    assert [answer[8:10] for answer in answers[:4]] == ["07", "08", "09", "0a"]
    assert answers[4:] == ["4302650000020000", "80b2600000000206"]
