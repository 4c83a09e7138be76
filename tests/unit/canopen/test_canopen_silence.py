"""Simulated time: a drive that does not answer must end the run, for no clock would."""

import can
import pytest
from friction_hil_drivers.canopen.cycle.listener import STEPPED_TIMEOUT_S, STEPPED_TIMEOUTS
from friction_hil_drivers.canopen.drives import CanopenDrives
from friction_hil_drivers.canopen.wire import cia301

from friction_hil.daemon.realtime import SteppedClock
from friction_hil.drive import Feedback
from friction_hil.errors import DriveError
from tests.canopen_bench import NODE, Bench, BenchBus
from tests.servo_drives import axis_dict, configuration


class PatientBus(BenchBus):
    """Loses SYNC while it is deaf; counts the seconds for which the driver waited in vain, and waits for none."""

    def __init__(self):
        super().__init__(Bench())
        self.is_deaf = False
        self.waited_s = 0.0

    def loses(self, can_id, data):
        return self.is_deaf and can_id == cia301.SYNC_ID

    def recv(self, timeout=None):
        if self.is_deaf and self.answers.empty():
            self.waited_s += timeout
            return None
        return super().recv(timeout)


@pytest.fixture
def bus():
    one = PatientBus()
    yield one
    one.shutdown()


@pytest.fixture
def drives(bus):
    config = configuration(x=axis_dict(node=NODE))
    one = CanopenDrives(config, config.axes, SteppedClock(), dry_run=False, bus=bus)
    one.connect()
    one.start()
    yield one
    bus.is_deaf = False
    one.close()


def test_a_drive_that_answers_no_sync_ends_the_run(drives, bus):
    feedback = Feedback()
    drives.receive([feedback], 0)
    assert feedback.is_fresh
    for _ in range(5):  # a single cycle may be lost now and then
        for bus.is_deaf in (True, False):
            drives.receive([feedback], 0)
            assert feedback.is_fresh is not bus.is_deaf
    bus.is_deaf, bus.waited_s = True, 0.0
    for _ in range(STEPPED_TIMEOUTS - 1):
        drives.receive([feedback], 0)
    with pytest.raises(DriveError, match=r"not every drive has answered SYNC for 30 s: .* \[FH-234\]"):
        drives.receive([feedback], 0)
    assert bus.waited_s == STEPPED_TIMEOUTS * STEPPED_TIMEOUT_S


def test_a_bus_that_fails_is_an_error_with_a_code(drives, bus):
    def fail(msg, timeout=None):
        raise can.CanOperationError("bus-off")

    bus.send, working = fail, bus.send
    with pytest.raises(Exception, match=r"the bus virtual test-\d+ cannot send: bus-off \[FH-202\]"):
        drives.receive([Feedback()], 0)
    bus.send = working
