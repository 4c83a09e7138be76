"""Simulated time: a drive that falls silent must end the run, for nothing else would."""

import collections

import can
import pytest
from friction_hil_drivers.canopen import drives as driver
from friction_hil_drivers.canopen import objects

from friction_hil.daemon.realtime import SteppedClock
from friction_hil.drive import Feedback
from friction_hil.errors import DriveError
from tests.canopen_bench import NODE, Bench
from tests.servo_drives import axis_dict, configuration


class DeafBus(can.BusABC):
    """Hands frames to a simulated drive, but for SYNC while it is deaf."""

    def __init__(self):
        super().__init__(channel="bench")
        self.bench = Bench()
        self.answers = collections.deque()
        self.is_deaf = False

    def send(self, msg, timeout=None):
        if self.is_deaf and msg.arbitration_id == objects.SYNC_ID:
            return
        for can_id, data in self.bench.send(msg.arbitration_id, bytes(msg.data)):
            self.answers.append(can.Message(arbitration_id=can_id, data=data, is_extended_id=False))

    def _recv_internal(self, timeout):
        return (self.answers.popleft() if self.answers else None), True


def test_a_drive_that_answers_no_sync_ends_the_run(monkeypatch):
    bus = DeafBus()
    config = configuration(x=axis_dict(node=NODE))
    drives = driver.CanopenDrives(config, config.axes, SteppedClock(), dry_run=False, bus=bus)
    feedback = Feedback()
    try:
        drives.connect()
        drives.start()
        drives.receive([feedback], 0)
        assert feedback.is_fresh
        monkeypatch.setattr(driver, "_STEPPED_TIMEOUT_S", 0.1)  # not before: the first cycle compiles the drive
        for _ in range(5):  # what is lost now and then is bridged
            bus.is_deaf = True
            drives.receive([feedback], 0)
            assert not feedback.is_fresh
            bus.is_deaf = False
            drives.receive([feedback], 0)
        bus.is_deaf = True
        for _ in range(2):
            drives.receive([feedback], 0)
        with pytest.raises(DriveError, match="not every drive has answered SYNC"):
            drives.receive([feedback], 0)
    finally:
        drives.close()
        bus.shutdown()
