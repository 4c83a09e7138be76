"""Serial drivers on real lines, with simulated drives at the other end: the same life for every protocol.

The drives run in a thread and are paced by the driver's requests, so that nothing depends on the clock.
"""

import itertools
import os
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from friction_hil_drivers.serial_line import codes, drives
from friction_hil_drivers.serial_line.bus import SerialBus
from friction_hil_drivers.serial_line.simulated.drive import RefusedError, SimulatedDrive
from friction_hil_drivers.serial_line.simulated.port import PtyPort
from pymodbus.framer import FramerRTU

from friction_hil.drive import Command, DriveState, Feedback, Request
from friction_hil.errors import DriveError, OptionError, UsageError
from tests.peers.serial_processes import wait_until
from tests.serial_rig import FAST_LINE, KINDS, Rig, port_of


@pytest.fixture(params=KINDS)
def kind(request):
    return request.param


def test_a_rehearsal_takes_what_has_come_and_changes_nothing_else(kind, tmp_path):
    def life(is_rehearsed):
        folder = tmp_path / str(is_rehearsed)
        folder.mkdir()
        told = []
        with Rig(kind, folder).begin() as bench:
            for k in range(80):
                until = time.monotonic() + 10.0
                while is_rehearsed and bench.bus.scheduler.outstanding and time.monotonic() < until:
                    bench.drives.warm_caches()
                assert not (is_rehearsed and bench.bus.scheduler.outstanding)
                bench.cycle(Request.ENABLE if k < 60 else Request.DISABLE, 0.3)
                heard = bench.feedback
                told.append((heard.position, heard.velocity, heard.torque, heard.state, heard.is_fresh, heard.missing))
        return told

    plain = life(is_rehearsed=False)
    assert DriveState.OPERATION_ENABLED in {state for _, _, _, state, _, _ in plain}
    assert life(is_rehearsed=True) == plain


@pytest.mark.parametrize(("kind", "name"), [("odrive", "an ODrive"), ("rtu, function 23", "a Modbus drive")])
def test_a_cycle_passes_as_many_functions_as_its_page_says(tmp_path, kind, name):
    passed = set()

    def note(frame, event, _):
        if event == "call" and frame.f_globals["__name__"].startswith("friction_hil"):
            passed.add(frame.f_code)

    with Rig(kind, tmp_path).begin().enable() as bench:
        bench.cycle(Request.ENABLE, 0.1, count=20)
        wait_until(lambda: bench.drives.warm_caches() or not bench.bus.scheduler.outstanding, "the drive")
        sys.setprofile(note)
        try:
            bench.cycle(Request.ENABLE, 0.1)
        finally:
            sys.setprofile(None)
    own = {bench.clock.sleep_until.__code__}
    page = Path(drives.__file__).with_name("README.md").read_text()
    assert f"{len(passed - own)} of {name}" in page


def test_in_simulated_time_the_wire_is_never_busy(tmp_path, monkeypatch):
    """What all characters would take on the wire sums up faster than cycles do that wait for nothing."""
    with Rig("odrive", tmp_path).begin().enable() as bench:
        monkeypatch.setattr(drives, "_SIMULATED_TIMEOUT_NS", 2_000_000_000)
        bench.bus.scheduler.busy_until_ns = time.monotonic_ns() + 60_000_000_000
        for _ in range(5):
            bench.cycle(Request.ENABLE)
            assert bench.feedback.is_fresh, bench.feedback


def test_a_cycle_that_was_broken_off_does_not_keep_the_power_from_being_taken_away(kind, tmp_path, monkeypatch):
    with Rig(kind, tmp_path).begin().enable() as bench:
        bench.clock.is_real = True

        def interrupted(*_, **__):
            raise KeyboardInterrupt

        with monkeypatch.context() as patch:
            patch.setattr(drives, "run_schedulers", interrupted)
            with pytest.raises(KeyboardInterrupt):
                bench.cycle(Request.ENABLE, 0.1)
        bench.bus.scheduler.deadline_ns = 1  # which is over
        bench.drives.close()
        wait_until(lambda: not bench.there.state.is_powered, "the drive")


