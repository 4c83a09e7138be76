"""Two drives with one number, on a bus that hands every frame to both."""

import random

import can
import pytest
from friction_hil_drivers.canopen.commands.inventory import CanopenInventory
from friction_hil_drivers.canopen.wire.frames import FrameBus

from friction_hil.drive import Request
from friction_hil.errors import DriveError
from tests.canopen_bench import NODE, Bench, BenchBus, Driven
from tests.messages import codes_in
from tests.servo_drives import axis_dict, configuration

UPLOAD, BOOT_UP = 0x40, (0x700 + NODE, b"\x00")
POLL = bytes.fromhex("4041600000000000")


class TwinBus(BenchBus):
    """A bus with two drives; the answers of the second come after ``late`` further frames of the first."""

    def __init__(self, second=None, *, late=0):
        super().__init__(Bench())
        self.second = second
        self.late, self.waiting = late, []

    def send(self, msg, timeout=None):
        super().send(msg, timeout)
        if self.second is None:
            return
        self.waiting.append(self.second.send(msg.arbitration_id, bytes(msg.data)))
        while len(self.waiting) > self.late:
            for can_id, data in self.waiting.pop(0):
                self.answers.put(can.Message(arbitration_id=can_id, data=data, is_extended_id=False))


class DoublingBus(BenchBus):
    """A bus, or a gateway, that delivers a share of all frames of the drive twice."""

    def __init__(self, share):
        super().__init__(Bench())
        numbers = random.Random(3)
        put = self.answers.put

        def doubled(message):
            put(message)
            if numbers.random() < share:
                put(message)

        self.answers.put = doubled


class PolledBus(BenchBus):
    """A bus on which a PLC reads by SDO: ``first`` of its requests wait already, and one comes after each of ours."""

    def __init__(self, first=0, *, later=0):
        super().__init__(Bench())
        self.later = later
        for _ in range(first):
            self.poll()

    def poll(self):
        self.answers.put(can.Message(arbitration_id=0x600 + NODE, data=POLL, is_extended_id=False))

    def send(self, msg, timeout=None):
        super().send(msg, timeout)
        if self.later and len(self.sent) >= self.later:
            self.poll()


def inventory(bus, **options):
    config = configuration(x=axis_dict(node=NODE))
    return CanopenInventory(config.bus, FrameBus(bus, "bench"), **options)


def is_reading(can_id, data):
    """An upload, the next segment of one, or an abort."""
    return can_id == 0x600 + NODE and data[0] & 0xE0 in (UPLOAD, 0x60, 0x80)


@pytest.mark.parametrize("dry_run", [False, True])
@pytest.mark.parametrize("late", [0, 1, 3])
def test_two_equal_drives_are_refused_before_anything_is_written(dry_run, late):
    bus = TwinBus(Bench(), late=late)
    with pytest.raises(DriveError, match=r"FH-264"), Driven(bus=bus, dry_run=dry_run):
        pass
    assert all(is_reading(*frame) for frame in bus.sent)


@pytest.mark.parametrize(
    ("second", "difference"),
    [
        ({"missing": [0x1018]}, r"1018h:01 vendor ID is 0x\w+ and refused \(06020000h\)"),
        ({"serial": 77}, r"1018h:04 serial number is 0x\w+ and 0x4d"),
    ],
)
def test_drives_that_differ_are_called_two(second, difference):
    serial = second.pop("serial", None)
    bus = TwinBus(Bench(**second))
    if serial is not None:
        bus.second.node.dictionary.change(0x1018, 4, serial)
    with pytest.raises(DriveError, match=rf"{difference}; .*FH-264"), Driven(bus=bus):
        pass
    assert all(is_reading(*frame) for frame in bus.sent)


@pytest.mark.parametrize("share", [0.0, 0.2, 0.4])
def test_a_bus_that_doubles_some_frames_is_none_with_two_drives(share):
    with Driven(bus=DoublingBus(share)) as driven:
        for _ in range(200):
            assert driven.cycle(Request.LISTEN).message == ""


def test_a_gateway_that_doubles_every_frame_is_refused_and_named():
    with pytest.raises(DriveError, match=r"gateway repeats"), Driven(bus=DoublingBus(1.0)):
        pass


