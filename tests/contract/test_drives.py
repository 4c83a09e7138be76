"""The drivers that come with the product, each with its simulated drive, keep the contract of a driver."""

import time

import pytest
from friction_hil_drivers.canopen.drives import CanopenDrives
from friction_hil_drivers.cia402.profile import drive_state

from friction_hil.drive import Command, Feedback
from friction_hil.realtime import SteppedClock
from tests.canopen_bench import NODE
from tests.canopen_bench import Bench as CanopenBench
from tests.contract.drives_contract import DrivesContract
from tests.serial_rig import KINDS, Bench
from tests.servo_drives import axis_dict, configuration
from tests.unit.test_canopen_drives import BenchBus

STATUSWORD = 0x6041
PATIENCE_S = 5.0  # the last write without a reply may still be on its way


class SerialRig(Bench):
    """Driver and simulated drive on a pseudo-terminal or a TCP connection."""

    def cycle(self, request, torque=0.0):
        super().cycle(request, torque)
        return self.feedback

    def is_powered(self):
        (drive,) = self.simulated._lines[0]._drives
        end = time.monotonic() + PATIENCE_S
        while drive.state.is_powered and not self.drives._is_started and time.monotonic() < end:
            time.sleep(1e-3)
        return drive.state.is_powered


class CanopenRig:
    """Driver and simulated drive on a bus without time."""

    def __init__(self, *, dry_run):
        self.bench = CanopenBench()
        self.bus = BenchBus(self.bench)
        controller = {"position_gain": 1.0, "velocity_gain": 0.1}
        config = configuration(x=axis_dict(node=NODE, mode="cst", controller=controller))
        self.clock = SteppedClock()
        self.drives = CanopenDrives(config, config.axes, self.clock, dry_run=dry_run, bus=self.bus)
        self.feedback, self.command = Feedback(), Command()

    def cycle(self, request, torque=0.0):
        self.clock.sleep_until(self.clock.now_ns() + 1_000_000)
        self.drives.receive([self.feedback], 0)
        self.command.request, self.command.torque = request, torque
        self.drives.send([self.command])
        return self.feedback

    def is_powered(self):
        return drive_state(self.bench.read(STATUSWORD, code="H")).is_powered

    def close(self):
        self.drives.close()
        self.bus.shutdown()


class TestCanopen(DrivesContract):
    def make_rig(self, tmp_path, *, dry_run=False):
        return CanopenRig(dry_run=dry_run)


@pytest.mark.parametrize("kind", KINDS, scope="class")
class TestSerial(DrivesContract):
    @pytest.fixture(autouse=True)
    def choose(self, kind):
        self.kind = kind

    def make_rig(self, tmp_path, *, dry_run=False):
        return SerialRig(self.kind, tmp_path, dry_run=dry_run)