def test_what_is_still_said_to_a_former_master_is_dropped_before_anything_is_asked(tmp_path, monkeypatch):
    """Servos do not number their replies: a late one to somebody else would be taken for the state."""
    with Rig("dynamixel", tmp_path).begin().enable() as bench:
        bench.bus.scheduler.line.close()
        said, drained = [], []
        discard_input = SerialBus.discard_input

        def late(bus, time_s):
            (simulated,) = bench.simulated.lines
            simulated.port.write(b"of somebody else")
            discard_input(bus, time_s)
            drained.append(time_s)
            said.append(bus.scheduler.line.read())

        monkeypatch.setattr(SerialBus, "discard_input", late)
        bench.drives = bench.daemon()
        with pytest.raises(DriveError, match=codes.ALREADY_POWERED):
            bench.drives.connect()
        assert said == [b""]
        assert drained[0] >= 0.05


def test_a_line_that_goes_away_is_told_and_bridged_until_then(kind, tmp_path):
    with Rig(kind, tmp_path).begin().enable() as bench:
        position = bench.feedback.position
        bench.unplug()
        bench.clock.is_real = True  # nobody answers: do not wait for simulated time
        bench.cycle(Request.ENABLE, 0.1, count=3)
        assert not bench.feedback.is_fresh
        assert bench.feedback.position == position
        assert "gone" in bench.feedback.missing or "no reply" in bench.feedback.missing


@pytest.mark.parametrize("kind", ["odrive", "tcp"])
def test_a_line_that_is_back_when_the_driver_closes_takes_the_power_away(tmp_path, kind):
    """It was gone in the last cycle, so that no cycle has opened it again; a connection takes a moment."""
    with Rig(kind, tmp_path).begin().enable() as bench:
        bench.clock.is_real = True
        os.close(bench.bus.scheduler.line.descriptor)
        bench.cycle(Request.ENABLE)
        assert "gone" in bench.feedback.missing
        assert bench.there.state.is_powered
        bench.drives.close()
        wait_until(lambda: not bench.there.state.is_powered, "the drive")


FAULTS = [{"corrupt": 0.2}, {"drop": 0.1}, {"delay": 0.1, "delay_s": 0.01}, {"noise": 0.3}]


# Modbus on TCP leaves checksums to TCP
@pytest.mark.parametrize(
    ("kind", "faults"), [(k, f) for k in KINDS for f in FAULTS if k != "tcp" or "corrupt" not in f]
)
def test_a_bad_line_costs_cycles_and_never_tells_a_lie(kind, tmp_path, faults, monkeypatch):
    monkeypatch.setattr(drives, "_SIMULATED_TIMEOUT_NS", 150_000_000)  # what was dropped does not come
    monkeypatch.setattr(drives, "_SIMULATED_TIMEOUTS", 1000)
    with Rig(kind, tmp_path, faults={**faults, "seed": 5}).begin() as bench:
        fresh = 0
        for _ in range(150):
            bench.cycle(Request.LISTEN)
            fresh += bench.feedback.is_fresh
            # the axis stands: whatever else is told was made up by the line
            assert abs(bench.feedback.position) < 1e-4
            assert bench.feedback.velocity == 0.0
        assert fresh > 60


@pytest.mark.parametrize(("period_s", "max_missed"), [(4e-3, 10), (8e-3, 10), (0.1, 3)])
def test_by_default_a_single_lost_reply_is_bridged(tmp_path, period_s, max_missed):
    """A drive that did not reply is left alone for a while, which must be shorter than what makes a fault."""
    with Rig("rtu", tmp_path, line={"port": str(tmp_path / "line"), "baud": 1_000_000}) as bench:
        realtime = bench.config.realtime.model_copy(update={"max_missed": max_missed})
        bench.config = bench.config.model_copy(update={"period_s": period_s, "realtime": realtime})
        bench.drives = bench.daemon()
        bench.drives.connect()
        assert bench.bus.scheduler.reply_limit_ns * 1e-9 <= 0.5 * max_missed * period_s


@pytest.mark.parametrize(
    ("kind", "line", "changes", "words"),
    [
        ("rtu", {"baud": 115200, "reply_limit_s": 1e-3}, {}, "reply_limit_s: 0.001 s"),
        ("rtu, function 23", FAST_LINE, {"watchdog_s": 2e-3}, "watchdog_s: 0.002 s"),
    ],
)
def test_a_time_that_is_too_short_is_refused(tmp_path, kind, line, changes, words):
    line = {"port": str(tmp_path / "line"), **line}
    with Rig(kind, tmp_path, line=line, **changes) as bench, pytest.raises(UsageError, match=words):
        bench.drives.connect()


