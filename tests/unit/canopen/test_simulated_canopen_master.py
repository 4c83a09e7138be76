"""A master that is not ours: the canopen library reads, maps, enables and moves a simulated drive.

Its bus is wired to the node directly, so every answer is there before it is waited for: no thread, no clock.
"""

from collections.abc import Iterator
from typing import Any

import can
import canopen
import pytest
from canopen.profiles.p402 import BaseNode402
from friction_hil_drivers.canopen.connect.eds import SIMULATED_SERVO

from friction_hil.drive import DriveState
from tests.canopen_bench import NODE, PLAIN, Bench


class Wire(can.BusABC):
    """Hands every frame of the master to the node, and every frame of the node to the master."""

    def __init__(self, network: canopen.Network, bench: Bench) -> None:
        super().__init__(channel="wire")
        self.network, self.bench = network, bench
        self.delivered = len(bench.sent)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        self.bench.send(msg.arbitration_id, bytes(msg.data))
        while self.delivered < len(self.bench.sent):
            can_id, data = self.bench.sent[self.delivered]
            self.delivered += 1
            self.network.notify(can_id, bytearray(data), 0.0)


@pytest.fixture
def master() -> Iterator[Any]:
    network = canopen.Network()
    bench = Bench(PLAIN)
    network.bus = Wire(network, bench)
    node = BaseNode402(NODE, str(SIMULATED_SERVO))
    network.add_node(node)
    node.sdo.RESPONSE_TIMEOUT = 60.0
    node.bench = bench
    yield node
    network.bus.shutdown()


def test_library_reads_the_whole_dictionary(master: Any) -> None:
    count = 0
    for index, known in master.object_dictionary.items():
        if index < 0x1000:
            continue
        item = master.sdo[index]
        for entry in [item] if isinstance(item, canopen.sdo.SdoVariable) else [item[s] for s in known]:
            if index == 0x1003 and entry.od.subindex:
                with pytest.raises(canopen.SdoAbortedError) as info:
                    _ = entry.raw
                assert info.value.code == 0x08000024
                continue
            value = entry.raw
            count += 1
            if entry.od.access_type == "const" and entry.od.default is not None:
                assert value == entry.od.default
            if entry.od.writable and not 0x1400 <= index < 0x1C00:
                entry.raw = value
    assert count > 150


def test_library_maps_and_the_drive_obeys(master: Any) -> None:
    master.nmt.state = "PRE-OPERATIONAL"
    master.tpdo.read()
    master.rpdo.read()
    for pdo, names in ((master.rpdo[1], (0x6040, 0x607A, 0x60B2)), (master.tpdo[1], (0x6041, 0x6064, 0x6077))):
        pdo.clear()
        for name in names:
            pdo.add_variable(name)
        pdo.trans_type = 1
        pdo.enabled = True
        pdo.save()
    master.nmt.state = "OPERATIONAL"
    master.sdo[0x6060].raw = 8
    start = master.sdo[0x6064].raw
    for word, target in [(0x06, 0), (0x07, 0), *((0x0F, 50 * cycle) for cycle in range(200))]:
        master.rpdo[1][0x6040].raw = word
        master.rpdo[1][0x607A].raw = start + target
        master.rpdo[1].transmit()
        master.network.sync.transmit()
    assert master.tpdo[1][0x6041].raw & 0x6F == 0x27
    assert master.tpdo[1][0x6064].raw == pytest.approx(start + 50 * 199, abs=200)


def test_library_s_state_machine_enables_and_resets(master: Any) -> None:
    master.nmt.state = "PRE-OPERATIONAL"
    master.setup_402_state_machine()
    master.nmt.state = "OPERATIONAL"
    master.op_mode = "CYCLIC SYNCHRONOUS TORQUE"
    master.state = "OPERATION ENABLED"
    assert master.bench.node.drive.state is DriveState.OPERATION_ENABLED
    assert master.op_mode == "CYCLIC SYNCHRONOUS TORQUE"
    master.state = "SWITCHED ON"
    assert master.bench.node.drive.state is DriveState.SWITCHED_ON
    master.state = "OPERATION ENABLED"
    emergencies: list[Any] = []
    master.emcy.add_callback(emergencies.append)
    master.rpdo[1].stop()
    master.nmt.state = "PRE-OPERATIONAL"
    assert [error.code for error in emergencies] == [0x8100]
    master.nmt.state = "OPERATIONAL"
    master.network.sync.transmit()
    assert master.state == "FAULT"
    master.controlword = 0x80
    assert master.state == "SWITCH ON DISABLED"
