"""A node with two axes (CiA 402-2): objects from 6800h and PDOs from 1440h belong to the second."""

import struct

import pytest
from friction_hil_drivers.canopen.drives import CanopenDrives
from friction_hil_drivers.canopen.sdo.conversation import Conversation
from friction_hil_drivers.canopen.stop.by_sdo import stop_drive
from friction_hil_drivers.canopen.wire.frames import FrameBus

from friction_hil.daemon.realtime import SteppedClock
from friction_hil.drive import Command, DriveState, Feedback, Request
from friction_hil.errors import ConfigurationError
from tests.canopen_bench import NODE, SDO_REQUEST, Bench, BenchBus
from tests.servo_drives import axis_dict, configuration
from tests.vendor_drives import VendorDrive

OWN_OF_NODE = range(0x700, 0x780)  # heartbeats
CONTROLLER = {"position_gain": 1.0, "velocity_gain": 0.1}
RECORDS = (0x1400, 0x1600, 0x1800, 0x1A00)


def is_of_second(index: int) -> bool:
    return 0x6800 <= index < 0x7000 or any(base + 64 <= index < base + 128 for base in RECORDS)


def moved(index: int, sign: int) -> int:
    """The index on the other axis."""
    return index + sign * (0x800 if index >= 0x6000 else 64)


def translate(data: bytes, sign: int) -> bytes:
    """An SDO frame for the other axis; mapping words in it name that axis's objects too."""
    index, subindex = struct.unpack_from("<HB", data, 1)
    content = data[4:]
    is_mapping = index & 0xFF00 in (0x1600, 0x1A00) and subindex and data[0] != 0x80
    word = struct.unpack("<I", content)[0]
    if is_mapping and word >> 16 >= 0x6000:
        content = struct.pack("<I", word + sign * 0x0800_0000)
    return data[:1] + struct.pack("<HB", moved(index, sign), subindex) + content


class TwoAxes(BenchBus):
    """One node made of two simulated drives."""

    def __init__(self, second_eds):
        super().__init__()
        self.second = Bench(eds=second_eds)

    def answers_of(self, can_id, data):
        if can_id == SDO_REQUEST and is_of_second(struct.unpack_from("<H", data, 1)[0]):
            return [(i, translate(d, +1)) for i, d in self.second.send(can_id, translate(data, -1))]
        others = [] if can_id == SDO_REQUEST else self.second.send(can_id, data)
        return [*self.bench.send(can_id, data), *(frame for frame in others if frame[0] not in OWN_OF_NODE)]


@pytest.fixture
def bus(tmp_path):
    # as delivered, the PDOs of the second axis have no identifier
    values = {(f"{base + n:X}sub1", "DefaultValue"): "0x80000000" for base in (0x1400, 0x1800) for n in range(4)}
    one = TwoAxes(VendorDrive(values=values).write(tmp_path / "second.eds"))
    yield one
    one.shutdown()


def test_two_axes_of_a_node_are_driven_independently(bus):
    keys = {"node": NODE, "mode": "cst", "controller": CONTROLLER, "is_watchdog_required": False}
    config = configuration(x=axis_dict(**keys), y=axis_dict(**keys, axis_number=1))
    clock = SteppedClock()
    drives = CanopenDrives(config, config.axes, clock, dry_run=False, bus=bus)
    benches, feedback = (bus.bench, bus.second), [Feedback(), Feedback()]

    def cycle(*torques, request=Request.ENABLE, count=20):
        for _ in range(count):
            clock.sleep_until(clock.now_ns() + 1_000_000)
            drives.receive(feedback, 0)
            drives.send([Command(request, torque=torque) for torque in torques])

    try:
        assert [one.name for one in drives.connect()] == ["x", "y"]
        assert bus.second.read(0x6060, 0, "b") == 10
        drives.start()
        cycle(0.0, 0.0)
        assert [one.state for one in feedback] == [DriveState.OPERATION_ENABLED] * 2
        cycle(0.3, -0.2)
        assert [one.torque for one in feedback] == pytest.approx([0.3, -0.2], abs=5e-3)
        assert [one.position for one in feedback] == pytest.approx([one.servo.position for one in benches], abs=0.05)
        assert feedback[0].velocity > 0.0 > feedback[1].velocity
        cycle(0.0, 0.0, request=Request.DISABLE, count=300)
        assert not any(one.state.is_powered for one in feedback)
    finally:
        drives.close()
    assert [bench.statusword & 0x6F for bench in benches] == [0x40, 0x40]


def test_each_axis_of_a_node_is_configured_once():
    one = axis_dict(node=NODE, axis_number=1)
    with pytest.raises(ConfigurationError, match=r"node 5 \(axis_number 1\) is axis 'x' already"):
        configuration(x=one, y=one)


def test_stopping_a_node_stops_both_of_its_axes(bus):
    """As ``friction-hil drives stop`` does: by SDO, the second axis by its own controlword 6840h."""
    for bench in (bus.bench, bus.second):
        bench.nmt(0x01)
        bench.enable(9)
        bench.write(0x60FF, 0, "i", 20_000)
        bench.sync(50)
    talk = Conversation(FrameBus(bus, "two axes"), answer_s=0.5, attempts=2)
    first, second = talk.hold({NODE: stop_drive(NODE)})[NODE]
    assert (first.result, first.detail) == ("stopped", "")
    assert second.result == "stopped"
    assert second.detail.startswith("axis 2")
    for bench in (bus.bench, bus.second):
        assert bench.statusword & 0x6F == 0x40
    written = {struct.unpack_from("<H", data, 1)[0] for _, data in bus.sent if data[0] >> 5 == 1}
    assert written == {0x6040, 0x6840, 0x60FF, 0x68FF}, "and of each the velocity that it was given"