@pytest.mark.parametrize("is_by_position", [True, False])
def test_a_drive_that_takes_nothing_but_positions_needs_to_be_compensated_by_them(tmp_path, is_by_position):
    given = (Path(drives.__file__).parents[1] / "modbus" / "descriptions" / "generic_cia402.yaml").read_text()
    mine = tmp_path / "positions.yaml"
    mine.write_text(given.replace("[torque_command, position_command]", "[position_command]"))
    loop = {"velocity_gain": 0.2, "integral_hz": 16.0, "limit": 2.0, "slew": 2e3, "position_gain": 200.0}
    changes = {"velocity_offset": loop} if is_by_position else {}
    keys = {"mode": "csp", "controller": None, "description": str(mine), "compensation": {"fade_s": 0.1, **changes}}
    with Rig("rtu, function 23", tmp_path, **keys) as bench:
        if not is_by_position:
            with pytest.raises(OptionError, match="position_gain"):
                bench.drives.connect()
            return
        bench.begin().enable()
        assert bench.facts.takes_torque
        assert bench.facts.torque_resolution > 0.0
        bench.command.position = 0.01
        bench.cycle(Request.ENABLE, count=5)
        assert bench.there.servo.position_demand == pytest.approx(0.01, abs=2e-3)


class Chain(Rig):
    """Several axes of a kind on one line; `silence` takes one of them off it."""

    def __init__(self, kind, tmp_path, addresses, **line):
        given = {"line": {"port": port_of(kind, tmp_path), **FAST_LINE, **line}, "is_watchdog_required": False}
        self._set_up(kind, {f"x{n}": {**given, address: n} for address, n in addresses})
        self.feedback, self.commands = [Feedback() for _ in addresses], [Command() for _ in addresses]

    def begin(self):
        self.drives.connect()
        self.drives.start()
        return self

    def cycle(self, request, torque=0.0, count=1):
        for _ in range(count):
            self.clock.sleep_until(self.clock.now_ns() + 1_000_000)
            end_ns = time.monotonic_ns() + 20_000_000 if self.clock.is_real else self.clock.now_ns() + 1_000_000
            self.drives.receive(self.feedback, end_ns)
            for command in self.commands:
                command.request, command.torque = request, torque
            self.drives.send(self.commands)

    def enable(self):
        for _ in range(100):
            self.cycle(Request.ENABLE)
            if all(each.state is DriveState.OPERATION_ENABLED for each in self.feedback):
                return self
        raise AssertionError(self.feedback)

    def silence(self, number):
        """Cut the wire of one drive; from now on time is real, so that nobody waits for its reply for ever."""
        (line,) = self.simulated.lines
        del line.responder.by_address[number]
        self.clock.is_real = True


def test_a_silent_drive_on_the_line_leaves_no_other_one_under_power(tmp_path):
    """Unit 3 falls silent, which is asked first; unit 4 must be disabled when the driver closes all the same."""
    with Chain("rtu", tmp_path, [("unit", 3), ("unit", 4)]).begin().enable() as bench:
        bench.cycle(Request.ENABLE, 0.3, count=5)
        there = bench.simulated.lines[0].drives[1]
        assert there.state.is_powered
        bench.silence(3)
        silent, answering = bench.drives.close()
        assert silent is DriveState.UNKNOWN
        assert not answering.is_powered
        assert answering is not DriveState.UNKNOWN
        wait_until(lambda: not there.state.is_powered, "the drive")


@pytest.mark.parametrize("silent", [1, 2, 3])
def test_a_silent_servo_leaves_its_neighbours_their_feedback_and_takes_no_power_from_being_cut(tmp_path, silent):
    chain = Chain("dynamixel", tmp_path, [("id", 1), ("id", 2), ("id", 3)], baud=4_000_000, reply_limit_s=0.05)
    with chain.begin().enable() as bench:
        bench.cycle(Request.ENABLE, count=3)
        bench.silence(silent)
        there = [n for n in range(3) if n + 1 != silent]
        neighbours = [bench.simulated.lines[0].drives[n] for n in there]

        def are_heard_and_disabled():
            bench.cycle(Request.QUICK_STOP)
            assert not bench.feedback[silent - 1].is_fresh
            is_heard = all(bench.feedback[n].is_fresh for n in there)
            return is_heard and not any(drive.state.is_powered for drive in neighbours)

        wait_until(are_heard_and_disabled, "the drive")


