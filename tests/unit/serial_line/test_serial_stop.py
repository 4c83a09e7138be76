"""Stopping and resetting serial drives: what a fault needs, and what a drive does against it."""

import pytest
import yaml
from friction_hil_drivers.dynamixel.description import DESCRIPTIONS
from friction_hil_drivers.serial_line.bus import SerialBus
from friction_hil_drivers.serial_line.simulated import RefusedError, SimulatedDrive

from friction_hil.drive import DriveState, Request
from friction_hil.errors import DriveError
from tests.serial_rig import KINDS, Rig


def served(bench, method):
    (found,) = getattr(bench.driver, method)(bench.config, bench.config.axes).stops
    return found


def without_reset(folder, source):
    data = yaml.safe_load(source.read_text())
    data["reset_fault"] = []
    path = folder / "changed.yaml"
    path.write_text(yaml.safe_dump(data))
    return str(path)


def test_a_servo_whose_fault_needs_a_reboot_is_rebooted(tmp_path):
    with Rig("dynamixel", tmp_path, description=without_reset(tmp_path, DESCRIPTIONS / "xl330.yaml")) as bench:
        bench.there.fail()
        found = served(bench, "reset_axes")
        assert (found.result, found.before, found.after) == ("reset", DriveState.FAULT, DriveState.SWITCH_ON_DISABLED)
        assert found.fault
        assert bench.there.is_on


def test_a_fault_that_nothing_resets_is_reported_with_what_to_do(tmp_path):
    source = DESCRIPTIONS.parents[1] / "ascii/descriptions/odrive.yaml"
    with Rig("odrive", tmp_path, description=without_reset(tmp_path, source)) as bench:
        bench.there.fail()
        found = served(bench, "reset_axes")
        assert (found.result, found.after, found.is_proved) == ("fault", DriveState.FAULT, False)
        assert "watchdog timer expired" in found.fault
        assert "reset_fault" in found.detail


@pytest.mark.parametrize("kind", ["odrive", "rtu, function 23"])
def test_a_drive_that_does_not_give_up_its_power_is_not_called_stopped(kind, tmp_path, monkeypatch):
    def refuse(drive, name, number):
        raise RefusedError("not this one")

    with Rig(kind, tmp_path) as bench:
        bench.there.enter(DriveState.OPERATION_ENABLED)
        monkeypatch.setattr(SimulatedDrive, "write", refuse)
        found = served(bench, "stop_axes")
        assert (found.result, found.after, found.is_proved) == ("powered", DriveState.OPERATION_ENABLED, False)
        assert "refuses" in found.detail or "unknown command" in found.detail


def test_a_servo_is_not_left_with_a_watchdog_that_would_be_its_next_fault(tmp_path):
    with Rig("dynamixel", tmp_path) as bench:
        bench.there.fail()
        assert served(bench, "reset_axes").result == "reset"
        assert bench.there.read("watchdog") == 0.0


READABLE = ("rtu", "rtu, function 23", "tcp", "dynamixel")  # odrive's torque can only be written


def pushed(bench):
    bench.begin().enable().cycle(Request.ENABLE, 0.2, count=5)
    assert bench.there.read("torque_command") != 0.0
    return bench


@pytest.mark.parametrize("kind", READABLE)
def test_a_stop_clears_the_torque_that_a_killed_run_left(kind, tmp_path):
    with Rig(kind, tmp_path) as bench:
        pushed(bench)
        bench.bus.scheduler.line.close()  # as the kernel does
        found = served(bench, "stop_axes")
        assert (found.result, found.is_proved, found.reason) == ("stopped", True, "")
        assert bench.there.read("torque_command") == 0.0


@pytest.mark.parametrize("kind", READABLE)
def test_a_drive_that_keeps_its_torque_command_is_told_by_the_run_and_by_the_stop(kind, tmp_path, monkeypatch):
    write = SimulatedDrive.write

    def keep(drive, name, number):
        if name != "torque_command" or number:
            write(drive, name, number)

    with Rig(kind, tmp_path) as bench:
        pushed(bench)
        monkeypatch.setattr(SimulatedDrive, "write", keep)
        held = bench.there.read("torque_command")
        bench.drives.close()
        expected = f"torque_command of the drive stays {held:g} [FH-128]"
        assert bench.drives.leftovers == [f"x: {expected}"]
        found = served(bench, "stop_axes")
        assert (found.result, found.is_proved, found.reason) == ("unpowered", False, expected)


@pytest.mark.parametrize("kind", KINDS)
def test_a_line_that_is_gone_at_the_end_leaves_the_torque_in_doubt(kind, tmp_path):
    with Rig(kind, tmp_path) as bench:
        pushed(bench) if kind in READABLE else bench.begin().enable()
        bench.unplug()
        bench.drives.close()
        (text,) = bench.drives.leftovers
        assert text.startswith("x:")
        assert text.endswith("torque_command [FH-128]")


@pytest.mark.parametrize("kind", KINDS)
def test_zero_torque_is_written_again_when_its_reply_is_lost(kind, tmp_path, monkeypatch):
    transact, lost = SerialBus.transact, []

    def lossy(bus, axis, *exchanges, attempts):
        if not lost and any("torque_command" in each.writes for each in exchanges):
            lost.append(exchanges)
            raise DriveError("no reply")
        transact(bus, axis, *exchanges, attempts=attempts)

    with Rig(kind, tmp_path) as bench:
        pushed(bench) if kind in READABLE else bench.begin().enable()
        monkeypatch.setattr(SerialBus, "transact", lossy)
        bench.drives.close()
        assert lost
        assert list(bench.drives.leftovers) == []
