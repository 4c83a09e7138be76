"""While drives are left, the daemon goes on being heard; a drive that may have power is not kept alive."""

import time

import pytest
from friction_hil_drivers.canopen.drives import CanopenDrives
from friction_hil_drivers.canopen.wire import cia301
from friction_hil_drivers.canopen.wire.exclusive import AxisLock

from friction_hil.drive import Command, DriveState, Feedback, Request
from friction_hil.errors import BusError
from tests.canopen_bench import Bench, BusClock, TimedBus
from tests.servo_drives import axis_dict, configuration

MASTER = 0x77E
FIRST, SECOND = 5, 6
HEARTBEAT_LOST, RPDO_LOST = "8130", "8250"
OFF = DriveState.SWITCH_ON_DISABLED


class Machine:
    """Two drives that have no power and watch the daemon; a lost connection is a fault without power too."""

    def __init__(self, *, answer_ms=15.0, missing=()):
        how = {"is_paced_by_sync": False, "missing": missing, "manners": {"faults_without_power": True}}
        self.benches = [Bench(number=number, **how) for number in (FIRST, SECOND)]
        self.bus = TimedBus(self.benches, 0.0)
        keys = {"mode": "cst", "controller": {"position_gain": 1.0, "velocity_gain": 0.1}}
        config = configuration(x=axis_dict(node=FIRST, **keys), y=axis_dict(node=SECOND, **keys))
        self.bus_config = config.bus
        self.drives = CanopenDrives(config, config.axes, BusClock(self.bus), dry_run=False, bus=self.bus)
        self.drives.connect()
        self.drives.start()
        self.bus.answer_ms = answer_ms
        self.feedback = [Feedback(), Feedback()]

    def cycle(self, request, count=20):
        for _ in range(count):
            self.bus.pass_until(self.bus.now_ms + 1.0)
            self.drives.receive(self.feedback, round(1e6 * self.bus.now_ms) + 1_000_000)
            self.drives.send([Command(request), Command(request)])

    def heartbeats(self, since_ms):
        return [now for now, can_id, _ in self.bus.sent if can_id == MASTER and now >= since_ms]

    def errors(self):
        """Emergencies of each drive."""
        return [set(bench.emergencies) for bench in self.benches]

    def leave(self):
        """Close the drives; they are left off, restored and without an error, and nothing watches the daemon."""
        states = self.drives.close()
        assert (states, self.drives.leftovers, self.errors()) == ([OFF] * 2, [], [set(), set()])
        self.assert_left()

    def assert_left(self):
        for bench in self.benches:
            assert bench.node.drive.state is OFF
            assert watched_nodes(bench) == []
            AxisLock(self.bus_config, bench.node.number, "another daemon").release()


@pytest.fixture
def machine(request):
    one = Machine(**getattr(request, "param", {}))
    yield one
    one.bus.shutdown()
    one.drives._bus = None  # a test that has not closed the drives leaves their locks
    one.drives.close()


@pytest.fixture
def driven(machine):
    """Drives that had power, and were disabled."""
    machine.cycle(Request.ENABLE)
    machine.cycle(Request.DISABLE)
    return machine


watched = pytest.mark.parametrize("machine", [{}, {"missing": (0x1016,)}], indirect=True, ids=["heartbeat", "guarding"])


@pytest.fixture
def in_time_of_the_bus(machine, monkeypatch):
    """The leaving takes its time from the bus, so that seconds of silence take none; it goes on where it was."""
    begin_s = time.monotonic() - 1e-3 * machine.bus.now_ms
    monkeypatch.setattr(time, "monotonic", lambda: begin_s + 1e-3 * machine.bus.now_ms)


def watched_nodes(bench):
    """The nodes whose heartbeats a drive watches (1016h)."""
    dictionary = bench.node.dictionary
    entries = [dictionary.at(0x1016, number).value for number in range(1, dictionary.at(0x1016, 0).value + 1)]
    return [entry >> 16 & 0x7F for entry in entries if entry >> 16 & 0x7F and entry & 0xFFFF]


