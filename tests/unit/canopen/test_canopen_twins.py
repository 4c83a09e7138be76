"""Two drives with one number, on a bus that hands every frame to both."""

import random

import pytest
from friction_hil_drivers.canopen.commands.inventory import CanopenInventory
from friction_hil_drivers.canopen.wire.frames import FrameBus

from friction_hil.drive import Request
from friction_hil.errors import DriveError
from tests.canopen_bench import NODE, SDO_REQUEST, Bench, BenchBus, Driven
from tests.messages import codes_in
from tests.servo_drives import axis_dict, configuration

POLL = bytes.fromhex("4041600000000000")


class TwinBus(BenchBus):
    """A bus with two drives; the answers of the second come after ``late`` further frames of the first."""

    def __init__(self, second=None, *, late=0):
        super().__init__()
        self.second, self.late, self.waiting = second, late, []

    def answers_of(self, can_id, data):
        answers = super().answers_of(can_id, data)
        if self.second is not None:
            self.waiting.append(self.second.send(can_id, data))
            while len(self.waiting) > self.late:
                answers += self.waiting.pop(0)
        return answers


class DoublingBus(BenchBus):
    """A bus, or a gateway, that delivers a share of all frames of the drive twice."""

    def __init__(self, share):
        super().__init__()
        self.share, self.numbers = share, random.Random(5)

    def answers_of(self, can_id, data):
        answers = super().answers_of(can_id, data)
        return [one for one in answers for _ in range(1 + (self.numbers.random() < self.share))]


class PolledBus(BenchBus):
    """A bus on which a PLC reads by SDO: ``first`` of its requests wait already, and one comes after each of ours."""

    def __init__(self, first=0, *, later=0):
        super().__init__()
        self.later = later
        for _ in range(first):
            self.hear(SDO_REQUEST, POLL)

    def send(self, msg, timeout=None):
        super().send(msg, timeout)
        if self.later and len(self.sent) >= self.later:
            self.hear(SDO_REQUEST, POLL)


@pytest.fixture
def inventory():
    """Make the inventory of a bus."""
    made = []

    def make(bus, **options):
        made.append(CanopenInventory(configuration(x=axis_dict(node=NODE)).bus, FrameBus(bus, "bench"), **options))
        return made[-1]

    yield make
    for one in made:
        one.close()


def only_read(bus):
    """Nothing was sent but uploads, next segments of them, and aborts."""
    return all(can_id & 0x780 == 0x600 and data[0] & 0xE0 in (0x40, 0x60, 0x80) for can_id, data in bus.sent)


@pytest.mark.parametrize("dry_run", [False, True])
@pytest.mark.parametrize("late", [0, 1, 3])
def test_two_equal_drives_are_refused_before_anything_is_written(dry_run, late):
    bus = TwinBus(Bench(), late=late)
    with pytest.raises(DriveError, match=r"FH-264"), Driven(bus=bus, dry_run=dry_run):
        pass
    assert only_read(bus)


@pytest.mark.parametrize(
    ("missing", "difference"),
    [
        ([0x1018], r"1018h:01 vendor ID is 0x\w+ and refused \(06020000h\)"),
        ([], r"1018h:04 serial number is 0x\w+ and 0x4d"),
    ],
)
def test_drives_that_differ_are_called_two(missing, difference):
    bus = TwinBus(Bench(missing=missing))
    if not missing:
        bus.second.node.dictionary.change(0x1018, 4, 77)
    with pytest.raises(DriveError, match=rf"{difference}; .*FH-264"), Driven(bus=bus):
        pass
    assert only_read(bus)


def test_a_bus_that_doubles_some_frames_is_none_with_two_drives_and_a_gateway_that_doubles_all_is_named():
    for share in (0.0, 0.2, 0.4):
        with Driven(bus=DoublingBus(share)) as driven:
            assert {driven.cycle(Request.LISTEN).message for _ in range(200)} == {""}, share
    with pytest.raises(DriveError, match=r"gateway repeats"), Driven(bus=DoublingBus(1.0)):
        pass


