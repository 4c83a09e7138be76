"""The driver on a bus that hands every frame to a simulated drive and back."""

import struct

import numpy as np
import pytest
from friction_hil_drivers.canopen.drives import CanopenDrives
from friction_hil_drivers.canopen.wire import cia301

from friction_hil.daemon.realtime import SteppedClock
from friction_hil.drive import Command, DriveState, Feedback, Request
from friction_hil.errors import BusError
from tests.canopen_bench import NODE, Bench, BenchBus
from tests.servo_drives import axis_dict, configuration

CONTROLLER = {"position_gain": 1.0, "velocity_gain": 0.1}
RPDO1, SDO_REQUEST = 0x205, 0x605
NO_REACTION = 0  # 6007h: the drive does nothing when the connection is lost


class Driven:
    """A drive, in CST, enabled and pushed with 0.3 N m."""

    def __init__(self, *, mode="cst", servo=None, dry_run=False):
        self.bench = Bench(servo)
        self.bus = BenchBus(self.bench)
        controller = {"controller": CONTROLLER} if mode == "cst" else {}
        config = configuration(x=axis_dict(node=NODE, mode=mode, **controller))
        self.clock = SteppedClock()
        self.drives = CanopenDrives(config, config.axes, self.clock, dry_run=dry_run, bus=self.bus)
        (self.facts,) = self.drives.connect()
        self.drives.start()
        self.feedback, self.command = Feedback(), Command()

    def cycle(self, request, torque=0.0, count=1):
        for _ in range(count):
            self.clock.sleep_until(self.clock.now_ns() + 1_000_000)
            self.drives.receive([self.feedback], 0)
            self.command.request, self.command.torque = request, torque
            self.drives.send([self.command])

    def downloads(self, since=0):
        """Index and value of every object written by SDO."""
        requests = [data for can_id, data in self.bus.sent[since:] if can_id == SDO_REQUEST and data[0] & 0xE0 == 0x20]
        return [(struct.unpack_from("<H", data, 1)[0], struct.unpack_from("<I", data, 4)[0]) for data in requests]


@pytest.fixture
def driven():
    one = Driven()
    yield one
    one.drives.close()
    one.bus.shutdown()


def test_a_drive_is_enabled_pushed_and_disabled(driven):
    assert driven.facts.torque_resolution == pytest.approx(0.64e-3)
    driven.cycle(Request.ENABLE, 0.3, count=10)
    assert driven.feedback.state is DriveState.OPERATION_ENABLED
    assert driven.feedback.torque == pytest.approx(0.3, abs=1e-3)
    assert driven.feedback.velocity > 0.0
    driven.cycle(Request.DISABLE, count=300)  # it brakes first
    assert not driven.feedback.state.is_powered
    driven.drives.close()
    assert driven.bench.read(0x1016, 1) == 0  # it watches nobody any more
    assert driven.bench.emergencies == []


def test_the_position_is_that_of_the_sync(driven):
    driven.cycle(Request.ENABLE, 0.3, count=10)
    assert driven.feedback.velocity > 1.0
    assert driven.feedback.position == pytest.approx(driven.bench.servo.position, abs=1e-9)  # it stands since then


@pytest.mark.parametrize("mode", ["cst", "csp"])
def test_a_torque_acts_when_the_facts_say_that_it_does(mode):
    """One cycle's torque, on an axis too heavy to be moved by it: nothing else changes the drive's demand."""
    driven = Driven(mode=mode, servo={"mechanics": {"inertia": 1e3}})
    servo, demands = driven.bench.servo, []
    advance = servo.advance

    def advance_step_by_step(steps):
        for _ in range(steps):
            advance(1)
            demands.append(servo.torque_demand)

    servo.advance = advance_step_by_step
    driven.cycle(Request.ENABLE, count=20)
    driven.cycle(Request.ENABLE, 0.3)
    sampled = len(demands)  # at the last SYNC
    driven.cycle(Request.ENABLE, count=5)
    driven.drives.close()
    driven.bus.shutdown()
    pushed = np.array(demands[sampled:])
    assert np.abs(demands[:sampled]).max() < 1e-3
    assert pushed.max() == pytest.approx(0.3, abs=1e-3)
    middle = (np.arange(pushed.size) + 0.5) / servo.steps_per_second
    acted = float(np.sum(middle * pushed) / np.sum(pushed))
    assert acted == pytest.approx(driven.facts.actuation_delay_s, abs=1.0 / servo.config.loops.rate_hz)


def test_after_a_crash_in_motion_no_drive_keeps_its_power(driven):
    """The last command by PDO needs a SYNC, which does not come; and this drive does not react to the lost master."""
    driven.bench.write(0x6007, 0, "h", NO_REACTION)
    driven.cycle(Request.ENABLE, 0.3, count=10)
    driven.command.request, driven.command.torque = Request.DISABLE, 0.0
    driven.drives.send([driven.command])
    driven.drives.close()
    assert driven.bench.statusword & 0x6F == 0x40
    assert driven.bench.servo.torque_demand == 0.0
    assert driven.bench.read(0x1016, 1) == 0


def test_a_drive_that_keeps_its_power_keeps_watching_the_daemon(driven):
    def is_controlword(can_id, data):
        return can_id == SDO_REQUEST and data[0] & 0xE0 == 0x20 and data[1:3] == b"\x40\x60"

    driven.bench.write(0x6007, 0, "h", NO_REACTION)
    driven.cycle(Request.ENABLE, 0.3, count=10)
    armed = driven.bench.read(0x1016, 1)
    driven.bus.loses = is_controlword
    driven.drives.close()
    assert driven.bench.read(0x1016, 1) == armed != 0


def test_a_dry_run_writes_nothing_that_moves_or_changes_a_drive():
    listener = Driven(dry_run=True)
    listener.cycle(Request.LISTEN, count=20)
    listener.cycle(Request.ENABLE, 0.3, count=5)  # not even by mistake
    assert listener.feedback.is_fresh
    listener.drives.close()
    listener.bus.shutdown()
    written = {index for index, _ in listener.downloads()}
    assert written <= {*range(0x1800, 0x1804), *range(0x1A00, 0x1A04)}  # TPDOs
    assert RPDO1 not in {can_id for can_id, _ in listener.bus.sent}
    commands = [data[0] for can_id, data in listener.bus.sent if can_id == cia301.NMT_ID]
    assert commands == [cia301.NmtCommand.START, cia301.NmtCommand.ENTER_PRE_OPERATIONAL]
    assert listener.bench.statusword & 0x6F == 0x40


def test_closing_twice_or_before_anything_was_opened_is_harmless(driven):
    driven.drives.close()
    sent = len(driven.bus.sent)
    driven.drives.close()
    assert len(driven.bus.sent) == sent
    config = configuration(x=axis_dict(node=NODE + 1))
    unopened = CanopenDrives(config, config.axes, SteppedClock(), dry_run=False)
    unopened.close()
    with pytest.raises(BusError, match="the bus is not open"):
        unopened.start()


def test_a_drive_is_configured_for_a_model_that_depends_on_the_load():
    friction = {"model": "coulomb", "parameters": {"coulomb": 0.08}, "modifiers": {"load": {"motoring": 0.1}}}
    model = {"axis": "rotary", "friction": friction, "mechanics": {"inertia": 2e-4}}
    config = configuration(x=axis_dict(node=NODE, model=model))
    bus = BenchBus(Bench())
    drives = CanopenDrives(config, config.axes, SteppedClock(), dry_run=False, bus=bus)
    (facts,) = drives.connect()
    drives.close()
    bus.shutdown()
    assert facts.torque_resolution > 0.0