@watched
def test_slow_drives_are_left_without_an_error(driven):
    """Restoring takes seconds here; heartbeat, guarding and RPDO timer are 60 ms, 60 ms and 20 ms."""
    began = driven.bus.now_ms
    driven.leave()
    assert driven.bus.now_ms - began > 500.0
    for bench in driven.benches:
        bench.at(driven.bus.now_ms + 1000.0)
    assert driven.errors() == [set(), set()], "nothing watches a daemon that has gone"


@pytest.mark.parametrize("request_at_last", [Request.ENABLE, Request.DISABLE])
def test_a_drive_that_may_have_power_is_not_kept_alive(machine, in_time_of_the_bus, request_at_last):
    machine.cycle(Request.ENABLE)
    machine.bus.gone = {SECOND} if request_at_last is Request.ENABLE else set()
    machine.cycle(request_at_last)
    machine.bus.gone = {SECOND}
    began = machine.bus.now_ms
    first, second = machine.drives.close()
    assert not first.is_powered
    assert second is DriveState.UNKNOWN
    left = max(now for now, can_id, data in machine.bus.sent if (can_id, data) == (0, bytes([0x80, SECOND])))
    assert [now for now in machine.heartbeats(began) if now > left] == [], "it has not answered"
    if request_at_last is Request.ENABLE:
        assert machine.heartbeats(began) == [], "the drives had power when they were heard last"


def test_a_command_that_cannot_be_sent_does_not_keep_drives_from_being_restored(driven):
    driven.bus.refused = [(0, bytes([cia301.NmtCommand.ENTER_PRE_OPERATIONAL, FIRST]))]
    with pytest.raises(BusError, match="the interface is down"):
        driven.drives.close()
    assert driven.drives.leftovers == []
    driven.assert_left()


def test_the_watch_begins_with_the_first_command(machine):
    """A drive watches from the first heartbeat on; none is sent while the loop only listens and may pause."""
    machine.cycle(Request.LISTEN, 100)
    machine.bus.pass_until(machine.bus.now_ms + 500.0)
    assert (machine.heartbeats(0.0), machine.errors()) == ([], [set(), set()])
    machine.cycle(Request.ENABLE)
    assert [each.state for each in machine.feedback] == [DriveState.OPERATION_ENABLED] * 2
    machine.bus.pass_until(machine.bus.now_ms + 100.0)
    assert all(errors & {HEARTBEAT_LOST, RPDO_LOST} for errors in machine.errors()), "now they do"


def test_drives_that_are_gone_are_asked_at_the_same_time(machine, in_time_of_the_bus):
    machine.cycle(Request.ENABLE)
    machine.bus.gone = {FIRST, SECOND}
    asked = len(machine.bus.sent)
    assert machine.drives.close() == [DriveState.UNKNOWN] * 2
    sent = machine.bus.sent[asked:]
    commands = [can_id for _, can_id, data in sent if can_id in (0x605, 0x606) and data[1:3] == b"\x40\x60"]
    assert commands[:2] == [0x605, 0x606], "the second one does not wait for the first"
    assert machine.heartbeats(0.0)[-1] <= sent[0][0]


@watched
@pytest.mark.parametrize("answer_ms", [500.0, 2900.0, 60_000.0])
def test_a_drive_has_as_long_to_answer_at_the_end_as_at_the_beginning(in_time_of_the_bus, driven, answer_ms):
    """Its watchdogs are fed meanwhile. If it does not tell its state by SDO, that of the last TPDO counts."""
    driven.bus.slow = {0x6041: answer_ms}
    driven.leave()


def test_the_state_of_a_tpdo_that_is_not_of_the_last_cycle_does_not_count(in_time_of_the_bus, driven):
    driven.bus.lost = range(0x180, 0x580)
    driven.cycle(Request.DISABLE, 1)
    driven.bus.slow = {0x6041: 600_000.0}  # longer than anybody waits
    assert driven.drives.close() == [DriveState.UNKNOWN] * 2
    assert all("its state" in text or "does not answer" in text for text in driven.drives.leftovers)