def test_a_second_drive_that_is_plugged_in_in_mid_run_is_a_fault():
    """It is set up as the first, from the run before, and was switched on elsewhere: no boot-up message is heard."""
    with Driven(bus=TwinBus()) as driven:
        assert driven.cycle(count=20).message == ""
        second = Bench()
        for frame in driven.bus.sent:
            second.send(*frame)
        driven.bus.second = second
        messages = [driven.cycle().message for _ in range(25)]
        assert messages[0] == ""
        assert "of node 5 comes twice in each cycle: two nodes have this number" in messages[-1]
        driven.bus.second = None


def test_a_second_drive_that_is_switched_on_in_mid_run_ends_it_and_the_first_is_stopped_by_its_rpdos():
    with Driven(bus=TwinBus()) as driven:
        driven.cycle(count=20)
        driven.bus.second = Bench()
        driven.bus.hear(0x700 + NODE, b"\x00")
        feedback = driven.cycle()
        assert codes_in(feedback.message) == "FH-231"
        assert any("[FH-264]" in text for text in feedback.notices)
        assert feedback.is_reachable
        assert feedback.state.is_powered
        assert not driven.cycle(Request.DISABLE, 300).state.is_powered


def test_scan_and_show_name_two_drives_and_a_stop_proves_nothing(inventory):
    bus = TwinBus(Bench())
    found = inventory(bus)
    [entry] = found.scan().drives
    assert (entry.node, entry.answers) == (NODE, True)
    assert "two nodes answer as node 5" in entry.problem
    with pytest.raises(DriveError, match=r"FH-264"):
        found.show(NODE)
    assert only_read(bus)
    with pytest.raises(DriveError, match=r"FH-264"):
        found.reset_axes({"x": (NODE, 0)})
    assert isinstance(found.meet([NODE])[NODE], DriveError)
    [stop] = found.stop([NODE])
    assert not stop.is_proved
    assert "two nodes answer as node 5" in stop.detail


def test_one_drive_is_one(inventory):
    found = inventory(BenchBus())
    [entry] = found.scan().drives
    assert (entry.node, entry.problem) == (NODE, "")
    assert found.meet([NODE, NODE + 1]) == {NODE: None}
    assert found.stop([NODE])[0].is_proved


def test_a_node_whose_sdo_another_master_uses_is_not_read_without_the_users_word(inventory):
    found = inventory(PolledBus(2))
    for read in (found.scan, lambda: found.show(NODE)):
        with pytest.raises(DriveError, match=r"--may-disturb.*\[FH-265\]"):
            read()
    assert found.meet([NODE]) == {}
    assert found._bus.bus.sent == []
    assert any("may fail while nodes are asked here" in note for note in found.notes)
    assert found.stop([NODE])[0].is_proved, "a stop comes first"
    assert inventory(PolledBus(2), may_disturb=True).show(NODE)["node"] == NODE


def test_reading_ends_with_the_first_request_of_another_master(inventory):
    bus = PolledBus(later=3)
    with pytest.raises(DriveError, match=r"FH-265"):
        inventory(bus).show(NODE)
    assert len(bus.sent) <= 4


@pytest.mark.parametrize("polled", [{"first": 2}, {"later": 3}])
def test_a_dry_run_does_not_read_what_another_master_reads(polled):
    bus = PolledBus(**polled)
    with pytest.raises(DriveError, match=r"bus.role: sidecar.* \[FH-265\]"), Driven(bus=bus, dry_run=True):
        pass
    assert len(bus.sent) <= 4
    assert only_read(bus)


def test_a_wrong_number_is_answered_with_those_that_exist(inventory):
    bus = BenchBus()
    with pytest.raises(DriveError, match=rf"nodes that answer: {NODE} \[FH-206\]"), Driven(bus=bus, node=NODE + 2):
        pass
    with pytest.raises(DriveError, match=rf"node 7 .*nodes that answer: {NODE} \[FH-244\]"):
        inventory(bus).show(NODE + 2)
