"""Set-points that are not sent. A full send queue is a missed exchange: bridged, reported when it lasts."""

import errno

import can
import pytest
from friction_hil_drivers.canopen.drives import CanopenDrives

from friction_hil.daemon.realtime import SteppedClock
from friction_hil.drive import Command, DriveState, Feedback, Request
from tests.canopen_axis_bench import PRE_OPERATIONAL
from tests.canopen_bench import NODE, Bench, BenchBus
from tests.servo_drives import axis_dict, configuration

MAX_MISSED = 10  # by default
SYNC, RPDO1, RPDO4, HEARTBEAT = 0x080, 0x205, 0x505, 0x77E


class NarrowBus(BenchBus):
    """Refuses frames with ENOBUFS, as SocketCAN does."""

    refused = ()

    def send(self, msg, timeout=None):
        if msg.arbitration_id in self.refused:
            raise can.CanOperationError("Failed to transmit", errno.ENOBUFS)
        super().send(msg, timeout)

    def recv(self, timeout=None):
        if SYNC in self.refused and self.answers.empty():
            return None  # nobody waits for what cannot come
        return super().recv(timeout)


class Turning:
    """A drive in csv that turns."""

    def __init__(self):
        self.bench = Bench()
        self.bus = NarrowBus(self.bench)
        config = configuration(x=axis_dict(node=NODE, mode="csv"))
        self.clock = SteppedClock()
        self.drives = CanopenDrives(config, config.axes, self.clock, dry_run=False, bus=self.bus)
        self.drives.connect()
        self.drives.start()
        self.feedback, self.command = Feedback(), Command()
        self.cycle(Request.ENABLE, 100)
        assert self.feedback.velocity == pytest.approx(5.0, rel=0.2)

    def cycle(self, request, count=1, velocity=5.0):
        for _ in range(count):
            self.clock.sleep_until(self.clock.now_ns() + 1_000_000)
            self.drives.receive([self.feedback], 0)
            self.command.request, self.command.velocity = request, velocity
            self.drives.send([self.command])


@pytest.fixture
def turning():
    one = Turning()
    yield one
    one.bus.refused = ()
    one.drives.close()
    one.bus.shutdown()


@pytest.mark.parametrize("refused", [(RPDO1,), (RPDO4,), (HEARTBEAT,), (RPDO1, RPDO4, HEARTBEAT)])
def test_refused_frames_are_bridged_and_sent_again(turning, refused):
    for _ in range(3):
        turning.bus.refused = refused
        turning.cycle(Request.ENABLE, MAX_MISSED)
        turning.bus.refused = ()
        turning.cycle(Request.ENABLE, 5)
    assert turning.feedback.message == ""
    assert turning.feedback.state is DriveState.OPERATION_ENABLED
    assert turning.bench.emergencies == []


@pytest.mark.parametrize(("refused", "is_lost"), [((RPDO1,), True), ((SYNC,), True), ((HEARTBEAT,), False)])
def test_a_set_point_that_did_not_get_to_the_drive_is_reported_in_the_next_cycle(turning, refused, is_lost):
    assert not turning.feedback.is_setpoint_lost
    turning.bus.refused = refused
    turning.cycle(Request.ENABLE, 2)
    assert turning.feedback.is_setpoint_lost is is_lost
    turning.bus.refused = ()
    turning.cycle(Request.ENABLE, 2)
    assert not turning.feedback.is_setpoint_lost


def test_the_set_points_of_a_node_that_is_out_of_reach_are_lost(turning):
    turning.bench.nmt(0x80)  # pre-operational
    turning.bus.answers.put(can.Message(arbitration_id=0x700 + NODE, data=PRE_OPERATIONAL, is_extended_id=False))
    seen = []
    for _ in range(6):
        turning.cycle(Request.QUICK_STOP, velocity=0.0)
        seen.append((turning.feedback.is_reachable, turning.feedback.is_setpoint_lost))
    # lost is the command of the cycle before; the start of the node (NMT) has brought it back
    out_of_reach = [not is_reachable for is_reachable, _ in seen]
    assert [is_lost for _, is_lost in seen] == [False, *out_of_reach[:-1]]
    assert seen[0] == (False, False)
    assert seen[-1] == (True, False)


def test_a_queue_that_stays_full_is_a_fault_and_not_an_exception(turning):
    turning.bus.refused = (RPDO1,)
    turning.cycle(Request.ENABLE, MAX_MISSED)
    assert turning.feedback.message == ""
    turning.cycle(Request.ENABLE, 2)
    assert "cannot send" in turning.feedback.message
    assert "[FH-202]" in turning.feedback.message
    turning.bus.refused = ()
    turning.cycle(Request.QUICK_STOP, 300, velocity=0.0)  # the stop that follows reaches the drive
    assert turning.feedback.state is DriveState.QUICK_STOP_ACTIVE
    assert abs(turning.feedback.velocity) < 0.01


def test_a_refused_sync_is_a_cycle_without_feedback(turning):
    turning.bus.refused = (SYNC,)
    turning.cycle(Request.ENABLE)
    assert not turning.feedback.is_fresh
    assert "SYNC was not sent" in turning.feedback.missing
    turning.bus.refused = ()
    turning.cycle(Request.ENABLE, 3)
    assert turning.feedback.is_fresh