def refusing(monkeypatch, signal):
    """From now on simulated drives refuse a signal; to set-points without a reply they say so all the same."""
    write = SimulatedDrive.write

    def choosy(drive, name, number):
        if name == signal:
            raise RefusedError("not this one")
        write(drive, name, number)

    monkeypatch.setattr(SimulatedDrive, "write", choosy)


def test_what_is_refused_without_a_reply_is_told_at_run_time_and_at_connecting(tmp_path, monkeypatch):
    with Rig("odrive", tmp_path).begin().enable() as bench:
        bench.cycle(Request.ENABLE, count=20)
        assert bench.feedback.message == ""
        refusing(monkeypatch, "torque_command")
        bench.cycle(Request.ENABLE, 0.1, count=drives._MAX_REFUSALS + 1)
        assert bench.feedback.is_fresh, "feedback is none the worse for it"
        assert "torque_command of x" in bench.feedback.message
        assert codes.COMMANDS_REFUSED in bench.feedback.message
    with Rig("odrive", tmp_path) as bench:
        refusing(monkeypatch, "input_mode")
        with pytest.raises(DriveError, match=f"input_mode of x.*{codes.SETUP_REFUSED}"):
            bench.drives.connect()


def test_a_position_in_turns_has_the_resolution_of_its_digits_or_of_the_encoder(tmp_path):
    with Rig("odrive", tmp_path).begin() as bench:
        assert bench.facts.position_resolution < 1e-4
        assert bench.facts.torque_resolution < 1e-3
    with Rig("odrive", tmp_path, counts_per_unit=8192 / 6.283185307179586).begin() as bench:
        assert bench.facts.position_resolution == pytest.approx(6.283185307179586 / 8192)


@pytest.mark.parametrize(("kind", "in_force"), [("rtu, function 23", 2), ("dynamixel", 1), ("odrive", 1)])
def test_how_old_a_torque_is_that_comes_in_turns_is_stated(kind, in_force, tmp_path):
    """A torque that is raised in equal steps is behind by its age, beside the cycles until a command is in force."""
    with Rig(kind, tmp_path).begin() as bench:
        period_s, step = bench.config.period_s, 1e-3
        bench.enable()
        behind = []
        for k in range(60):
            bench.cycle(Request.ENABLE, step * k)
            behind.append(k - bench.feedback.torque / step)
        age = float(np.mean(behind[12:])) - in_force
        assert bench.facts.torque_delay_s / period_s == pytest.approx(age, abs=0.6)


def test_a_command_that_a_drive_refuses_now_and_then_is_a_notice(tmp_path, monkeypatch):
    """Modbus exceptions are named though the run goes on: 6 is a drive that is busy."""
    with Rig("rtu", tmp_path).begin().enable() as bench:
        bench.cycle(Request.ENABLE, count=5)
        assert bench.feedback.notices == []
        assert bench.facts.torque_delay_s is None, "this drive tells no torque"
        write, busy = PtyPort.write, itertools.count()

        def refuse_sometimes(port, data):
            """The reply to each third write of registers is exception 6."""
            if data[1] in (6, 16) and next(busy) % 3 == 0:
                pdu = bytes((data[0], data[1] | 0x80, 6))
                data = pdu + FramerRTU.compute_CRC(pdu).to_bytes(2, "big")
            write(port, data)

        monkeypatch.setattr(PtyPort, "write", refuse_sometimes)
        bench.cycle(Request.ENABLE, 0.1, count=20)
        assert bench.feedback.is_fresh
        assert bench.feedback.message == ""
        assert bench.feedback.notices[0].endswith("(exception 6)")


def test_a_tripped_bus_watchdog_says_that_it_is_one(tmp_path):
    with Rig("dynamixel", tmp_path).begin().enable() as bench:
        bench.simulated.lines[0].drives[0].fail()
        for _ in range(30):
            bench.cycle(Request.ENABLE)
        assert bench.feedback.state is DriveState.FAULT
        assert bench.feedback.error.startswith("its bus watchdog has tripped")