def test_a_second_drive_that_is_plugged_in_in_mid_run_is_a_fault():
    """It is set up as the first, from the run before, and was switched on elsewhere: no boot-up message is heard."""
    bus = TwinBus()
    driven = Driven(bus=bus).start()
    assert driven.cycle(count=20).message == ""
    second = Bench()
    for frame in bus.sent:
        second.send(*frame)
    bus.second = second
    messages = [driven.cycle().message for _ in range(25)]
    assert messages[0] == ""
    assert "of node 5 comes twice in each cycle: two nodes have this number" in messages[-1]
    bus.second = None
    driven.close()


def test_a_second_drive_that_is_switched_on_in_mid_run_ends_it_and_the_first_is_stopped_by_its_rpdos():
    bus = TwinBus()
    driven = Driven(bus=bus).start()
    driven.cycle(count=20)
    bus.second = Bench()
    bus.answers.put(can.Message(arbitration_id=BOOT_UP[0], data=BOOT_UP[1], is_extended_id=False))
    feedback = driven.cycle()
    assert codes_in(feedback.message) == "FH-231"
    assert any("[FH-264]" in text for text in feedback.notices)
    assert feedback.is_reachable
    assert feedback.state.is_powered
    assert not driven.cycle(Request.DISABLE, 300).state.is_powered
    driven.close()


def test_scan_and_show_name_two_drives_and_a_stop_proves_nothing():
    bus = TwinBus(Bench())
    found = inventory(bus)
    [entry] = found.scan().drives
    assert (entry.node, entry.answers) == (NODE, True)
    assert "two nodes answer as node 5" in entry.problem
    with pytest.raises(DriveError, match=r"FH-264"):
        found.show(NODE)
    assert all(data[0] & 0xE0 in (UPLOAD, 0x60, 0x80) for _, data in bus.sent)
    with pytest.raises(DriveError, match=r"FH-264"):
        found.reset_axes({"x": (NODE, 0)})
    assert isinstance(found.meet([NODE])[NODE], DriveError)
    [stop] = found.stop([NODE])
    found.close()
    assert not stop.is_proved
    assert "two nodes answer as node 5" in stop.detail


def test_one_drive_is_one():
    bus = BenchBus(Bench())
    found = inventory(bus)
    [entry] = found.scan().drives
    assert (entry.node, entry.problem) == (NODE, "")
    assert found.meet([NODE, NODE + 1]) == {NODE: None}
    [stop] = found.stop([NODE])
    found.close()
    assert stop.is_proved


def test_a_node_whose_sdo_another_master_uses_is_not_read_without_the_users_word():
    bus = PolledBus(2)
    found = inventory(bus)
    for read in (found.scan, lambda: found.show(NODE)):
        with pytest.raises(DriveError, match=r"--may-disturb.*\[FH-265\]"):
            read()
    assert found.meet([NODE]) == {}
    assert bus.sent == []
    assert any("may fail while nodes are asked here" in note for note in found.notes)
    [stop] = found.stop([NODE])  # a stop comes first
    found.close()
    assert stop.is_proved
    bus = PolledBus(2)
    found = inventory(bus, may_disturb=True)
    assert found.show(NODE)["node"] == NODE
    found.close()


def test_reading_ends_with_the_first_request_of_another_master():
    bus = PolledBus(later=3)
    found = inventory(bus)
    with pytest.raises(DriveError, match=r"FH-265"):
        found.show(NODE)
    found.close()
    assert len(bus.sent) <= 4


@pytest.mark.parametrize("polled", [{"first": 2}, {"later": 3}])
def test_a_dry_run_does_not_read_what_another_master_reads(polled):
    bus = PolledBus(**polled)
    with pytest.raises(DriveError, match=r"bus.role: sidecar.* \[FH-265\]"), Driven(bus=bus, dry_run=True):
        pass
    assert len(bus.sent) <= 4
    assert all(is_reading(*frame) for frame in bus.sent)


def test_a_wrong_number_is_answered_with_those_that_exist():
    bus = BenchBus(Bench())
    driven = Driven(bus=bus, node=NODE + 2)
    with pytest.raises(DriveError, match=rf"nodes that answer: {NODE} \[FH-206\]"):
        driven.start()
    driven.drives.close()
    found = inventory(bus)
    with pytest.raises(DriveError, match=rf"node 7 .* answers no SDO request; nodes that answer: {NODE} \[FH-244\]"):
        found.show(NODE + 2)
    found.close()
